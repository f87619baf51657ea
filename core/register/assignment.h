// SPDX-License-Identifier: GPL-3.0-or-later
//
// Who goes with whom at the least cost in all.
// Source: R. Jonker, A. Volgenant, A shortest augmenting path algorithm for dense and sparse linear assignment
// problems (1987).
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"

namespace spherule {

inline constexpr std::uint32_t unmatched = 0xffffffffU;

/// The column of every row, or `unmatched`: each column for at most one row, so that the sum of the matched rows' costs
/// and of `alone` for every other row is the least possible. `costs` is rows × columns, row-major, finite.
/// O(rows² · (rows + columns)), 40 bytes for each row and column. Throws cancelled.
std::vector<std::uint32_t> assign(std::span<const double> costs, std::size_t columns, double alone,
                                  const Context& context = {});

}  // namespace spherule
