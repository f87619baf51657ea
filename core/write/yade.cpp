// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: YADE documentation, yade.ymport.textClumps and yade.export.textClumps. A line may not be empty.
#include "core/write/rigid_body.h"

namespace spherule {

std::string body_to_yade(const RigidBody& body) {
  std::vector<std::string> lines = detail::about_body(body);
  lines.push_back("inertia xx xy xz yy yz zz about it " + detail::inertia_by_rows(body) + " kg m2");
  lines.emplace_back(
      "ymport.textClumps counts overlaps again for each sphere, unless it is told discretization=50 or so");
  return "#format x_y_z_r_clumpId\n" + detail::commented(lines, "# ") + detail::sphere_lines(body, " 0");
}

}  // namespace spherule
