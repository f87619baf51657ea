// SPDX-License-Identifier: GPL-3.0-or-later
//
// The power diagram's dual complex of any balls, by CGAL, and what only exact predicates can tell from it.
//
// Source: H. Edelsbrunner, The union of balls and its dual shape (1995).
#pragma once

#include <span>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/measure.h"

namespace spherule {

/// Pieces, tunnels and voids of a union of closed balls (those that touch are joined), from its dual complex, the
/// weighted alpha complex at 0, with exact predicates. Radii of 0 count as points. O(n log n) expected, about 400 bytes
/// a ball. Cannot be cancelled within the library's triangulation. For raw models use measure_tetrahedra's:
/// rounding of their radii makes pin-holes where many balls meet.
Topology union_topology(std::span<const Sphere> balls, const Context& context = {});

}  // namespace spherule
