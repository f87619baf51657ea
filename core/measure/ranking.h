// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres ranked by what each contributes to the union, as the paper ranks them.
// Source: Ranjan and Fournier (1994), section 3.4.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/measure/union.h"

namespace spherule {

struct Ranking {
  std::vector<std::uint32_t> order;  ///< indices of the spheres, the largest part of the volume first
  std::vector<std::uint32_t> rank;   ///< of each sphere, from 0: the inverse of `order`
  std::vector<double> cumulative;    ///< by rank: the share of the union's volume that the spheres up to it have
};

/// Equal volumes: the larger area first, then the lower index. The last cumulative share is 1, or all are 0 for a
/// union without volume. O(n log n); 40 bytes a ball.
Ranking rank_contributions(std::span<const BallPart> parts);

}  // namespace spherule
