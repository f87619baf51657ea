// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/blob_balls.h"

#include <algorithm>
#include <bit>
#include <limits>

#include "core/base/poll.h"
#include "core/trees/box_tree.h"

namespace spherule {
namespace {

// The balls taken so far, in the order of a space-filling curve: of every 8, 64, 512 … the box of all their centres,
// and the radius of the largest taken.
class Taken {
 public:
  Taken(std::span<const Sphere> balls, const Context& context) : balls_(balls), place_(balls.size()) {
    std::vector<Box> centres(balls.size());
    for (std::size_t i = 0; i < balls.size(); ++i) centres[i].include(balls[i].centre);
    order_ = [&] {
      const BoxTree tree(centres, context);
      return std::vector<std::uint32_t>(tree.order().begin(), tree.order().end());
    }();
    for (std::uint32_t n = 0; n < order_.size(); ++n) place_[order_[n]] = n;
    levels_.emplace_back(order_.size());
    for (std::size_t n = 0; n < order_.size(); ++n) levels_[0][n].centres = centres[order_[n]];
    while (levels_.back().size() > 1) {
      const std::vector<Node>& below = levels_.back();
      std::vector<Node> nodes((below.size() + kFan - 1) / kFan);
      for (std::size_t n = 0; n < below.size(); ++n) {
        nodes[n / kFan].centres.include(below[n].centres.min);
        nodes[n / kFan].centres.include(below[n].centres.max);
      }
      levels_.push_back(std::move(nodes));
    }
  }

  std::uint32_t place(std::uint32_t ball) const { return place_[ball]; }

  void take(std::uint32_t ball) {
    std::size_t n = place_[ball];
    for (std::vector<Node>& level : levels_) {
      level[n].largest = std::max(level[n].largest, balls_[ball].radius);
      n /= kFan;
    }
  }

  // Whether one of them, grown by `slack`, holds the ball.
  bool hold(const Sphere& ball, double slack, Poll& poll) const {
    return hold(levels_.size() - 1, 0, ball, slack, poll);
  }

 private:
  static constexpr std::size_t kFan = 8;
  struct Node {
    Box centres;
    double largest = -std::numeric_limits<double>::infinity();
  };

  bool hold(std::size_t level, std::size_t n, const Sphere& ball, double slack, Poll& poll) const {
    poll();
    const Node& node = levels_[level][n];
    const double room = node.largest + slack - ball.radius;
    if (!(room >= 0)) return false;
    double squared = 0;  // to the nearest centre that may be there
    for (int a = 0; a < 3; ++a) {
      const double gap = std::max({0.0, node.centres.min[a] - ball.centre[a], ball.centre[a] - node.centres.max[a]});
      squared += gap * gap;
    }
    if (squared > room * room) return false;
    if (level == 0) return true;
    const std::size_t end = std::min((n + 1) * kFan, levels_[level - 1].size());
    for (std::size_t child = n * kFan; child < end; ++child)
      if (hold(level - 1, child, ball, slack, poll)) return true;
    return false;
  }

  std::span<const Sphere> balls_;
  std::vector<std::uint32_t> order_, place_;  // balls along the curve, and the place of each
  std::vector<std::vector<Node>> levels_;     // of single balls; of the nodes below; so on, up to one node
};

// Radii of which none is an eighth larger than another, by the first bits of the number. Larger ones have more.
std::uint64_t size_class(double radius) { return std::bit_cast<std::uint64_t>(radius) >> 49; }

}  // namespace

std::vector<std::uint32_t> blending_balls(std::span<const Sphere> balls, double slack, const Context& context) {
  std::vector<std::uint32_t> falling;
  for (std::uint32_t i = 0; i < balls.size(); ++i)
    if (balls[i].radius > 0) falling.push_back(i);
  std::vector<std::uint32_t> blending;
  if (falling.empty()) return blending;
  Taken taken(balls, context);
  Poll poll(context);
  const auto before = [&](std::uint32_t a, std::uint32_t b) {
    const std::uint64_t size_a = size_class(balls[a].radius), size_b = size_class(balls[b].radius);
    return size_a != size_b ? size_a > size_b : taken.place(a) < taken.place(b);
  };
  std::sort(falling.begin(), falling.end(), Polled(poll, before));
  for (const std::uint32_t i : falling) {
    if (taken.hold(balls[i], slack, poll)) continue;
    taken.take(i);
    blending.push_back(i);
  }
  return blending;
}

}  // namespace spherule
