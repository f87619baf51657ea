// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/trees/ball_tree.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>

#include "core/base/poll.h"

namespace spherule::detail {

namespace {

// The 21 low bits of x, two places apart.
std::uint64_t spread(std::uint64_t x) {
  x = (x | x << 32) & 0x001f00000000ffffU;
  x = (x | x << 16) & 0x001f0000ff0000ffU;
  x = (x | x << 8) & 0x100f00f00f00f00fU;
  x = (x | x << 4) & 0x10c30c30c30c30c3U;
  return (x | x << 2) & 0x1249249249249249U;
}

}  // namespace

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
    keys[i] = {spread(static_cast<std::uint64_t>(p.x)) | spread(static_cast<std::uint64_t>(p.y)) << 1 |
                   spread(static_cast<std::uint64_t>(p.z)) << 2,
               i};
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

}  // namespace spherule::detail
