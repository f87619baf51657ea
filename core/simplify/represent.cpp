// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/represent.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/measure/enclosing.h"
#include "core/measure/union.h"
#include "core/predicates.h"

namespace spherule {

namespace {

constexpr std::size_t kGrain = 1 << 14;

std::vector<double> tetrahedron_volumes(const Solid& solid, const Context& context) {
  const auto& points = solid.boundary.points;
  const double unit = solid.boundary.lattice.unit_mm, sixth = unit * unit * unit / 6;
  std::vector<double> volumes(solid.inside_count);
  parallel_for(context, {}, volumes.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto& [p, q, r, s] = solid.cells[c];
      volumes[c] = sixth * static_cast<double>(exact::six_volumes(points[p], points[q], points[r], points[s]));
    }
  });
  return volumes;
}

}  // namespace

std::vector<double> volume_shares(const SphereModel& model, const Context& context) {
  std::vector<double> shares;
  if (model.solid) {
    shares = tetrahedron_volumes(*model.solid, context);
  } else {
    for (const BallPart& part : measure_union(model, context).parts) shares.push_back(part.volume_mm3);
  }
  if (std::ranges::all_of(shares, [](double share) { return share == 0; })) std::ranges::fill(shares, 1.0);
  return shares;
}

Sphere represent(Representative by, std::span<const Sphere> balls, std::span<const double> shares,
                 std::span<const std::uint32_t> members) {
  switch (by) {
    case Representative::enclosing: {
      std::vector<Sphere> all;
      for (const std::uint32_t m : members) all.push_back(balls[m]);
      return smallest_enclosing_sphere(all);
    }
    case Representative::largest:
      return balls[*std::ranges::max_element(members, {}, [&](std::uint32_t m) { return balls[m].radius; })];
    case Representative::mean:
    case Representative::volume: break;
  }
  double total = 0;
  for (const std::uint32_t m : members) total += shares[m];
  // Measured from one member, so that an object far from the origin loses no digits.
  const Vec3 origin = balls[members[0]].centre;
  Vec3 centre;
  double radius = 0, weights = 0;
  for (const std::uint32_t m : members) {
    const double weight = total > 0 ? shares[m] : 1;
    weights += weight;
    centre = centre + weight * (balls[m].centre - origin);
    radius += weight * balls[m].radius;
  }
  const double of_volume = elementary::cbrt(3 * total / (4 * std::numbers::pi));
  return {origin + (1 / weights) * centre,
          by == Representative::mean ? std::max(radius / weights, of_volume) : of_volume};
}

}  // namespace spherule
