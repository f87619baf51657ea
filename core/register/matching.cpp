// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/matching.h"

#include <algorithm>
#include <cmath>

#include "core/base/elementary.h"
#include "core/register/assignment.h"

namespace spherule {

std::vector<Vec3> match_features(const Shape& shape) {
  constexpr std::size_t kNear = 6;
  const double size = shape.size_mm();
  std::vector<Vec3> features;
  std::vector<double> distances;
  for (std::size_t i = 0; i < shape.spheres.size(); ++i) {
    const Vec3 at = shape.spheres[i].centre;
    distances.clear();
    for (std::size_t j = 0; j < shape.spheres.size(); ++j) {
      if (j != i) distances.push_back(norm(shape.spheres[j].centre - at));
    }
    const std::size_t near = std::min(kNear, distances.size());
    std::partial_sort(distances.begin(), distances.begin() + static_cast<std::ptrdiff_t>(near), distances.end());
    double mean = 0;
    for (std::size_t n = 0; n < near; ++n) mean += distances[n] / static_cast<double>(near);
    features.push_back(
        {norm(at - shape.centroid) / size, elementary::cbrt(shape.masses[i] / shape.volume_mm3), mean / size});
  }
  return features;
}

std::vector<SpherePair> match_spheres(const Shape& fixed, const Shape& moving, const AffineMap& map,
                                      const MatchingWeights& weights, const Context& context) {
  const std::vector<Vec3> f = match_features(fixed), m = match_features(moving);
  const double size = fixed.size_mm(), scale = scale_of(map);
  // Radii of 0 (imported points) are as good as tiny ones.
  const double least = 1e-6 * size;
  std::vector<double> costs;
  costs.reserve(f.size() * m.size());
  for (std::size_t i = 0; i < m.size(); ++i) {
    const Vec3 at = map(moving.spheres[i].centre);
    const double radius = std::max(scale * moving.spheres[i].radius, least);
    for (std::size_t j = 0; j < f.size(); ++j) {
      costs.push_back(weights.position * norm(fixed.spheres[j].centre - at) / size +
                      weights.size * std::abs(elementary::log(std::max(fixed.spheres[j].radius, least) / radius)) +
                      weights.shape * norm(f[j] - m[i]));
    }
  }
  std::vector<SpherePair> pairs;
  const std::vector<std::uint32_t> partner = assign(costs, f.size(), weights.alone, context);
  for (std::uint32_t i = 0; i < partner.size(); ++i) {
    if (partner[i] != unmatched) pairs.push_back({i, partner[i]});
  }
  return pairs;
}

std::vector<PointPair> point_pairs(const Shape& fixed, const Shape& moving, std::span<const SpherePair> pairs) {
  std::vector<PointPair> points;
  for (const SpherePair& p : pairs) {
    const double share = (fixed.masses[p.fixed] / fixed.volume_mm3) * (moving.masses[p.moving] / moving.volume_mm3);
    points.push_back({.moving = moving.spheres[p.moving].centre,
                      .fixed = fixed.spheres[p.fixed].centre,
                      .weight = std::sqrt(share)});
  }
  return points;
}

AffineMap match_from(const Shape& fixed, const Shape& moving, const AffineMap& start, TransformKind kind,
                     const MatchingWeights& weights, int rounds, const Context& context) {
  AffineMap map = start;
  std::vector<SpherePair> before;
  for (int round = 0; round < rounds; ++round) {
    std::vector<SpherePair> pairs = match_spheres(fixed, moving, map, weights, context);
    if (pairs.size() < 3 || pairs == before) break;
    map = solve(kind, point_pairs(fixed, moving, pairs));
    before = std::move(pairs);
  }
  return map;
}

double radius_ratio(const Shape& fixed, const Shape& moving) {
  return moving.radius_max_mm > 0 ? fixed.radius_max_mm / moving.radius_max_mm : 1;
}

}  // namespace spherule
