// SPDX-License-Identifier: GPL-3.0-or-later
//
// Random transforms, and models under them, for the tests of registration.
#pragma once

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/pipeline.h"
#include "core/register/transform.h"
#include "core/spheres.h"
#include "tests/phantoms.h"

namespace spherule::poses {

inline Vec3 within_cube(phantoms::Random& random, double edge) {
  const double x = random.unit() - 0.5, y = random.unit() - 0.5, z = random.unit() - 0.5;
  return {edge * x, edge * y, edge * z};
}

/// Uniform (K. Shoemake, Uniform random rotations, 1992).
inline Mat3 random_rotation(phantoms::Random& random) {
  const double u = random.unit(), a = 2 * std::numbers::pi * random.unit(), b = 2 * std::numbers::pi * random.unit();
  const double r = std::sqrt(1 - u), s = std::sqrt(u);
  return rotation(Quaternion{s * std::cos(b), r * std::sin(a), r * std::cos(a), s * std::sin(b)});
}

/// Within `size` of the origin the maps differ by less than `tolerance` times it.
inline void expect_maps_near(const AffineMap& a, const AffineMap& b, double tolerance, double size) {
  for (const Vec3 p : {Vec3{0, 0, 0}, Vec3{size, 0, 0}, Vec3{0, size, 0}, Vec3{0, 0, size}})
    EXPECT_LT(norm(a(p) - b(p)), tolerance * std::max(size, norm(b(p))));
}

/// Three balls of different sizes and a bar: no symmetry, thick and thin parts. About 8 mm across.
inline phantoms::Field lopsided() {
  using phantoms::ball, phantoms::either;
  return either(either(ball({-1.6, 0.1, 0.2}, 1.5), ball({1.4, 0.9, -0.4}, 1.0)),
                either(ball({0.6, -1.9, 1.3}, 0.7), phantoms::capped_cylinder({-1.2, 0.6, 1.6}, 0.45, 1.6)));
}

/// The field as seen through a map: what is at x in the field's frame is at map(x). Distances grow with the map.
inline phantoms::Field moved(phantoms::Field field, const AffineMap& map) {
  return
      [field = std::move(field), back = inverse(map), scale = scale_of(map)](Vec3 p) { return scale * field(back(p)); };
}

/// A raw model of a field that lies within `reach` of `centre`, on a grid of n samples along each axis.
inline SphereModel raw_model(const phantoms::Field& field, Vec3 centre, double reach, std::int32_t n) {
  Grid grid = phantoms::cubic_grid(n, 2 * reach);
  grid.origin = grid.origin + centre;
  return build_model(phantoms::sample(field, grid), phantoms::threshold(0)).model;
}

}  // namespace spherule::poses
