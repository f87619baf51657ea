// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: T. Dolinsky et al., PDB2PQR (2004).
#include "core/write/decimal.h"
#include "core/write/export_scenes.h"

namespace spherule {

std::string spheres_to_pqr(std::span<const Sphere> spheres) {
  std::string out =
      "REMARK   1 Spherule: centres, charge 0 and radii of spheres\n"
      "REMARK   1 one unit is 1 mm; frame LPS (x left, y posterior, z head)\n";
  std::size_t serial = 0;
  for (const Sphere& s : spheres) {
    const Vec3 c = s.centre;
    out += "ATOM " + std::to_string(++serial) + " S SPH 1 " + detail::decimals({c.x, c.y, c.z, 0, s.radius}) + '\n';
  }
  return out + "END\n";
}

}  // namespace spherule
