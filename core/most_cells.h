// SPDX-License-Identifier: GPL-3.0-or-later
//
// How large triangulations and diagrams may get that may be quadratic themselves.
#pragma once

#include <cstddef>

namespace spherule {

/// The most cells of a triangulation of so many points, or of the power diagram of so many balls: 2^20, some 100 MB and
/// a few seconds, whatever their number; beyond that five times what points without a common structure have. Only
/// points near two curves that face each other have more, up to n²/4.
constexpr std::size_t most_cells(std::size_t points) {
  constexpr std::size_t kAnyway = std::size_t{1} << 20, kPerPoint = 32;
  return points < kAnyway / kPerPoint ? kAnyway : kPerPoint * points;
}

}  // namespace spherule
