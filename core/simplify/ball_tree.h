// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls in a tree of boxes, for questions about those near a place. Private to core/simplify.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/geometry.h"

namespace spherule::detail {

/// Whether two closed balls meet, within a relative 1e-12 of their distance: balls that share a point always do.
inline bool overlap(const Sphere& a, const Sphere& b) {
  const double sum = a.radius + b.radius;
  return squared_norm(a.centre - b.centre) <= sum * sum * (1 + 1e-12);
}

/// Built once over balls that must outlive it. The balls are ordered along a Morton curve and every eight neighbours
/// share a box. Immutable, so safe to share. O(n log n) to build; about 16 bytes a ball.
class BallTree {
 public:
  explicit BallTree(std::span<const Sphere> balls);

  /// The balls' indices along the curve: neighbours in it are mostly neighbours in space.
  std::span<const std::uint32_t> order() const { return order_; }

  /// Calls visit(index) for the balls that overlap `ball`, itself included, until one returns true. Whether one did.
  template <typename Visit>
  bool any_overlapping(const Sphere& ball, Visit&& visit) const {
    return descend(
        levels_.size(), 0,
        [&](const Node& node) {
          const double sum = ball.radius + node.largest;
          return distance_squared(node.centres, ball.centre) <= sum * sum * (1 + 1e-12);
        },
        [&](std::uint32_t i) { return overlap(ball, balls_[i]) && visit(i); });
  }

  /// The ball of the least power distance |x - c|² - r² to a point; the least index among equal ones.
  std::uint32_t nearest_by_power(Vec3 point) const;

 private:
  struct Node {
    Box centres;
    double largest = 0;  // radius
  };
  static constexpr std::size_t kFan = 8;

  static double distance_squared(const Box& box, Vec3 p) {
    double sum = 0;
    for (int a = 0; a < 3; ++a) {
      const double beyond = std::max({box.min[a] - p[a], p[a] - box.max[a], 0.0});
      sum += beyond * beyond;
    }
    return sum;
  }

  // Level 0 is the balls themselves, level l > 0 the nodes levels_[l - 1]; the last level has one node.
  template <typename Enter, typename Leaf>
  bool descend(std::size_t level, std::size_t i, Enter&& enter, Leaf&& leaf) const {
    if (level == 0) return leaf(order_[i]);
    if (!enter(levels_[level - 1][i])) return false;
    const std::size_t below = level == 1 ? order_.size() : levels_[level - 2].size();
    for (std::size_t child = i * kFan; child < std::min(below, (i + 1) * kFan); ++child) {
      if (descend(level - 1, child, enter, leaf)) return true;
    }
    return false;
  }

  std::span<const Sphere> balls_;
  std::vector<std::uint32_t> order_;
  std::vector<std::vector<Node>> levels_;
};

}  // namespace spherule::detail
