// SPDX-License-Identifier: GPL-3.0-or-later
//
// The union of discs in a plane: where a plane cuts a union of balls.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

struct Disc {
  double x = 0, y = 0, radius = 0;
};

/// Answers which points the union holds, from a quadtree whose cells are covered by one disc, empty, or hold a few.
class Discs {
 public:
  /// Expected O(n log n). Throws cancelled.
  Discs(std::vector<Disc> discs, const Context& context);
  /// Whether a disc (its edge included) holds the point. Expected O(log n).
  bool hold(double x, double y) const;

 private:
  // A cell with children has first > 0: the index of the first of four. Else it has `count` of members from `first`,
  // or is covered.
  struct Cell {
    std::uint32_t first = 0, count = 0;
    enum Kind : std::uint8_t { leaf, split, covered } kind = leaf;
  };
  void divide(std::size_t cell, double x, double y, double half, int level, std::vector<std::uint32_t> candidates,
              const Context& context);

  std::vector<Disc> discs_;
  std::vector<Cell> cells_;
  std::vector<std::uint32_t> members_;
  double x_ = 0, y_ = 0, half_ = 0;
};

}  // namespace spherule
