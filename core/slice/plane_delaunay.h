// SPDX-License-Identifier: GPL-3.0-or-later
//
// The Delaunay triangulation of lattice points in a plane, by CGAL on exact integer predicates.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/lattice.h"

namespace spherule {

/// Three indices into the points, from x to y (positive area); the first is the smallest.
using PlaneTriangle = std::array<std::uint32_t, 3>;

/// Of points in one plane z = constant that differ pairwise; ascending lexicographically. Ties (four or more points on
/// an empty circle, the rule on a grid) are broken by perturbing symbolically in the lexicographic order of the points
/// (Devillers and Teillaud, SODA 2003), so the result is a function of the set of points alone. Fewer than three
/// points, or points on one line, give none. Expected O(n log n); 200 bytes a point. Throws cancelled.
std::vector<PlaneTriangle> triangulate(std::span<const LatticePoint> points, const Context& context = {});

}  // namespace spherule
