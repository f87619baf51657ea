// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/trees/ball_tree.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>

#include "core/trees/morton.h"

namespace spherule::detail {

BallTree::BallTree(std::span<const Sphere> balls, const Context& context) : balls_(balls) {
  Poll poll(context);
  Box box;
  for (const Sphere& ball : balls) poll(), box.include(ball.centre);
  double edge = 0;
  for (int a = 0; a < 3; ++a) edge = std::max(edge, box.max[a] - box.min[a]);
  const double scale = edge > 0 ? 0x1fffff / edge : 0;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(balls.size());
  for (std::uint32_t i = 0; i < balls.size(); ++i) {
    poll();
    const Vec3 p = scale * (balls[i].centre - box.min);
    keys[i] = {along_morton_curve(p), i};
  }
  std::sort(keys.begin(), keys.end(), Polled(poll, std::less<>()));
  order_.reserve(keys.size());
  for (const auto& [key, i] : keys) order_.push_back(i);

  for (std::size_t below = order_.size(); below > 0;) {
    std::vector<Node> nodes((below + kFan - 1) / kFan);
    for (std::size_t i = 0; i < below; ++i) {
      poll();
      Node& node = nodes[i / kFan];
      if (levels_.empty()) {
        node.centres.include(balls_[order_[i]].centre);
        node.largest = std::max(node.largest, balls_[order_[i]].radius);
        node.first = std::min(node.first, order_[i]);
      } else {
        node.centres.include(levels_.back()[i].centres.min);
        node.centres.include(levels_.back()[i].centres.max);
        node.largest = std::max(node.largest, levels_.back()[i].largest);
        node.first = std::min(node.first, levels_.back()[i].first);
      }
    }
    below = nodes.size() > 1 ? nodes.size() : 0;
    levels_.push_back(std::move(nodes));
  }
}

std::uint32_t BallTree::nearest_by_power(Vec3 point) const {
  std::uint32_t best = 0;
  double least = std::numeric_limits<double>::infinity();
  descend(
      levels_.size(), 0,
      [&](const Node& node) {
        const double bound = distance_squared(node.centres, point) - node.largest * node.largest;
        return bound < least || (bound == least && node.first < best);
      },
      [&](std::uint32_t i) {
        const double power = squared_norm(point - balls_[i].centre) - balls_[i].radius * balls_[i].radius;
        if (power < least || (power == least && i < best)) least = power, best = i;
        return false;
      });
  return best;
}

Taken::Taken(const BallTree& tree) : tree_(tree) {
  constexpr double nobody = -std::numeric_limits<double>::infinity();
  std::size_t count = tree.order_.size();
  for (largest_.emplace_back(count, nobody); largest_.size() <= tree.levels_.size();) {
    count = (count + BallTree::kFan - 1) / BallTree::kFan;
    largest_.emplace_back(count, nobody);
  }
}

void Taken::take(std::size_t place) {
  const double radius = tree_.balls_[tree_.order_[place]].radius;
  for (std::vector<double>& level : largest_) {
    level[place] = std::max(level[place], radius);
    place /= BallTree::kFan;
  }
}

bool Taken::any_holding(std::size_t level, std::size_t i, const Sphere& ball, double slack, Poll& poll) const {
  if (level == 0) {
    const double room = largest_[0][i] + slack - ball.radius;
    return squared_norm(tree_.balls_[tree_.order_[i]].centre - ball.centre) <= room * room;
  }
  const double room = largest_[level][i] + slack - ball.radius;
  if (BallTree::distance_squared(tree_.levels_[level - 1][i].centres, ball.centre) > room * room) return false;
  poll();
  const std::vector<double>& below = largest_[level - 1];
  const std::size_t end = std::min(below.size(), (i + 1) * BallTree::kFan);
  for (std::size_t child = i * BallTree::kFan; child < end; ++child)
    if (below[child] + slack >= ball.radius && any_holding(level - 1, child, ball, slack, poll)) return true;
  return false;
}

}  // namespace spherule::detail
