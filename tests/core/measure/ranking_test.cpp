// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/ranking.h"

#include <gtest/gtest.h>

namespace spherule {
namespace {

TEST(Ranking, PutsTheLargestVolumeFirst) {
  const std::vector<BallPart> parts{
      {.volume_mm3 = 2, .area_mm2 = 1, .push_mm2 = {}}, {.volume_mm3 = 5, .area_mm2 = 1, .push_mm2 = {}},
      {.volume_mm3 = 2, .area_mm2 = 3, .push_mm2 = {}}, {.volume_mm3 = 0, .area_mm2 = 0, .push_mm2 = {}},
      {.volume_mm3 = 2, .area_mm2 = 1, .push_mm2 = {}}, {.volume_mm3 = 5, .area_mm2 = 0, .push_mm2 = {}}};
  const Ranking ranking = rank_contributions(parts);
  EXPECT_EQ(ranking.order, (std::vector<std::uint32_t>{1, 5, 2, 0, 4, 3}));
  EXPECT_EQ(ranking.rank, (std::vector<std::uint32_t>{3, 0, 2, 5, 4, 1}));
  EXPECT_EQ(ranking.cumulative, (std::vector<double>{5.0 / 16, 10.0 / 16, 12.0 / 16, 14.0 / 16, 1, 1}));
}

TEST(Ranking, OfNothingIsNothing) {
  EXPECT_TRUE(rank_contributions({}).order.empty());
  const Ranking points = rank_contributions(std::vector<BallPart>(2));
  EXPECT_EQ(points.order, (std::vector<std::uint32_t>{0, 1}));
  EXPECT_EQ(points.cumulative, (std::vector<double>{0, 0}));
}

}  // namespace
}  // namespace spherule
