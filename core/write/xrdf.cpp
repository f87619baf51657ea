// SPDX-License-Identifier: GPL-3.0-or-later
//
// The YAML files of robot programs: XRDF, and cuRobo's own.
#include <array>
#include <charconv>

#include "core/write/rigid_body.h"

namespace spherule {
namespace {

// Without an exponent: readers of YAML 1.1 take 1e-05 for a word. 1100 characters hold any double.
std::string plain(double value) {
  std::array<char, 1100> digits;
  return {digits.data(),
          std::to_chars(digits.data(), digits.data() + digits.size(), value + 0.0, std::chars_format::fixed).ptr};
}

std::string yaml_spheres(const RigidBody& body, const std::string& indent) {
  std::string out;
  for (const Sphere& s : body.spheres) {
    out += indent + "- center: [" + plain(s.centre.x) + ", " + plain(s.centre.y) + ", " + plain(s.centre.z) + "]\n" +
           indent + "  radius: " + plain(s.radius) + '\n';
  }
  return out;
}

}  // namespace

std::string body_to_xrdf(const RigidBody& body, const std::string& link) {
  return detail::commented(detail::about_body(body), "# ") +
         "format: xrdf\n"
         "format_version: 1.0\n"
         "default_joint_positions: {}\n"
         "cspace:\n"
         "  joint_names: []\n"
         "  acceleration_limits: []\n"
         "  jerk_limits: []\n"
         "collision:\n"
         "  geometry: spherule_spheres\n"
         "self_collision:\n"
         "  geometry: spherule_spheres\n"
         "geometry:\n"
         "  spherule_spheres:\n"
         "    spheres:\n"
         "      " +
         link + ":\n" + yaml_spheres(body, "        ");
}

std::string body_to_curobo(const RigidBody& body, const std::string& link) {
  return detail::commented(detail::about_body(body), "# ") + "collision_spheres:\n  " + link + ":\n" +
         yaml_spheres(body, "    ");
}

}  // namespace spherule
