// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: LIGGGHTS-PUBLIC documentation, fix particletemplate/multisphere.
#include "core/write/rigid_body.h"

namespace spherule {

std::string body_to_liggghts(const RigidBody& body) {
  std::vector<std::string> lines = detail::about_body(body);
  lines.push_back("in units si, with FILE this file:");
  lines.push_back("fix ID all particletemplate/multisphere 15485863 atom_type 1 density constant " +
                  detail::decimals({body.density_kg_m3}) + " nspheres " + std::to_string(body.spheres.size()) +
                  " ntry 1000000 spheres file FILE scale 1 type 1 mass " + detail::decimals({body.mass_kg}) +
                  " inertia_tensor " + detail::inertia_by_rows(body) + " use_density");
  lines.push_back("x y z r");
  return detail::commented(lines, "# ") + detail::sphere_lines(body, "");
}

}  // namespace spherule
