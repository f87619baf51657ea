// SPDX-License-Identifier: GPL-3.0-or-later
//
// The power diagram of any balls, by CGAL, and what only exact predicates can tell from it: who bounds whose cell, and
// the topology of the union by its dual complex.
//
// All decisions are exact on the centres and radii as given: squares of radii are not rounded. Balls are closed. So
// balls that touch in one point are joined, and tunnels and voids that are pinched at a point are closed there.
//
// All functions take expected O(n log n) and O(cells) for a diagram with more cells than that, and poll for
// cancellation every few dozen balls. A diagram has about 7 cells a ball; where nearly all balls bound each other
// (those on two lines that do not meet), n²/4. Beyond most_cells (most_cells.h) they throw too_large.
//
// Source: H. Edelsbrunner, The union of balls and its dual shape (1995).
#pragma once

#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/measure/solid.h"

namespace spherule {

/// Whether two closed balls have a point in common. Exact. O(1).
bool meet(const Sphere& a, const Sphere& b);

/// Pieces, tunnels and voids of a union of balls, from its dual complex, the weighted alpha complex at 0. Pieces are
/// those of first_of_component (components.h). Radii of 0 count as points. About 800 bytes a ball (100 a cell). For raw
/// models use measure_tetrahedra's: rounding of their radii makes pin-holes where many balls meet.
Topology union_topology(std::span<const Sphere> balls, const Context& context = {});

/// Which balls bound whose power cell.
struct PowerNeighbours {
  std::vector<std::size_t> begin{0};
  std::vector<std::uint32_t> balls;  ///< those of ball i are balls[begin[i]] up to balls[begin[i + 1]], ascending
  std::vector<std::uint8_t> hidden;  ///< of every ball: whether it has no cell; it has no neighbours then

  std::span<const std::uint32_t> of(std::size_t i) const {
    return std::span(balls).subspan(begin[i], begin[i + 1] - begin[i]);
  }
};

/// Of balls with one centre the largest has the cell, and the first of these. Balls may be neighbours that bound each
/// other in less than a facet, where many cells meet. About 900 bytes a ball.
PowerNeighbours power_neighbours(std::span<const Sphere> balls, const Context& context = {});

}  // namespace spherule
