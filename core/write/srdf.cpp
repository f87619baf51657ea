// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/rigid_body.h"

namespace spherule {

std::string body_to_srdf(const RigidBody& body, const std::string& link) {
  std::string out = "<?xml version=\"1.0\"?>\n<!--\n" + detail::commented(detail::about_body(body), "  ") +
                    "-->\n"
                    "<robot name=\"" +
                    link + "\">\n  <link_sphere_approximation link=\"" + link + "\">\n";
  for (const Sphere& s : body.spheres) {
    out += "    <sphere center=\"" + detail::decimals({s.centre.x, s.centre.y, s.centre.z}) + "\" radius=\"" +
           detail::decimals({s.radius}) + "\"/>\n";
  }
  return out + "  </link_sphere_approximation>\n</robot>\n";
}

}  // namespace spherule
