// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/spheres.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <numeric>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/interpolated_object.h"
#include "core/predicates.h"

namespace spherule {

namespace {

constexpr std::size_t kGrain = 1 << 12;

Vec3 to_vec3(exact::Difference d) {
  return {static_cast<double>(d.x), static_cast<double>(d.y), static_cast<double>(d.z)};
}
Vec3 to_vec3(LatticePoint p) { return {static_cast<double>(p.x), static_cast<double>(p.y), static_cast<double>(p.z)}; }

// Circumcentre minus the first corner, in lattice units. Numerators and denominator are exact integers, each rounded
// once and divided: every component has a relative error below 3 · 2^-53, whatever the shape of the cell.
//   centre - a = (|b|² c×d + |c|² d×b + |d|² b×c) / (2 det(b, c, d)),   b, c, d taken from a
// Bound: a component of a cross product is below 2^49, times 2^49.6, three of them: below 2^101.
Vec3 centre_offset(exact::Difference b, exact::Difference c, exact::Difference d) {
  const exact::Wide bb = exact::squared_length(b), cc = exact::squared_length(c), dd = exact::squared_length(d);
  const auto x = bb * (c.y * d.z - c.z * d.y) + cc * (d.y * b.z - d.z * b.y) + dd * (b.y * c.z - b.z * c.y);
  const auto y = bb * (c.z * d.x - c.x * d.z) + cc * (d.z * b.x - d.x * b.z) + dd * (b.z * c.x - b.x * c.z);
  const auto z = bb * (c.x * d.y - c.y * d.x) + cc * (d.x * b.y - d.y * b.x) + dd * (b.x * c.y - b.y * c.x);
  const double twice = 2 * static_cast<double>(exact::determinant(b, c, d));
  return {static_cast<double>(x) / twice, static_cast<double>(y) / twice, static_cast<double>(z) / twice};
}

// How far off, in lattice units, a centre may be that only chooses which exact question to ask.
constexpr double kCentreError = 0x1p-10;

// centre_offset in double wherever that is good to `error` units, which is nearly everywhere; exact for the rest, the
// slivers. Differences, cross products (< 2^49) and squared lengths (< 2^50) are exact in double; each sum of three
// products is off by less than 2^-51 of the sum of their magnitudes, the division by less than 2^-53 of the result.
Vec3 centre_offset_within(double error, exact::Difference bi, exact::Difference ci, exact::Difference di) {
  const Vec3 b = to_vec3(bi), c = to_vec3(ci), d = to_vec3(di);
  const Vec3 cd = cross(c, d), db = cross(d, b), bc = cross(b, c);
  const double bb = squared_norm(b), cc = squared_norm(c), dd = squared_norm(d);
  const double twice = 2 * dot(b, cd);
  const double twice_error = 0x1p-50 * (std::abs(b.x * cd.x) + std::abs(b.y * cd.y) + std::abs(b.z * cd.z));
  Vec3 offset;
  for (int axis = 0; axis < 3; ++axis) {
    const double p = bb * cd[axis], q = cc * db[axis], r = dd * bc[axis];
    offset[axis] = (p + q + r) / twice;
    const double numerator_error = 0x1p-51 * (std::abs(p) + std::abs(q) + std::abs(r));
    if (!(numerator_error + std::abs(offset[axis]) * twice_error < 0.5 * error * twice))
      return centre_offset(bi, ci, di);
  }
  return offset;
}

bool cell_is_inside(const InterpolatedObject& object, LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  using exact::operator-;
  const Vec3 offset = centre_offset_within(kCentreError, b - a, c - a, d - a);
  return object.has_ball(to_vec3(a) + offset, kCentreError, [&](LatticePoint sample) {
    const Vec3 to_sample = to_vec3(sample - a);
    // Inside the ball: |s - a|² < 2 (s - a)·offset. The left side is exact.
    const double depth = 2 * dot(to_sample, offset) - squared_norm(to_sample);
    const double reach = std::abs(to_sample.x) + std::abs(to_sample.y) + std::abs(to_sample.z);
    const double error =
        reach * (2 * kCentreError + 0x1p-50 * (reach + std::abs(offset.x) + std::abs(offset.y) + std::abs(offset.z)));
    return depth >= -error && (depth > error || exact::in_sphere(a, b, c, d, sample) > 0);
  });
}

// Moves the flagged cells to the front; both parts keep their order. One transient copy of the outside part.
std::size_t inside_first(Tetrahedralization& cells, const std::vector<std::uint8_t>& inside, const Context& context) {
  Poll poll(context);
  Tetrahedralization outside;
  outside.reserve(cells.size() -
                  static_cast<std::size_t>(std::accumulate(inside.begin(), inside.end(), std::size_t{0})));
  std::size_t kept = 0;
  for (std::size_t c = 0; c < cells.size(); ++c) {
    poll();
    if (inside[c]) {
      cells[kept++] = cells[c];
    } else {
      outside.push_back(cells[c]);
    }
  }
  std::ranges::copy(outside, cells.begin() + static_cast<std::ptrdiff_t>(kept));
  return kept;
}

}  // namespace

SphereModel classify_spheres(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                             BoundaryPoints boundary, Tetrahedralization cells, const Context& context) {
  const auto& points = boundary.points;
  std::vector<std::uint8_t> inside(cells.size());
  const InterpolatedObject object(volume, rule, samples.inside, boundary.lattice);
  parallel_for(context, "spheres", cells.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto& [p, q, r, s] = cells[c];
      inside[c] = cell_is_inside(object, points[p], points[q], points[r], points[s]);
    }
  });
  const std::size_t inside_count = inside_first(cells, inside, context);
  SphereModel model;
  model.spheres = circumspheres(boundary.lattice, points, cells, inside_count, context);
  model.solid = Solid{.boundary = std::move(boundary), .cells = std::move(cells), .inside_count = inside_count};
  return model;
}

Sphere circumsphere(const std::array<LatticePoint, 4>& corners) {
  using exact::operator-;
  const auto& [a, b, c, d] = corners;
  const std::array<exact::Difference, 3> edges{b - a, c - a, d - a};
  const Vec3 offset = centre_offset(edges[0], edges[1], edges[2]);
  double least = squared_norm(offset);
  for (const auto& e : edges) least = std::min(least, squared_norm(offset - to_vec3(e)));
  return {to_vec3(a) + offset, std::sqrt(least)};
}

std::vector<Sphere> circumspheres(const Lattice& lattice, std::span<const LatticePoint> points,
                                  std::span<const Tetrahedron> cells, std::size_t count, const Context& context) {
  SPHERULE_CHECK(count <= cells.size());
  std::vector<Sphere> spheres(count);
  parallel_for(context, {}, count, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto& [p, q, r, s] = cells[c];
      const Sphere ball = circumsphere({points[p], points[q], points[r], points[s]});
      spheres[c] = {lattice.to_patient(ball.centre), lattice.unit_mm * ball.radius};
    }
  });
  return spheres;
}

double boundary_point_density(const Solid& solid, const Context& context) {
  using exact::operator-;
  const auto& points = solid.boundary.points;
  constexpr std::int64_t kNone = std::numeric_limits<std::int64_t>::max();
  std::vector<std::int64_t> nearest(points.size(), kNone);
  Poll poll(context);
  for (const Tetrahedron& t : solid.cells) {
    poll(8);
    for (std::size_t i = 0; i < 4; ++i) {
      for (std::size_t j = i + 1; j < 4; ++j) {
        const std::int64_t d = exact::squared_length(points[t[i]] - points[t[j]]);
        nearest[t[i]] = std::min(nearest[t[i]], d);
        nearest[t[j]] = std::min(nearest[t[j]], d);
      }
    }
  }
  context.throw_if_cancelled();
  std::int64_t largest = 0;
  for (const std::int64_t d : nearest) largest = std::max(largest, d == kNone ? 0 : d);
  return solid.boundary.lattice.unit_mm * std::sqrt(static_cast<double>(largest));
}

Box bounds(const SphereModel& model) {
  Box box;
  if (model.solid) {
    for (const LatticePoint p : model.solid->boundary.points) box.include(model.solid->boundary.lattice.to_patient(p));
  } else {
    for (const Sphere& s : model.spheres) box.include(s);
  }
  return box;
}

}  // namespace spherule
