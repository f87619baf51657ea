// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/blob_balls.h"

#include <algorithm>
#include <bit>

#include "core/base/poll.h"
#include "core/trees/ball_tree.h"

namespace spherule {
namespace {

// Radii of which none is an eighth larger than another, by the first bits of the number. Larger ones have more.
std::uint64_t size_class(double radius) { return std::bit_cast<std::uint64_t>(radius) >> 49; }

}  // namespace

std::vector<std::uint32_t> blending_balls(std::span<const Sphere> balls, double slack, const Context& context) {
  const detail::BallTree tree(balls, context);
  const auto ball_at = [&](std::uint32_t place) { return balls[tree.order()[place]]; };
  std::vector<std::uint32_t> falling;  // places in the tree
  for (std::uint32_t place = 0; place < balls.size(); ++place)
    if (ball_at(place).radius > 0) falling.push_back(place);
  Poll poll(context);
  std::stable_sort(falling.begin(), falling.end(), Polled(poll, [&](std::uint32_t a, std::uint32_t b) {
                     return size_class(ball_at(a).radius) > size_class(ball_at(b).radius);
                   }));
  std::vector<std::uint32_t> blending;
  detail::Taken taken(tree);
  for (const std::uint32_t place : falling) {
    if (taken.any_holding(ball_at(place), slack, poll)) continue;
    taken.take(place);
    blending.push_back(tree.order()[place]);
  }
  return blending;
}

}  // namespace spherule
