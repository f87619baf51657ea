// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/shape.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/elementary.h"
#include "core/base/poll.h"
#include "core/measure/mass.h"
#include "core/measure/solid.h"
#include "core/measure/union.h"
#include "core/simplify/represent.h"
#include "core/simplify/splitting.h"
#include "core/trees/ball_tree.h"

namespace spherule {

namespace {

// Boundary points, each with the direction away from its pole; those without an inside ball are left out.
void add_boundary(Surface& surface, const SphereModel& model, std::size_t most, const Context& context) {
  Poll poll(context);
  const Solid& solid = *model.solid;
  const std::vector<LatticePoint>& points = solid.boundary.points;
  constexpr std::uint32_t none = 0xffffffffU;
  std::vector<std::uint32_t> pole(points.size(), none);
  for (std::uint32_t c = 0; c < solid.inside_count; ++c) {
    poll(8);
    for (const std::uint32_t p : solid.cells[c]) {
      if (pole[p] == none || model.spheres[c].radius > model.spheres[pole[p]].radius) pole[p] = c;
    }
  }
  const std::size_t step = (points.size() + most - 1) / most;
  for (std::size_t p = 0; p < points.size(); p += step) {
    if (pole[p] == none) continue;
    const Vec3 at = solid.boundary.lattice.to_patient(points[p]);
    surface.points.push_back(at);
    surface.normals.push_back(normalised(at - model.spheres[pole[p]].centre));
  }
  const Vec3 spacing = solid.boundary.lattice.grid.spacing;
  surface.spacing_mm = std::max({spacing.x, spacing.y, spacing.z}) * std::sqrt(static_cast<double>(step));
}

// Fibonacci spirals on the balls, as dense on each, but for what lies in another ball. Where little of a ball is to be
// seen, one point in the middle of it stands for as many such balls as make up a point's area.
void add_spheres(Surface& surface, std::span<const Sphere> balls, const UnionMeasures& whole, std::size_t most,
                 const Context& context) {
  Poll poll(context);
  const detail::BallTree tree(balls, context);
  const double each = std::max(whole.area_mm2 / static_cast<double>(most), 1e-300);
  double small = 0;
  constexpr double golden = std::numbers::pi * (3 - 2.2360679774997896964);
  for (std::uint32_t b = 0; b < balls.size(); ++b) {
    poll(4);
    const Sphere& ball = balls[b];
    const BallPart& part = whole.parts[b];
    const double area = 4 * std::numbers::pi * ball.radius * ball.radius, push = norm(part.push_mm2);
    if (part.area_mm2 < 0.1 * area) {
      small += part.area_mm2;
      if (small < each || push == 0) continue;
      small = 0;
      const Vec3 normal = (1 / push) * part.push_mm2;
      surface.points.push_back(ball.centre + ball.radius * normal);
      surface.normals.push_back(normal);
      continue;
    }
    const double count = std::ceil(area / each);
    for (double i = 0; i < count; ++i) {
      poll(64);
      const double z = 1 - (2 * i + 1) / count, across = std::sqrt(1 - z * z);
      const Vec3 normal{across * elementary::cos(golden * i), across * elementary::sin(golden * i), z};
      const Vec3 at = ball.centre + ball.radius * normal;
      const bool hidden = tree.any_overlapping({at, 0}, [&](std::uint32_t other) {
        const double within = balls[other].radius * (1 - 1e-9);
        return other != b && squared_norm(at - balls[other].centre) < within * within;
      });
      if (hidden) continue;
      surface.points.push_back(at);
      surface.normals.push_back(normal);
    }
  }
  surface.spacing_mm = std::sqrt(each);
}

}  // namespace

double Shape::size_mm() const { return elementary::cbrt(volume_mm3); }

Shape shape_of(const SphereModel& model, std::uint32_t k, std::size_t most_points, const Context& context) {
  const auto no_volume = [] {
    return Error(ErrorCode::unusable, "A model without volume cannot be registered; choose one with spheres.");
  };
  if (model.spheres.empty()) throw no_volume();
  Shape shape;
  Moments moments;
  std::vector<double> shares;
  UnionMeasures whole;
  if (model.solid) {
    moments = tetrahedra_moments(*model.solid, context);
    shares = volume_shares(model, context);
  } else {
    whole = measure_union(model.spheres, context);
    moments = whole.moments;
    for (const BallPart& part : whole.parts) shares.push_back(part.volume_mm3);
  }
  if (!(moments.volume > 0)) throw no_volume();
  shape.volume_mm3 = moments.volume;
  shape.centroid = (1 / moments.volume) * moments.first;
  shape.covariance = translated(moments, -shape.centroid).second;
  for (Vec3& row : shape.covariance.rows) row = (1 / moments.volume) * row;
  for (const Sphere& s : model.spheres) shape.radius_max_mm = std::max(shape.radius_max_mm, s.radius);

  if (model.spheres.size() <= k) {
    shape.spheres = model.spheres;
    shape.masses = shares;
  } else {
    const Simplification few = split_spheres(
        model, {.at = SplittingOptions::At::average, .k = k, .representative = Representative::mean}, context);
    const MemberLists members = members_at(few, k);
    shape.spheres = spheres_at(few, k);
    for (std::size_t i = 0; i < members.count(); ++i) {
      double mass = 0;
      for (const std::uint32_t m : members.of(i)) mass += shares[m];
      shape.masses.push_back(mass);
    }
  }
  if (model.solid) {
    add_boundary(shape.surface, model, most_points, context);
  } else {
    add_spheres(shape.surface, model.spheres, whole, most_points, context);
  }
  shape.surface.tree = detail::PointTree(shape.surface.points);
  return shape;
}

}  // namespace spherule
