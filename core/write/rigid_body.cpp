// SPDX-License-Identifier: GPL-3.0-or-later
#include <array>
#include <map>

#include "core/base/check.h"
#include "core/base/error.h"
#include "core/measure/mass.h"
#include "core/write/export_bodies.h"

namespace spherule {

RigidBody rigid_body(std::span<const Sphere> balls, const UnionMeasures& whole, double density, BodyOrigin origin) {
  SPHERULE_CHECK(whole.parts.size() == balls.size());
  const MassProperties mass = mass_properties(whole.moments);
  if (!(mass.volume_mm3 > 0)) {
    throw Error(ErrorCode::unusable, "The spheres have no volume, so they are no rigid body; send larger radii.");
  }
  RigidBody body;
  body.density_kg_m3 = density;
  if (origin == BodyOrigin::centre) body.origin_mm = mass.centroid_mm;
  // Divided by powers of ten: the quotient of two exact numbers prints as short as it is.
  const auto metres = [&](Vec3 mm) {
    const Vec3 d = mm - body.origin_mm;
    return Vec3{d.x / 1e3, d.y / 1e3, d.z / 1e3};
  };
  body.volume_m3 = mass.volume_mm3 / 1e9;
  body.mass_kg = density * body.volume_m3;
  body.centre_m = metres(mass.centroid_mm);
  for (std::size_t i = 0; i < 3; ++i) body.inertia_kg_m2.rows[i] = (density * 1e-15) * mass.inertia_mm5.rows[i];
  // Cells with one circumsphere are the rule in raw models.
  std::map<std::array<double, 4>, std::size_t> known;
  for (std::size_t i = 0; i < balls.size(); ++i) {
    const Vec3 c = balls[i].centre;
    if (!(whole.parts[i].volume_mm3 > 0)) continue;
    const auto [at, added] = known.try_emplace({c.x, c.y, c.z, balls[i].radius}, body.spheres.size());
    if (added) {
      body.spheres.push_back({metres(c), balls[i].radius / 1e3});
      body.sphere_mass_kg.push_back(0);
    }
    body.sphere_mass_kg[at->second] += density * (whole.parts[i].volume_mm3 / 1e9);
  }
  return body;
}

}  // namespace spherule
