// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/components.h"

#include <gtest/gtest.h>

#include <cmath>
#include <deque>
#include <numbers>
#include <set>

#include "core/measure/solid.h"
#include "core/pipeline.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

std::vector<Component> components_of(std::vector<Sphere> balls) {
  const SphereModel model{.spheres = std::move(balls), .solid = {}};
  return components(model, measure_union(model).parts);
}

TEST(Components, AreJoinedWhereBallsOverlapOrTouch) {
  // A chain that touches exactly; a pair an ulp apart; nested; points on a ball, in one and alone.
  const auto found = components_of({{{0, 0, 0}, 1},
                                    {{2, 0, 0}, 1},
                                    {{4, 0, 0}, 1},
                                    {{20, 0, 0}, 1},
                                    {{std::nextafter(22, 23), 0, 0}, 1},
                                    {{30, 0, 0}, 3},
                                    {{31, 0, 0}, 1},
                                    {{4, 1, 0}, 0},
                                    {{30, 1, 0}, 0},
                                    {{50, 0, 0}, 0}});
  ASSERT_EQ(found.size(), 5U);
  EXPECT_EQ(found[0].spheres, 3U);  // the ball of radius 3
  EXPECT_EQ(found[0].first_sphere, 5U);
  EXPECT_NEAR(found[0].volume_mm3, 36 * kPi, 1e-10);
  EXPECT_NEAR(found[0].area_mm2, 36 * kPi, 1e-10);
  EXPECT_EQ(found[0].bounds.min, (Vec3{27, -3, -3}));
  EXPECT_EQ(found[0].bounds.max, (Vec3{33, 3, 3}));
  EXPECT_EQ(found[1].spheres, 4U);  // the chain
  EXPECT_NEAR(found[1].volume_mm3, 4 * kPi, 1e-10);
  EXPECT_EQ(found[1].bounds.max, (Vec3{5, 1, 1}));
  EXPECT_EQ(found[2].first_sphere, 3U);
  EXPECT_EQ(found[3].first_sphere, 4U);
  EXPECT_EQ(found[4].volume_mm3, 0);
  EXPECT_EQ(found[4].bounds.min, (Vec3{50, 0, 0}));
}

// Where double cannot tell: far from the origin, or when the reach is a rounded sum.
TEST(Components, DecideContactExactly) {
  const double far = 0x1p40, ulp = 0x1p-12;
  EXPECT_EQ(components_of({{{far, 0, 0}, 1}, {{far + 2, 0, 0}, 1}}).size(), 1U);
  EXPECT_EQ(components_of({{{far, 0, 0}, 1}, {{far + 2 + ulp, 0, 0}, 1}}).size(), 2U);
  // 3-4-5: contact off the axes.
  EXPECT_EQ(components_of({{{0, 0, 0}, 2}, {{3, 4, 0}, 3}}).size(), 1U);
  EXPECT_EQ(components_of({{{0, 0, 0}, 2}, {{3, 4, 0}, std::nextafter(3.0, 2.0)}}).size(), 2U);
  // The sum of these radii rounds up to 1.
  EXPECT_EQ(components_of({{{0, 0, 0}, 0.5}, {{1, 0, 0}, 0.5 - 0x1p-54}}).size(), 2U);
  EXPECT_TRUE(components_of({}).empty());
}

TEST(Components, AgreeWithAllPairsOnRandomBalls) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    phantoms::Random random(seed);
    std::vector<Sphere> balls;
    for (int i = 0; i < 200; ++i) {
      balls.push_back({{10 * random.unit(), 10 * random.unit(), 10 * random.unit()},
                       random.below(20) == 0 ? 2 * random.unit() : 0.5 * random.unit()});
    }
    std::multiset<std::size_t> sizes;
    std::vector<bool> seen(balls.size());
    for (std::size_t b = 0; b < balls.size(); ++b) {
      std::size_t size = 0;
      for (std::deque<std::size_t> todo{b}; !todo.empty(); todo.pop_front()) {
        const std::size_t at = todo.front();
        if (seen[at]) continue;
        seen[at] = true;
        ++size;
        for (std::size_t o = 0; o < balls.size(); ++o) {
          if (norm(balls[o].centre - balls[at].centre) <= balls[o].radius + balls[at].radius) todo.push_back(o);
        }
      }
      if (size > 0) sizes.insert(size);
    }
    const SphereModel model{.spheres = balls, .solid = {}};
    const UnionMeasures whole = measure_union(model);
    const auto found = components(model, whole.parts);
    std::multiset<std::size_t> found_sizes;
    double volume = 0, area = 0, before = HUGE_VAL;
    for (const Component& c : found) {
      found_sizes.insert(c.spheres);
      volume += c.volume_mm3, area += c.area_mm2;
      EXPECT_LE(c.volume_mm3, before);
      before = c.volume_mm3;
    }
    EXPECT_EQ(found_sizes, sizes) << seed;
    EXPECT_NEAR(volume, whole.moments.volume, 1e-10 * volume);
    EXPECT_NEAR(area, whole.area_mm2, 1e-10 * area);
  }
}

TEST(Components, OfRawModelsAreThoseOfTheirTopology) {
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const Volume volume =
        phantoms::noise({.dims = {12, 10, 9}, .spacing = {1, 1, 2}, .origin = {5, 6, 7}, .direction = {}}, 10, seed);
    const auto model = build_model(volume, phantoms::threshold(7.5)).model;
    const auto found = components(model, measure_union(model).parts);
    EXPECT_EQ(found.size(), static_cast<std::size_t>(measure_tetrahedra(*model.solid).topology.betti[0]));
    std::uint64_t spheres = 0;
    Box all;
    for (const Component& c : found) {
      spheres += c.spheres;
      all.include(c.bounds.min), all.include(c.bounds.max);
    }
    EXPECT_EQ(spheres, model.spheres.size());
    EXPECT_EQ(all.min, bounds(model).min);
    EXPECT_EQ(all.max, bounds(model).max);
  }
  const auto pair = phantoms::either(phantoms::ball({-1, 0, 0}, 0.8), phantoms::ball({1, 0.1, 0}, 0.5));
  const auto model = build_model(phantoms::sample(pair, phantoms::cubic_grid(60, 4)), phantoms::threshold(0)).model;
  const auto found = components(model, measure_union(model).parts);
  ASSERT_EQ(found.size(), 2U);
  EXPECT_NEAR(found[0].volume_mm3, 4 * kPi / 3 * 0.512, 0.01 * found[0].volume_mm3);
  EXPECT_NEAR(found[1].volume_mm3, 4 * kPi / 3 * 0.125, 0.01 * found[1].volume_mm3);
  EXPECT_NEAR(found[1].area_mm2, kPi, 0.15 * kPi);
  EXPECT_NEAR(found[0].bounds.min.x, -1.8, 0.01);
  EXPECT_NEAR(found[1].bounds.max.x, 1.5, 0.01);
}

}  // namespace
}  // namespace spherule
