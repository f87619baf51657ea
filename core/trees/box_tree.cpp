// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/trees/box_tree.h"

#include <algorithm>
#include <functional>
#include <limits>
#include <utility>

#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/base/vectors.h"
#include "core/trees/morton.h"

namespace spherule {

namespace {

using Column = std::array<double, 8>;

constexpr std::size_t kGrain = 1 << 14;  // a multiple of the fan, so that no two pieces share a node

// Of each node, given by the columns of its children's boxes, low ends by axis and then high ones: bit c when child c's
// box overlaps. Boxes overlap when none is beyond the other along any axis, by differences whose signs are exact.
SPHERULE_VECTORS
void overlapping(const Column* columns, const std::uint32_t* nodes, std::size_t count, const Box& box,
                 std::uint8_t* found) {
  const auto larger = [](double a, double b) { return a > b ? a : b; };
  for (std::size_t n = 0; n < count; ++n) {
    const Column* low = columns + std::size_t{nodes[n]} * 6;
    const Column* high = low + 3;
    std::array<double, 8> gaps;
    for (std::size_t c = 0; c < gaps.size(); ++c) {
      const double x = larger(low[0][c] - box.max.x, box.min.x - high[0][c]);
      const double y = larger(low[1][c] - box.max.y, box.min.y - high[1][c]);
      const double z = larger(low[2][c] - box.max.z, box.min.z - high[2][c]);
      gaps[c] = larger(larger(x, y), z);
    }
    std::uint64_t bits = 0;
    for (std::size_t c = 0; c < gaps.size(); ++c) bits |= gaps[c] <= 0 ? std::uint64_t{1} << c : 0;
    found[n] = static_cast<std::uint8_t>(bits);
  }
}

}  // namespace

BoxTree::Node::Node() {
  for (auto& column : min) column.fill(std::numeric_limits<double>::infinity());
  for (auto& column : max) column.fill(-std::numeric_limits<double>::infinity());
}

void BoxTree::Node::set(std::size_t child, const Box& box) {
  for (std::size_t a = 0; a < 3; ++a) {
    min[a][child] = box.min[static_cast<int>(a)];
    max[a][child] = box.max[static_cast<int>(a)];
  }
}

Box BoxTree::Node::bounds() const {
  Box box;
  for (std::size_t a = 0; a < 3; ++a) {
    box.min[static_cast<int>(a)] = *std::ranges::min_element(min[a]);
    box.max[static_cast<int>(a)] = *std::ranges::max_element(max[a]);
  }
  return box;
}

unsigned BoxTree::overlaps(const Node& node, const Box& box) {
  std::uint8_t found = 0;
  constexpr std::uint32_t kFirst = 0;
  overlapping(node.min.data(), &kFirst, 1, box, &found);
  return found;
}

void BoxTree::overlaps(std::span<const std::uint32_t> leaves, const Box& box, std::uint8_t* found) const {
  overlapping(levels_[0][0].min.data(), leaves.data(), leaves.size(), box, found);
}

void BoxTree::find_leaves(const Box& box, std::vector<std::uint32_t>& leaves) const {
  leaves.clear();
  if (!levels_.empty()) find_leaves(levels_.size() - 1, 0, box, leaves);
}

void BoxTree::find_leaves(std::size_t level, std::size_t n, const Box& box, std::vector<std::uint32_t>& leaves) const {
  if (level == 0) return leaves.push_back(static_cast<std::uint32_t>(n));
  for (unsigned found = overlaps(levels_[level][n], box); found != 0; found &= found - 1)
    find_leaves(level - 1, n * kFan + static_cast<std::size_t>(std::countr_zero(found)), box, leaves);
}

template <typename BoxAt>
std::vector<BoxTree::Node> BoxTree::nodes(std::size_t count, const BoxAt& box_at, const Context& context) {
  std::vector<Node> result((count + kFan - 1) / kFan);
  parallel_for(context, {}, count, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t n = begin; n < end; ++n) result[n / kFan].set(n % kFan, box_at(n));
  });
  return result;
}

BoxTree::BoxTree(std::span<const Box> boxes, const Context& context) {
  if (boxes.empty()) return;
  Box all;
  for (const Box& b : boxes) {
    all.include(b.min);
    all.include(b.max);
  }
  const Vec3 size = all.max - all.min;
  const double extent = std::max({size.x, size.y, size.z});
  const double scale = extent > 0 ? 0x1p20 / extent : 0;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(boxes.size());
  parallel_for(context, {}, keys.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (auto i = static_cast<std::uint32_t>(begin); i < end; ++i) {
      const Vec3 middle = scale * (0.5 * (boxes[i].min + boxes[i].max) - all.min);
      keys[i] = {detail::along_morton_curve(middle), i};
    }
  });
  Poll poll(context);
  std::sort(keys.begin(), keys.end(), Polled(poll, std::less<>()));

  order_.reserve(keys.size());
  for (const auto& [key, i] : keys) order_.push_back(i);
  levels_.push_back(nodes(
      order_.size(), [&](std::size_t n) { return boxes[order_[n]]; }, context));
  while (levels_.back().size() > 1) {
    const std::vector<Node>& below = levels_.back();
    levels_.push_back(nodes(
        below.size(), [&](std::size_t n) { return below[n].bounds(); }, context));
  }
}

}  // namespace spherule
