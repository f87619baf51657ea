// SPDX-License-Identifier: GPL-3.0-or-later
//
// Volume -> BoundaryPoints: where the object's surface crosses the grid's edges.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 3.1.
#pragma once

#include <cstddef>
#include <vector>

#include "core/inside.h"
#include "core/lattice.h"
#include "core/volume.h"

namespace spherule {

struct BoundaryPoints {
  Lattice lattice;
  std::vector<LatticePoint> points;  ///< one for each crossed edge, two where a range is jumped over; all different
  bool touches_border = false;       ///< an inside sample lies in the grid's outermost layer
};

/// Finds the crossing of every grid edge whose ends differ, by linear interpolation of the values (half way for labels,
/// and where an end is NaN or infinite), rounded to the lattice but never onto a sample: where a sample equals the
/// iso-value the crossing is one lattice unit (about 2^-14 voxel) away on its edge. So no two points coincide, every
/// sample is strictly on one side, and the count is the number of crossings. `samples` must come from
/// classify_samples(volume, rule). Order: by owner sample (z, y, then axis, x); the same for every thread count.
/// O(samples / 64 + points). Throws too_large when there are more than max_points, before memory is taken. An object
/// without any boundary (all or nothing inside) gives no points.
BoundaryPoints extract_boundary(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                                std::size_t max_points = std::size_t{1} << 31, const Context& context = {});

}  // namespace spherule
