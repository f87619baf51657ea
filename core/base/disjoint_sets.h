// SPDX-License-Identifier: GPL-3.0-or-later
//
// Disjoint sets of indices, joined two at a time.
#pragma once

#include <algorithm>
#include <cstddef>
#include <cstdint>
#include <numeric>
#include <vector>

namespace spherule {

/// The smallest member stands for a set, so the result depends on no order of joins. Path halving: O(log n) amortised.
class DisjointSets {
 public:
  explicit DisjointSets(std::size_t n) : parent_(n) { std::iota(parent_.begin(), parent_.end(), 0U); }
  std::uint32_t find(std::uint32_t v) {
    while (parent_[v] != v) v = parent_[v] = parent_[parent_[v]];
    return v;
  }
  void unite(std::uint32_t a, std::uint32_t b) {
    a = find(a), b = find(b);
    if (a != b) parent_[std::max(a, b)] = std::min(a, b);
  }
  bool is_root(std::uint32_t v) const { return parent_[v] == v; }

 private:
  std::vector<std::uint32_t> parent_;
};

}  // namespace spherule
