// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls in a tree of boxes, for questions about those near a place.
#pragma once

#include <algorithm>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/base/poll.h"

namespace spherule::detail {

/// Whether two closed balls meet, within a relative 1e-12 of their distance: balls that share a point always do.
inline bool overlap(const Sphere& a, const Sphere& b) {
  const double sum = a.radius + b.radius;
  return squared_norm(a.centre - b.centre) <= sum * sum * (1 + 1e-12);
}

/// Built once over balls that must outlive it. The balls are ordered along a Morton curve and every eight neighbours
/// share a box. Immutable, so safe to share. O(n log n) to build, which can be cancelled; about 16 bytes a ball, twice
/// that while it is built.
class BallTree {
 public:
  explicit BallTree(std::span<const Sphere> balls, const Context& context = {});

  /// The balls' indices along the curve: neighbours in it are mostly neighbours in space.
  std::span<const std::uint32_t> order() const { return order_; }

  /// Calls visit(index) for the balls that overlap `ball`, itself included, until one returns true. Whether one did.
  template <typename Visit>
  bool any_overlapping(const Sphere& ball, Visit&& visit) const {
    return descend(
        levels_.size(), 0, [&](const Node& node) { return may_overlap(node, ball); },
        [&](std::uint32_t i) { return overlap(ball, balls_[i]) && visit(i); });
  }

  /// The ball of the least power distance |x - c|² - r² to a point; the least index among equal ones.
  std::uint32_t nearest_by_power(Vec3 point) const;

 private:
  friend class Untaken;
  friend class Taken;
  struct Node {
    Box centres;
    double largest = 0;                 // radius
    std::uint32_t first = 0xffffffffU;  // index
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

  static bool may_overlap(const Node& node, const Sphere& ball) {
    const double sum = ball.radius + node.largest;
    return distance_squared(node.centres, ball.centre) <= sum * sum * (1 + 1e-12);
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

/// The balls of a tree that nobody took yet. Whoever takes all that overlap a ball, and then all that overlap those,
/// visits no ball again: the components of a union take O(n log n) however many pairs overlap. Not thread safe. The
/// tree must outlive it; 9 bytes a ball.
class Untaken {
 public:
  explicit Untaken(const BallTree& tree) : tree_(tree) {
    std::size_t count = tree.order_.size();
    for (left_.emplace_back(count, 1U); left_.size() <= tree.levels_.size();) {
      count = (count + BallTree::kFan - 1) / BallTree::kFan;
      std::vector<std::uint32_t> level(count, 0);
      for (std::size_t i = 0; i < left_.back().size(); ++i) level[i / BallTree::kFan] += left_.back()[i];
      left_.push_back(std::move(level));
    }
  }

  /// How many balls were taken and not put back. O(1).
  std::size_t taken() const { return log_.size(); }
  /// Puts back what was taken since there were this many. O(log n) a ball.
  void put_back_to(std::size_t count) {
    for (; log_.size() > count; log_.pop_back()) {
      std::size_t i = log_.back();
      for (auto& level : left_) ++level[i], i /= BallTree::kFan;
    }
  }

  /// Calls take(index) for every untaken ball that overlaps `ball`, to the tolerance of overlap(); those for which it
  /// returns true are taken.
  template <typename Take>
  void take_overlapping(const Sphere& ball, Take&& take) {
    if (!tree_.levels_.empty()) descend(tree_.levels_.size(), 0, ball, take);
  }

 private:
  // How many were taken.
  template <typename Take>
  std::uint32_t descend(std::size_t level, std::size_t i, const Sphere& ball, Take& take) {
    std::uint32_t& left = left_[level][i];
    if (left == 0) return 0;
    std::uint32_t taken = 0;
    if (level == 0) {
      const std::uint32_t index = tree_.order_[i];
      taken = overlap(ball, tree_.balls_[index]) && take(index) ? 1 : 0;
      if (taken != 0) log_.push_back(static_cast<std::uint32_t>(i));
    } else if (BallTree::may_overlap(tree_.levels_[level - 1][i], ball)) {
      const std::size_t end = std::min(left_[level - 1].size(), (i + 1) * BallTree::kFan);
      for (std::size_t child = i * BallTree::kFan; child < end; ++child) taken += descend(level - 1, child, ball, take);
    }
    left -= taken;
    return taken;
  }

  const BallTree& tree_;
  std::vector<std::vector<std::uint32_t>> left_;  // by level: under each node, and of each ball
  std::vector<std::uint32_t> log_;                // places of the taken ones
};

/// Balls of a tree that were taken, for whether one of them holds another. Not thread safe. The tree must outlive it; 9
/// bytes a ball.
class Taken {
 public:
  explicit Taken(const BallTree& tree);

  /// Takes the ball order()[place] of the tree. O(log n).
  void take(std::size_t place);
  /// Whether one of them, grown by `slack`, holds the ball. Expected O(log n) where that is so, or few are as large
  /// near it; at worst all are compared. Throws cancelled.
  bool any_holding(const Sphere& ball, double slack, Poll& poll) const {
    return !tree_.levels_.empty() && any_holding(tree_.levels_.size(), 0, ball, slack, poll);
  }

 private:
  bool any_holding(std::size_t level, std::size_t i, const Sphere& ball, double slack, Poll& poll) const;

  const BallTree& tree_;
  std::vector<std::vector<double>> largest_;  // by level: radius of those taken under each node, and of each ball
};

}  // namespace spherule::detail
