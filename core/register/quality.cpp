// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/quality.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <optional>
#include <vector>

#include "core/base/parallel.h"
#include "core/measure/union.h"
#include "core/trees/ball_tree.h"

namespace spherule {

namespace {

// Within [0, 1], which rounding may leave where there is nothing in common or nothing else.
UnionOverlap of_volumes(double fixed, double moving, double both, double either) {
  UnionOverlap overlap;
  if (fixed + moving > 0) overlap.dice = std::clamp(2 * both / (fixed + moving), 0.0, 1.0);
  if (either > 0) overlap.iou = std::clamp(both / either, 0.0, 1.0);
  return overlap;
}

bool holds(const detail::BallTree& tree, Vec3 point) {
  return tree.any_overlapping({point, 0}, [](std::uint32_t) { return true; });
}

}  // namespace

UnionOverlap exact_overlap(std::span<const Sphere> fixed, std::span<const Sphere> moving, const AffineMap& map,
                           const Context& context) {
  const double scale = scale_of(map);
  std::vector<Sphere> moved;
  for (const Sphere& ball : moving) moved.push_back({map(ball.centre), scale * ball.radius});
  std::vector<Sphere> all(fixed.begin(), fixed.end());
  all.insert(all.end(), moved.begin(), moved.end());
  const double a = measure_union(fixed, context).moments.volume, b = measure_union(moved, context).moments.volume,
               either = measure_union(all, context).moments.volume;
  UnionOverlap overlap = of_volumes(a, b, a + b - either, either);
  overlap.exact = true;
  return overlap;
}

UnionOverlap sampled_overlap(const SphereModel& fixed, const SphereModel& moving, const AffineMap& map,
                             std::size_t samples, const Context& context) {
  std::array<std::optional<detail::BallTree>, 2> trees;
  parallel_for(context, {}, 2, 1,
               [&](std::size_t i, std::size_t) { trees[i].emplace((i == 0 ? fixed : moving).spheres, context); });
  const AffineMap back = inverse(map);
  Box box, other;
  for (const Sphere& ball : fixed.spheres) box.include(ball);
  for (const Sphere& ball : moving.spheres) other.include(ball);
  for (int corner = 0; corner < 8; ++corner) {
    box.include(map({corner & 1 ? other.max.x : other.min.x, corner & 2 ? other.max.y : other.min.y,
                     corner & 4 ? other.max.z : other.min.z}));
  }
  constexpr std::size_t kGrain = 1024;
  std::vector<std::array<std::size_t, 3>> counts((samples + kGrain - 1) / kGrain);
  parallel_for(context, {}, samples, kGrain, [&](std::size_t begin, std::size_t end) {
    std::array<std::size_t, 3>& count = counts[begin / kGrain];
    for (std::size_t i = begin; i < end; ++i) {
      // M. Roberts's R3 sequence: multiples of the powers of 1/g, g the root of x^4 = x + 1.
      constexpr double g = 1.22074408460575947536;
      const auto at = [&](double step) {
        double whole = 0;
        return std::modf(0.5 + step * static_cast<double>(i + 1), &whole);
      };
      const Vec3 unit{at(1 / g), at(1 / (g * g)), at(1 / (g * g * g))};
      const Vec3 point{box.min.x + unit.x * (box.max.x - box.min.x), box.min.y + unit.y * (box.max.y - box.min.y),
                       box.min.z + unit.z * (box.max.z - box.min.z)};
      const bool a = holds(*trees[0], point), b = holds(*trees[1], back(point));
      count[0] += a;
      count[1] += b;
      count[2] += a && b;
    }
  });
  double a = 0, b = 0, both = 0;
  for (const auto& count : counts) {
    a += static_cast<double>(count[0]);
    b += static_cast<double>(count[1]);
    both += static_cast<double>(count[2]);
  }
  return of_volumes(a, b, both, a + b - both);
}

}  // namespace spherule
