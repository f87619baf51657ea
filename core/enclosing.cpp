// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/enclosing.h"

#include <CGAL/Min_sphere_of_spheres_d.h>

#include <algorithm>

namespace spherule {

namespace {

// How CGAL reads our balls.
struct Traits {
  using Sphere = spherule::Sphere;
  static constexpr int D = 3;
  using FT = double;
  using Cartesian_const_iterator = const double*;
  using Use_square_roots = CGAL::Tag_true;
  using Algorithm = CGAL::Farthest_first_heuristic;

  static double radius(const Sphere& ball) { return ball.radius; }
  static const double* center_cartesian_begin(const Sphere& ball) { return &ball.centre.x; }
};
static_assert(sizeof(Vec3) == 3 * sizeof(double));

}  // namespace

Sphere smallest_enclosing_sphere(std::span<const Sphere> balls) {
  if (balls.empty()) return {};
  CGAL::Min_sphere_of_spheres_d<Traits> smallest(balls.begin(), balls.end());
  const auto* centre = smallest.center_cartesian_begin();
  Sphere result{{centre[0], centre[1], centre[2]}, 0};
  for (const Sphere& ball : balls) {
    result.radius = std::max(result.radius, norm(ball.centre - result.centre) + ball.radius);
  }
  return result;
}

Sphere largest_sphere(std::span<const Sphere> balls) {
  return balls.empty() ? Sphere{} : *std::ranges::max_element(balls, {}, &Sphere::radius);
}

}  // namespace spherule
