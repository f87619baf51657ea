// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which of many boxes overlap a given one.
#pragma once

#include <algorithm>
#include <array>
#include <bit>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

constexpr bool overlap(const Box& a, const Box& b) {
  return a.min.x <= b.max.x && b.min.x <= a.max.x && a.min.y <= b.max.y && b.min.y <= a.max.y && a.min.z <= b.max.z &&
         b.min.z <= a.max.z;
}

/// Boxes in the order of a space-filling curve, with the boxes of every 8, 64, 512 … that follow each other.
/// Immutable; safe to share between threads. Memory 60 bytes a box.
class BoxTree {
 public:
  /// The boxes, none of them empty, are copied. O(n log n). Throws cancelled.
  explicit BoxTree(std::span<const Box> boxes, const Context& context = {});

  /// Indices of the boxes so that neighbours in the list are mostly neighbours in space.
  std::span<const std::uint32_t> order() const { return order_; }

  /// The leaves with a box that may overlap `box`: leaf l has the boxes order()[l * kFan] to order()[l * kFan + kFan -
  /// 1]. Ascending. Boxes that follow each other share most of them.
  void find_leaves(const Box& box, std::vector<std::uint32_t>& leaves) const;
  /// Around all boxes of a leaf.
  Box bounds(std::size_t leaf) const { return levels_[0][leaf].bounds(); }

  /// for_each_overlap, in leaves known to have all boxes that can overlap.
  template <typename Visit>
  void for_each_overlap(std::span<const std::uint32_t> leaves, const Box& box, Visit&& visit) const {
    constexpr std::size_t kBatch = 64;
    std::array<std::uint8_t, kBatch> found;
    for (; !leaves.empty(); leaves = leaves.subspan(std::min(kBatch, leaves.size()))) {
      const std::size_t count = std::min(kBatch, leaves.size());
      overlaps(leaves.first(count), box, found.data());
      for (std::size_t l = 0; l < count; ++l)
        for (unsigned bits = found[l]; bits != 0; bits &= bits - 1)
          visit(leaves[l] * kFan + static_cast<std::size_t>(std::countr_zero(bits)));
    }
  }

  /// Calls visit(n) for every box order()[n] that overlaps `box`, n ascending. Who keeps what belongs to the boxes in
  /// that order finds neighbours close together in memory.
  template <typename Visit>
  void for_each_overlap(const Box& box, Visit&& visit) const {
    if (!levels_.empty()) descend(levels_.size() - 1, 0, box, visit);
  }

  static constexpr std::size_t kFan = 8;

 private:
  // Boxes that follow each other; where there are fewer, empty ones.
  struct Node {
    Node();
    void set(std::size_t child, const Box& box);
    Box bounds() const;

    std::array<std::array<double, kFan>, 3> min, max;  // by axis
  };

  template <typename BoxAt>
  static std::vector<Node> nodes(std::size_t count, const BoxAt& box_at, const Context& context);
  // Bit i: child i overlaps.
  static unsigned overlaps(const Node& node, const Box& box);
  void overlaps(std::span<const std::uint32_t> leaves, const Box& box, std::uint8_t* found) const;
  void find_leaves(std::size_t level, std::size_t n, const Box& box, std::vector<std::uint32_t>& leaves) const;

  template <typename Visit>
  void descend(std::size_t level, std::size_t n, const Box& box, Visit& visit) const {
    for (unsigned found = overlaps(levels_[level][n], box); found != 0; found &= found - 1) {
      const std::size_t child = n * kFan + static_cast<std::size_t>(std::countr_zero(found));
      if (level == 0) {
        visit(child);
      } else {
        descend(level - 1, child, box, visit);
      }
    }
  }

  std::vector<std::uint32_t> order_;
  std::vector<std::vector<Node>> levels_;  // of the boxes in that order; of the nodes below; so on, up to one node
};

}  // namespace spherule
