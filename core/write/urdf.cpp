// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/rigid_body.h"

namespace spherule {

using detail::decimals;

std::string body_to_urdf(const RigidBody& body, const std::string& link) {
  const Vec3 c = body.centre_m;
  const auto& rows = body.inertia_kg_m2.rows;
  std::string out = "<?xml version=\"1.0\"?>\n<!--\n" + detail::commented(detail::about_body(body), "  ") +
                    "-->\n"
                    "<robot name=\"" +
                    link + "\">\n  <link name=\"" + link +
                    "\">\n"
                    "    <inertial>\n"
                    "      <origin xyz=\"" +
                    decimals({c.x, c.y, c.z}) +
                    "\" rpy=\"0 0 0\"/>\n"
                    "      <mass value=\"" +
                    decimals({body.mass_kg}) + "\"/>\n      <inertia";
  const auto inertia = [&](const char* name, double value) {
    out += std::string(" ") + name + "=\"" + decimals({value}) + '"';
  };
  inertia("ixx", rows[0].x), inertia("ixy", rows[0].y), inertia("ixz", rows[0].z);
  inertia("iyy", rows[1].y), inertia("iyz", rows[1].z), inertia("izz", rows[2].z);
  out += "/>\n    </inertial>\n";
  for (const Sphere& s : body.spheres) {
    out += "    <collision><origin xyz=\"" + decimals({s.centre.x, s.centre.y, s.centre.z}) +
           "\" rpy=\"0 0 0\"/><geometry><sphere radius=\"" + decimals({s.radius}) + "\"/></geometry></collision>\n";
  }
  return out + "  </link>\n</robot>\n";
}

}  // namespace spherule
