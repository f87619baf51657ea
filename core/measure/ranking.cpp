// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/ranking.h"

#include <algorithm>
#include <numeric>
#include <tuple>

namespace spherule {

Ranking rank_contributions(std::span<const BallPart> parts) {
  std::vector<std::tuple<double, double, std::uint32_t>> keys;
  keys.reserve(parts.size());
  for (std::uint32_t i = 0; i < parts.size(); ++i) keys.emplace_back(-parts[i].volume_mm3, -parts[i].area_mm2, i);
  std::ranges::sort(keys);
  Ranking ranking;
  ranking.order.reserve(parts.size());
  ranking.rank.resize(parts.size());
  ranking.cumulative.reserve(parts.size());
  double sum = 0;
  for (const auto& [volume, area, index] : keys) {
    ranking.rank[index] = static_cast<std::uint32_t>(ranking.order.size());
    ranking.order.push_back(index);
    ranking.cumulative.push_back(sum -= volume);
  }
  for (double& share : ranking.cumulative) share = sum > 0 ? share / sum : 0;
  return ranking;
}

}  // namespace spherule
