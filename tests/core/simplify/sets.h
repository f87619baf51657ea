// SPDX-License-Identifier: GPL-3.0-or-later
//
// Sets of balls that the tests of simplification share.
#pragma once

#include <cstdint>
#include <numeric>
#include <vector>

#include "core/pipeline.h"
#include "core/spheres.h"
#include "tests/phantoms.h"

namespace spherule::sets {

/// Balls with centres in a cube of this edge about the origin and radii within [least, most].
inline SphereModel random_balls(std::size_t count, double edge, double least, double most, std::uint64_t seed) {
  phantoms::Random random(seed);
  const auto within = [&](double lo, double hi) { return lo + (hi - lo) * random.unit(); };
  SphereModel model;
  for (std::size_t i = 0; i < count; ++i) {
    const double x = within(-edge / 2, edge / 2), y = within(-edge / 2, edge / 2), z = within(-edge / 2, edge / 2);
    model.spheres.push_back({{x, y, z}, within(least, most)});
  }
  return model;
}

inline std::vector<std::uint32_t> all_of(const SphereModel& model) {
  std::vector<std::uint32_t> all(model.spheres.size());
  std::iota(all.begin(), all.end(), 0U);
  return all;
}

/// A dumbbell: two balls and a thin bar, so that splitting it leaves several components.
inline phantoms::Field dumbbell() {
  const phantoms::Field left = phantoms::ball({-1.1, 0.013, 0.021}, 0.7),
                        right = phantoms::ball({1.1, 0.007, -0.011}, 0.6);
  return phantoms::either(phantoms::either(left, right),
                          [](Vec3 p) { return std::min(1.1 - std::abs(p.x), 0.25 - std::hypot(p.y - 0.01, p.z)); });
}

inline SphereModel raw_model(const phantoms::Field& field, std::int32_t n = 20) {
  return build_model(phantoms::sample(field, phantoms::cubic_grid(n, 4)), phantoms::threshold(0)).model;
}

}  // namespace spherule::sets
