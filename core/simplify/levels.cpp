// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/levels.h"

#include <algorithm>

namespace spherule::detail {

void require_k(std::uint64_t k, std::size_t count, const std::string& field) {
  if (count == 0) {
    throw Error(ErrorCode::unusable, "The model has no spheres to simplify; choose a threshold that gives it some.");
  }
  if (k >= 1 && k <= count) return;
  const std::string sentence =
      "Give " + field + " as a whole number " +
      (k < 1 ? "of at least 1."
             : "within 1 and " + std::to_string(count) + ", the number of spheres that the model has.");
  throw Error(ErrorCode::invalid_argument, sentence, {{"/" + field, sentence}});
}

void set_members(Simplification& result, LeafMembers& leaves) {
  std::ranges::sort(leaves, {}, [](const auto& leaf) { return leaf.first; });
  result.member_begin.assign(result.spheres.size() + 1, 0);
  for (const auto& [node, members] : leaves) {
    result.member_begin[node + 1] = static_cast<std::uint32_t>(members.size());
  }
  for (std::size_t i = 0; i < result.spheres.size(); ++i) result.member_begin[i + 1] += result.member_begin[i];
  result.members.clear();
  result.members.reserve(result.member_begin.back());
  for (auto& [node, members] : leaves) {
    std::ranges::sort(members);
    result.members.insert(result.members.end(), members.begin(), members.end());
  }
}

}  // namespace spherule::detail
