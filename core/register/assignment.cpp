// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/assignment.h"

#include <limits>

#include "core/base/check.h"
#include "core/base/poll.h"

namespace spherule {

std::vector<std::uint32_t> assign(std::span<const double> costs, std::size_t columns, double alone,
                                  const Context& context) {
  if (costs.empty()) return {};
  SPHERULE_CHECK(columns > 0 && costs.size() % columns == 0);
  const std::size_t rows = costs.size() / columns;
  // Past the real columns every row has one of its own, at the price of being alone.
  const std::size_t all = columns + rows;
  constexpr double infinite = std::numeric_limits<double>::infinity();
  const auto cost = [&](std::size_t row, std::size_t column) {
    if (column < columns) return costs[row * columns + column];
    return column - columns == row ? alone : infinite;
  };
  constexpr std::size_t none = std::numeric_limits<std::size_t>::max();
  std::vector<double> row_price(rows, 0), column_price(all, 0), reach(all);
  std::vector<std::size_t> row_of(all, none), from(all);
  std::vector<std::uint8_t> done(all);
  Poll poll(context);
  for (std::size_t start = 0; start < rows; ++start) {
    // Dijkstra's search, on costs reduced by the prices, for the nearest free column.
    std::fill(reach.begin(), reach.end(), infinite);
    std::fill(from.begin(), from.end(), none);
    std::fill(done.begin(), done.end(), 0);
    std::size_t row = start, last = none, free = none;
    double length = 0;
    while (free == none) {
      poll(all);
      std::size_t next = none;
      for (std::size_t c = 0; c < all; ++c) {
        if (done[c]) continue;
        const double through = length + cost(row, c) - row_price[row] - column_price[c];
        if (through < reach[c]) {
          reach[c] = through;
          from[c] = last;
        }
        if (next == none || reach[c] < reach[next]) next = c;
      }
      length = reach[next];
      done[next] = 1;
      last = next;
      if (row_of[next] == none) {
        free = next;
      } else {
        row = row_of[next];
      }
    }
    row_price[start] += length;
    for (std::size_t c = 0; c < all; ++c) {
      if (!done[c] || c == free) continue;
      row_price[row_of[c]] += length - reach[c];
      column_price[c] -= length - reach[c];
    }
    for (std::size_t c = free; c != none; c = from[c]) row_of[c] = from[c] == none ? start : row_of[from[c]];
  }
  std::vector<std::uint32_t> column_of(rows, unmatched);
  for (std::size_t c = 0; c < columns; ++c) {
    if (row_of[c] != none) column_of[row_of[c]] = static_cast<std::uint32_t>(c);
  }
  return column_of;
}

}  // namespace spherule
