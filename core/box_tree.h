// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which of many boxes overlap a given one.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>
#include <span>
#include <vector>

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
  /// The boxes, none of them empty, are copied. O(n log n).
  explicit BoxTree(std::span<const Box> boxes);

  /// Indices of the boxes so that neighbours in the list are mostly neighbours in space.
  std::span<const std::uint32_t> order() const { return order_; }

  /// Calls visit(n) for every box order()[n] that overlaps `box`, n ascending. Who keeps what belongs to the boxes in
  /// that order finds neighbours close together in memory.
  template <typename Visit>
  void for_each_overlap(const Box& box, Visit&& visit) const {
    if (!levels_.empty()) descend(levels_.size() - 1, 0, levels_.back().size(), box, visit);
  }

 private:
  static constexpr std::size_t kFan = 8;

  template <typename Visit>
  void descend(std::size_t level, std::size_t begin, std::size_t end, const Box& box, Visit& visit) const {
    for (std::size_t n = begin; n < end; ++n) {
      if (!overlap(levels_[level][n], box)) continue;
      if (level == 0) {
        visit(n);
      } else {
        descend(level - 1, n * kFan, std::min((n + 1) * kFan, levels_[level - 1].size()), box, visit);
      }
    }
  }

  std::vector<std::uint32_t> order_;
  std::vector<std::vector<Box>> levels_;  // levels_[0][i] is the box order_[i]
};

}  // namespace spherule
