// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: LAMMPS documentation, molecule command.
#include "core/write/rigid_body.h"

namespace spherule {

using detail::decimals;

std::string body_to_lammps(const RigidBody& body) {
  const Vec3 c = body.centre_m;
  const auto& rows = body.inertia_kg_m2.rows;
  std::string out = detail::commented(detail::about_body(body), "# ") + "\n" + std::to_string(body.spheres.size()) +
                    " atoms\n" + decimals({body.mass_kg}) + " mass\n" + decimals({c.x, c.y, c.z}) + " com\n" +
                    decimals({rows[0].x, rows[1].y, rows[2].z, rows[0].y, rows[0].z, rows[1].z}) + " inertia\n";
  const auto section = [&](const char* title, auto&& line) {
    out += std::string("\n") + title + "\n\n";
    for (std::size_t i = 0; i < body.spheres.size(); ++i) out += std::to_string(i + 1) + ' ' + line(i) + '\n';
  };
  section("Coords", [&](std::size_t i) {
    const Vec3 p = body.spheres[i].centre;
    return decimals({p.x, p.y, p.z});
  });
  section("Types", [](std::size_t) { return std::string("1"); });
  section("Diameters", [&](std::size_t i) { return decimals({2 * body.spheres[i].radius}); });
  section("Masses", [&](std::size_t i) { return decimals({body.sphere_mass_kg[i]}); });
  return out;
}

}  // namespace spherule
