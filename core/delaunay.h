// SPDX-License-Identifier: GPL-3.0-or-later
//
// BoundaryPoints -> Tetrahedralization: the Delaunay tetrahedralization, by CGAL on exact integer predicates.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/lattice.h"

namespace spherule {

/// Four indices into the points, positively oriented: orientation(v0, v1, v2, v3) > 0. v0 is the smallest.
using Tetrahedron = std::array<std::uint32_t, 4>;

/// The finite cells, ascending lexicographically. Ties (five or more co-spherical points, the rule on a grid) are
/// broken by perturbing symbolically in the lexicographic order of the points (Devillers and Teillaud, Perturbations
/// and vertex removal in a 3D Delaunay triangulation, SODA 2003), so the result is a function of the set of points
/// alone and no cell is flat.
using Tetrahedralization = std::vector<Tetrahedron>;

/// Points must differ pairwise and have coordinates in [0, 2^24). Fewer than four, or all in one plane, give no cells.
/// Reports stage "delaunay". Throws cancelled, and too_large beyond most_cells.h. Expected O(n log n + cells);
/// peak memory 600 bytes a point, with the usual 7 cells each, and 80 for every cell more. Polls every few cells made.
Tetrahedralization tetrahedralize(std::span<const LatticePoint> points, const Context& context = {});

/// neighbours[t][i]: the cell across the facet opposite vertex i of t, or no_cell. O(cells); 24 bytes a cell.
inline constexpr std::uint32_t no_cell = 0xffffffffU;
std::vector<std::array<std::uint32_t, 4>> neighbours(std::span<const Tetrahedron> cells, std::size_t point_count,
                                                     const Context& context = {});

/// Facets across which the fifth point lies strictly inside the circumsphere: 0 for every Delaunay tetrahedralization
/// (by the local-to-global theorem, then no sphere has any point inside). Exact.
std::size_t count_not_delaunay(std::span<const LatticePoint> points, std::span<const Tetrahedron> cells,
                               std::span<const std::array<std::uint32_t, 4>> neighbours, const Context& context = {});

}  // namespace spherule
