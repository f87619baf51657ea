// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/enclosing.h"

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Min_sphere_of_spheres_d.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <tuple>
#include <vector>

#include "core/base/poll.h"
#include "core/measure/union.h"
#include "core/most_cells.h"
#include "core/spatial_order.h"
#include "core/trees/ball_tree.h"

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

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;

// Of unit length, from the middle of a cube of 27 to the others.
std::vector<Vec3> directions() {
  std::vector<Vec3> result;
  for (const double x : {-1.0, 0.0, 1.0})
    for (const double y : {-1.0, 0.0, 1.0})
      for (const double z : {-1.0, 0.0, 1.0})
        if (x != 0 || y != 0 || z != 0) result.push_back(normalised(Vec3{x, y, z}));
  return result;
}

// Each corner was found from three balls, in places that differ by rounding. Most of those fall together here; those
// that do not do no harm.
std::vector<Vec3> merged(std::vector<Vec3> corners, const Context& context) {
  double farthest = 0;
  for (const Vec3 c : corners) farthest = std::max({farthest, std::abs(c.x), std::abs(c.y), std::abs(c.z)});
  const double scale = farthest > 0 ? 0x1p40 / farthest : 0;
  const auto key = [&](Vec3 c) {
    return std::array{std::llround(scale * c.x), std::llround(scale * c.y), std::llround(scale * c.z)};
  };
  Poll poll(context);
  std::sort(corners.begin(), corners.end(), Polled(poll, [&](Vec3 a, Vec3 b) { return key(a) < key(b); }));
  const auto [end, last] = std::ranges::unique(corners, {}, key);
  corners.erase(end, last);
  return corners;
}

using Triangulation = CGAL::Delaunay_triangulation_3<Kernel>;

Triangulation triangulated(std::span<const Vec3> corners, const Context& context) {
  Poll poll(context, 64);
  const std::size_t most = most_cells(corners.size());
  Triangulation triangulation;
  Triangulation::Cell_handle near;
  for (const std::uint32_t i : insertion_order(corners, context)) {
    const Vec3 c = corners[i];
    poll();
    if (triangulation.number_of_cells() > most) {
      throw Error(
          ErrorCode::too_large,
          "The surface of the union of these spheres has too many corners that lie on few lines to look for the "
          "largest inscribed sphere; leave some of the spheres out.");
    }
    near = triangulation.insert({c.x, c.y, c.z}, near)->cell();
  }
  return triangulation;
}

// What the corners' Voronoi vertices may be the centres of, if larger than `least`.
std::vector<Sphere> empty_balls(std::span<const Vec3> corners, double least, const Context& context) {
  const Triangulation triangulation = triangulated(corners, context);
  std::vector<Sphere> result;
  Poll poll(context);
  for (auto cell = triangulation.finite_cells_begin(); cell != triangulation.finite_cells_end(); ++cell) {
    poll(8);
    const auto at = [&](int i) {
      const auto& p = cell->vertex(i)->point();
      return Vec3{p.x(), p.y(), p.z()};
    };
    const Vec3 a = at(1) - at(0), b = at(2) - at(0), c = at(3) - at(0);
    const double six_volumes = dot(a, cross(b, c));
    if (!(six_volumes > 0)) continue;
    const Vec3 centre =
        at(0) + 0.5 / six_volumes *
                    (squared_norm(a) * cross(b, c) + squared_norm(b) * cross(c, a) + squared_norm(c) * cross(a, b));
    double radius = norm(centre - at(0));
    for (int i = 1; i < 4; ++i) radius = std::min(radius, norm(centre - at(i)));
    if (radius > least) result.push_back({centre, radius});
  }
  return result;
}

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

Sphere largest_inscribed_sphere(std::span<const Sphere> balls, const Context& context) {
  const Sphere member = largest_sphere(balls);
  if (!(member.radius > 0)) return member;
  Context quiet = context;
  quiet.progress = nullptr;
  context.report("inscribed", 0);
  const std::vector<Vec3> corners = merged(union_corners(balls, quiet), context);
  // An inscribed ball is smaller than those that the corners' hull alone allows, and has its centre in some ball.
  constexpr double kShrink = 1 - 0x1p-30;
  std::vector<Sphere> candidates = empty_balls(corners, member.radius / kShrink, context);
  context.throw_if_cancelled();
  Poll poll(context);
  const auto before = [](const Sphere& a, const Sphere& b) {
    return std::tuple(-a.radius, a.centre.x, a.centre.y, a.centre.z) <
           std::tuple(-b.radius, b.centre.x, b.centre.y, b.centre.z);
  };
  std::sort(candidates.begin(), candidates.end(), Polled(poll, before));
  const detail::BallTree tree(balls, context);
  const auto covered = [&](Vec3 point) {
    return tree.any_overlapping({point, 0}, [&](std::uint32_t i) {
      return squared_norm(point - balls[i].centre) <= balls[i].radius * balls[i].radius;
    });
  };
  const std::vector<Vec3> probes = directions();
  for (const Sphere& candidate : candidates) {
    context.throw_if_cancelled();
    const Sphere tried{candidate.centre, kShrink * candidate.radius};
    // Nearly all that are not inside fail here, before all balls near them are looked at.
    const bool hopeless =
        std::ranges::any_of(probes, [&](Vec3 d) { return !covered(tried.centre + tried.radius * d); });
    if (!covered(tried.centre) || hopeless) continue;
    std::vector<Sphere> near;
    tree.any_overlapping(tried, [&](std::uint32_t i) {
      near.push_back(balls[i]);
      return false;
    });
    // Where its sphere is covered up to less than a cap of a height of 2^-41 radii.
    if (exposed_area(tried, near, quiet) < 0x1p-40 * tried.radius * tried.radius) return tried;
  }
  return member;
}

}  // namespace spherule
