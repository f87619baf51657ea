// SPDX-License-Identifier: GPL-3.0-or-later
//
// Morton's order of places in space: those near each other in it are mostly near each other. Private to core/trees.
// Source: G. Morton, A computer oriented geodetic data base and a new technique in file sequencing (1966).
#pragma once

#include <cstdint>

#include "core/base/geometry.h"

namespace spherule::detail {

/// The 21 low bits of v, two places apart.
constexpr std::uint64_t spread_bits(std::uint64_t v) {
  v = (v | v << 32) & 0x1f00000000ffffU;
  v = (v | v << 16) & 0x1f0000ff0000ffU;
  v = (v | v << 8) & 0x100f00f00f00f00fU;
  v = (v | v << 4) & 0x10c30c30c30c30c3U;
  return (v | v << 2) & 0x1249249249249249U;
}

/// The number along the curve of the cell of edge 1 that holds a place. Precondition: coordinates in [0, 2²¹). O(1).
constexpr std::uint64_t along_morton_curve(Vec3 place) {
  return spread_bits(static_cast<std::uint64_t>(place.x)) | spread_bits(static_cast<std::uint64_t>(place.y)) << 1 |
         spread_bits(static_cast<std::uint64_t>(place.z)) << 2;
}

}  // namespace spherule::detail
