// SPDX-License-Identifier: GPL-3.0-or-later
//
// The order in which points are put into a triangulation: at random on the whole, so that no order of the input makes
// it slow, and along a space-filling curve within, so that each point is near the one before.
//
// Sources: N. Amenta, S. Choi, G. Rote, Incremental constructions con BRIO (2003); J. Skilling, Programming the Hilbert
// curve (2004).
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// The place of a cell of a cube of 2^20 cells an edge along Hilbert's curve. O(1).
std::uint64_t along_hilbert_curve(std::array<std::uint32_t, 3> cell);

/// In which round a point is put in, from 0: seven eighths of all in the last of 16, seven eighths of the others in the
/// one before, and so on. A function of its number alone.
std::uint64_t insertion_round(std::uint32_t point);

/// The points' numbers in that order. Unlike an order by medians it takes thin sets for what they are: cells are cubes.
/// O(n log n); 20 bytes a point. Throws cancelled.
std::vector<std::uint32_t> insertion_order(std::span<const Vec3> points, const Context& context);

}  // namespace spherule
