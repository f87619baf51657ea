// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: G. Bernstein, J. Kermode, Extended XYZ.
#include "core/write/decimal.h"
#include "core/write/export_scenes.h"

namespace spherule {

std::string spheres_to_xyz(std::span<const Sphere> spheres) {
  std::string out = std::to_string(spheres.size()) +
                    "\nProperties=species:S:1:pos:R:3:radius:R:1 units=mm frame=LPS generator=Spherule\n";
  for (const Sphere& s : spheres) out += "X " + detail::decimals({s.centre.x, s.centre.y, s.centre.z, s.radius}) + '\n';
  return out;
}

}  // namespace spherule
