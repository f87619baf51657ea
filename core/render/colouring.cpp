// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/colouring.h"

#include <algorithm>

#include "core/base/disjoint_sets.h"
#include "core/measure/components.h"

namespace spherule {
namespace {

// Ranks by falling size; `of[i]` names the set that item i is in by one of its items.
std::vector<std::uint32_t> by_size(std::vector<std::uint32_t> of) {
  std::vector<std::uint32_t> size(of.size()), rank(of.size()), order;
  for (const std::uint32_t set : of)
    if (size[set]++ == 0) order.push_back(set);
  std::ranges::stable_sort(order, std::ranges::greater{}, [&](std::uint32_t set) { return size[set]; });
  for (std::uint32_t r = 0; r < order.size(); ++r) rank[order[r]] = r;
  for (std::uint32_t& set : of) set = rank[set];
  return of;
}

}  // namespace

std::vector<std::uint32_t> pieces(const SphereModel& model, const Context& context) {
  return by_size(first_of_component(model, context));
}

std::vector<std::uint32_t> pieces(std::size_t vertices, std::span<const std::array<std::uint32_t, 3>> triangles,
                                  const Context& context) {
  DisjointSets sets(vertices);
  for (std::size_t i = 0; i < triangles.size(); ++i) {
    if (i % 65536 == 0) context.throw_if_cancelled();
    sets.unite(triangles[i][0], triangles[i][1]), sets.unite(triangles[i][0], triangles[i][2]);
  }
  std::vector<std::uint32_t> of(vertices);
  for (std::uint32_t v = 0; v < vertices; ++v) of[v] = sets.find(v);
  return by_size(std::move(of));
}

std::array<double, 2> middle_range(std::vector<double> values) {
  if (values.empty()) return {0, 1};
  const auto at = [&](double part) {
    const auto i = static_cast<std::ptrdiff_t>(part * static_cast<double>(values.size() - 1));
    std::nth_element(values.begin(), values.begin() + i, values.end());
    return values[static_cast<std::size_t>(i)];
  };
  const double lo = at(0.01), hi = at(0.99);
  const double apart = hi - lo > 1e-9 * std::max(std::abs(lo), std::abs(hi)) ? 0 : std::max(1e-9, 0.01 * std::abs(lo));
  return {lo - apart, hi + apart};
}

}  // namespace spherule
