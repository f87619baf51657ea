// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/openness.h"

#include <gtest/gtest.h>

#include <algorithm>

namespace spherule {
namespace {

constexpr Vec3 kTowards{0, -1, 0}, kAcross{1, 0, 0};

TEST(Openness, IsOneWhereNothingIsKnown) {
  OpennessMap map;
  map.reset(5, 4);
  map.place(2, 2, {2, 0, 2}, kTowards);
  EXPECT_EQ(map.at(2, 2, {2, 0, 2}, kTowards).lamp, 1);
  EXPECT_EQ(map.at(2, 2, {2, 0, 2}, kTowards).sky, 1);
  map.set_lamp(2, 2, 0.25);
  EXPECT_NEAR(map.at(2, 2, {2, 0, 2}, kTowards).lamp, 0.25, 1e-6);
  EXPECT_EQ(map.at(2, 2, {2, 0, 2}, kTowards).sky, 1);
  map.reset(5, 4);
  EXPECT_EQ(map.at(2, 2, {2, 0, 2}, kTowards).lamp, 1);
}

// On a plane, the mean over 7 × 7 neighbours by their distances alone.
TEST(Openness, IsTheMeanOfNeighboursOnOnePlane) {
  constexpr int kWidth = 12, kHeight = 9;
  OpennessMap map;
  map.reset(kWidth, kHeight);
  const auto lamp = [](int x, int y) { return x * 7 % 5 / 4.0 * (y % 2); };
  const auto sky = [](int x, int y) { return (x + y) % 3 / 2.0; };
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      map.place(x, y, {1.0 * x, 5, -1.0 * y}, kTowards);
      map.set_lamp(x, y, lamp(x, y)), map.set_sky(x, y, sky(x, y));
    }
  for (int y = 0; y < kHeight; ++y)
    for (int x = 0; x < kWidth; ++x) {
      double lamps = 0, skies = 0, weights = 0;
      for (int v = std::max(0, y - 3); v <= std::min(kHeight - 1, y + 3); ++v)
        for (int u = std::max(0, x - 3); u <= std::min(kWidth - 1, x + 3); ++u) {
          const double weight = 1 / (1 + 0.12 * ((u - x) * (u - x) + (v - y) * (v - y)));
          lamps += weight * lamp(u, v), skies += weight * sky(u, v), weights += weight;
        }
      const Openness found = map.at(x, y, {1.0 * x, 5, -1.0 * y}, kTowards);
      ASSERT_NEAR(found.lamp, lamps / weights, 1e-5);
      ASSERT_NEAR(found.sky, skies / weights, 1e-5);
    }
}

TEST(Openness, OtherSurfacesDoNotCount) {
  OpennessMap map;
  map.reset(8, 8);
  // Left: a near plane in shadow. Right: one far behind it, in the light. Below: a wall at a right angle.
  for (int y = 0; y < 8; ++y)
    for (int x = 0; x < 8; ++x) {
      map.place(x, y, {1.0 * x, x < 4 ? 0.0 : 1000.0, -1.0 * y}, y < 6 ? kTowards : kAcross);
      map.set_lamp(x, y, y >= 6 ? 0.5 : x < 4 ? 0 : 1);
    }
  EXPECT_NEAR(map.at(3, 3, {3, 0, -3}, kTowards).lamp, 0, 1e-4);
  EXPECT_NEAR(map.at(4, 3, {4, 1000, -3}, kTowards).lamp, 1, 1e-4);
  EXPECT_NEAR(map.at(2, 6, {2, 0, -6}, kAcross).lamp, 0.5, 1e-2);
  // A place unlike all of its neighbours gets a mean, not a number out of nowhere.
  const double odd = map.at(3, 2, {3, -5000, -2}, {0, 1, 0}).lamp;
  EXPECT_GT(odd, 0.1);
  EXPECT_LT(odd, 0.9);
}

}  // namespace
}  // namespace spherule
