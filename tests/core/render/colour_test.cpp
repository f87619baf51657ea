// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/colour.h"

#include <gtest/gtest.h>

#include <cmath>
#include <random>

#include "core/render/colouring.h"
#include "tests/core/render/scenes.h"

namespace spherule {
namespace {

TEST(Colour, BytesAndLight) {
  for (int i = 0; i < 256; ++i) EXPECT_EQ(to_srgb(from_srgb(static_cast<std::uint8_t>(i))), i);
  EXPECT_EQ(to_srgb(-1), 0);
  EXPECT_EQ(to_srgb(7), 255);
  EXPECT_NEAR(from_srgb(188), 0.5, 0.005);
}

TEST(Colour, OklabThereAndBack) {
  std::mt19937_64 random(1);
  std::uniform_real_distribution<double> part(0, 1);
  for (int i = 0; i < 200; ++i) {
    const Colour c{part(random), part(random), part(random)};
    EXPECT_LT(norm(from_oklab(to_oklab(c)) - c), 1e-6);
  }
  EXPECT_LT(norm(to_oklab({1, 1, 1}) - Vec3{1, 0, 0}), 1e-6);
}

TEST(Colour, MapsAreEvenToTheEye) {
  for (const std::string_view name : colour_map_names()) {
    const ColourMap* map = colour_map(name);
    ASSERT_NE(map, nullptr);
    double least = 1e9, most = 0;
    for (int i = 0; i < 100; ++i) {
      const double step = norm(to_oklab(map->at((i + 1) / 100.0)) - to_oklab(map->at(i / 100.0)));
      least = std::min(least, step), most = std::max(most, step);
      const double lighter = to_oklab(map->at((i + 1) / 100.0)).x - to_oklab(map->at(i / 100.0)).x;
      EXPECT_TRUE(lighter > 0 || name == "tide") << name;
    }
    EXPECT_LT(most / least, 1.1) << name;
    EXPECT_EQ(map->at(-1), map->at(0));
    EXPECT_EQ(map->at(NAN), map->at(0));
    EXPECT_EQ(map->at(INFINITY), map->at(1));
  }
  EXPECT_GT(to_oklab(colour_map("tide")->at(0.5)).x, 0.93) << "numbers around 0 are pale";
  EXPECT_EQ(colour_map("rainbow"), nullptr);
}

TEST(Colour, CategoriesThatFollowEachOtherDiffer) {
  for (std::size_t i = 0; i < 1000; ++i)
    for (std::size_t j = 1; j <= 3; ++j)
      EXPECT_GT(norm(to_oklab(category_colour(i)) - to_oklab(category_colour(i + j))), 0.08) << i << ' ' << j;
}

TEST(Pieces, OfBalls) {
  SphereModel model;
  model.spheres = {{{0, 0, 0}, 1}, {{50, 0, 0}, 1}, {{51, 0, 0}, 1}, {{99, 0, 0}, 1}, {{52, 0, 0}, 1}, {{98, 0, 0}, 1}};
  EXPECT_EQ(pieces(model, {}), (std::vector<std::uint32_t>{2, 0, 0, 1, 0, 1}));
}

TEST(Pieces, OfARawModelAreThoseOfItsCells) {
  const SphereModel model = raw_model();
  for (const std::uint32_t piece : pieces(model, {})) ASSERT_EQ(piece, 0U);
}

TEST(Pieces, OfTriangles) {
  const std::vector<std::array<std::uint32_t, 3>> triangles{{0, 1, 2}, {5, 4, 3}, {3, 6, 7}};
  EXPECT_EQ(pieces(9, triangles, {}), (std::vector<std::uint32_t>{1, 1, 1, 0, 0, 0, 0, 0, 2}));
}

TEST(MiddleRange, LeavesTheExtremesOut) {
  std::vector<double> values(1000);
  for (std::size_t i = 0; i < values.size(); ++i) values[i] = static_cast<double>(i);
  values[999] = 1e9;
  EXPECT_EQ(middle_range(values), (std::array<double, 2>{9, 989}));
  EXPECT_LT(middle_range({5, 5})[0], middle_range({5, 5})[1]);
  EXPECT_EQ(middle_range({}), (std::array<double, 2>{0, 1}));
}

}  // namespace
}  // namespace spherule
