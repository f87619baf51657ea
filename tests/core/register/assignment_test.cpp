// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/assignment.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "tests/phantoms.h"

namespace spherule {
namespace {

double total(std::span<const double> costs, std::size_t columns, double alone,
             const std::vector<std::uint32_t>& assigned) {
  double sum = 0;
  for (std::size_t r = 0; r < assigned.size(); ++r)
    sum += assigned[r] == unmatched ? alone : costs[r * columns + assigned[r]];
  return sum;
}

bool is_matching(const std::vector<std::uint32_t>& assigned, std::size_t columns) {
  std::vector<int> used(columns, 0);
  for (const std::uint32_t c : assigned)
    if (c != unmatched && (c >= columns || used[c]++ > 0)) return false;
  return true;
}

// Every way there is.
double brute_force(std::span<const double> costs, std::size_t rows, std::size_t columns, double alone,
                   std::size_t row = 0, std::uint32_t used = 0) {
  if (row == rows) return 0;
  double least = alone + brute_force(costs, rows, columns, alone, row + 1, used);
  for (std::size_t c = 0; c < columns; ++c) {
    if (used >> c & 1) continue;
    least =
        std::min(least, costs[row * columns + c] + brute_force(costs, rows, columns, alone, row + 1, used | 1U << c));
  }
  return least;
}

TEST(Assignment, IsTheLeastOfAllWays) {
  phantoms::Random random(1);
  for (int t = 0; t < 300; ++t) {
    const std::size_t rows = 1 + random.below(6), columns = 1 + random.below(6);
    const double alone = t % 3 == 0 ? 1e6 : random.unit();
    std::vector<double> costs(rows * columns);
    // A few levels only, every second time: many ties.
    for (double& c : costs) c = t % 2 == 0 ? random.unit() : static_cast<double>(random.below(3)) / 3;
    if (t % 5 == 0)
      for (double& c : costs) c -= 0.5;
    const auto assigned = assign(costs, columns, alone);
    ASSERT_EQ(assigned.size(), rows);
    ASSERT_TRUE(is_matching(assigned, columns));
    EXPECT_NEAR(total(costs, columns, alone, assigned), brute_force(costs, rows, columns, alone), 1e-9);
  }
}

TEST(Assignment, FindsAHiddenPermutation) {
  constexpr std::size_t n = 200;
  phantoms::Random random(2);
  std::vector<std::uint32_t> hidden(n);
  for (std::uint32_t i = 0; i < n; ++i) hidden[i] = i;
  random.shuffle(hidden);
  std::vector<double> costs(n * n);
  for (std::size_t r = 0; r < n; ++r)
    for (std::size_t c = 0; c < n; ++c) costs[r * n + c] = hidden[r] == c ? 0.1 * random.unit() : 0.1 + random.unit();
  EXPECT_EQ(assign(costs, n, 10), hidden);
}

TEST(Assignment, LeavesAloneWhatCostsMore) {
  EXPECT_EQ(assign(std::vector<double>{5, 1, 1, 5}, 2, 2), (std::vector<std::uint32_t>{1, 0}));
  EXPECT_EQ(assign(std::vector<double>{5, 5, 1, 5}, 2, 2), (std::vector<std::uint32_t>{unmatched, 0}));
  EXPECT_EQ(assign(std::vector<double>{1, 2, 3}, 1, 9), (std::vector<std::uint32_t>{0, unmatched, unmatched}));
  EXPECT_TRUE(assign({}, 3, 1).empty());
}

}  // namespace
}  // namespace spherule
