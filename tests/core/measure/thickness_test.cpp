// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/thickness.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <numbers>
#include <numeric>

#include "core/measure/union.h"
#include "core/pipeline.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

LocalThickness thickness_of(const std::vector<Sphere>& balls, std::uint64_t samples = 1 << 18,
                            const Context& context = {}) {
  return local_thickness(balls, measure_union(std::span(balls)).moments.volume, 40, samples, context);
}

TEST(Thickness, OfOneBallIsItsDiameter) {
  const auto t = thickness_of({{{10, -20, 30}, 2.5}});
  for (const double figure : {t.mean_mm, t.min_mm, t.max_mm, t.percentiles_mm[0], t.percentiles_mm[4]}) {
    EXPECT_EQ(figure, 5);
  }
  EXPECT_EQ(t.sd_mm, 0);
  EXPECT_NEAR(t.sampled_volume_mm3, 4 * kPi / 3 * 2.5 * 2.5 * 2.5, 0.002 * t.sampled_volume_mm3);
  EXPECT_EQ(t.volumes_mm3[0], t.sampled_volume_mm3);
}

TEST(Thickness, WeighsByVolume) {
  // Balls of radius 1 and 2 apart from each other, and one hidden: volumes 1 to 8.
  const auto t = thickness_of({{{0, 0, 0}, 1}, {{100, 5, -3}, 2}, {{100, 5.5, -3}, 0.5}, {{50, 0, 0}, 0}});
  EXPECT_NEAR(t.mean_mm, (2 + 8 * 4) / 9.0, 0.004);
  EXPECT_NEAR(t.sd_mm, std::sqrt(8) / 9 * 2, 0.004);
  EXPECT_EQ(t.min_mm, 2);
  EXPECT_EQ(t.max_mm, 4);
  EXPECT_EQ(t.percentiles_mm, (std::array<double, 5>{2, 4, 4, 4, 4}));
  EXPECT_NEAR(t.volumes_mm3.front(), 4 * kPi / 3, 0.02);
  EXPECT_NEAR(t.volumes_mm3.back(), 32 * kPi / 3, 0.05);
  EXPECT_NEAR(std::accumulate(t.volumes_mm3.begin(), t.volumes_mm3.end(), 0.0), t.sampled_volume_mm3, 1e-9);
}

TEST(Thickness, OfWhatHasNoVolumeIsZero) {
  for (const auto& balls : {std::vector<Sphere>{}, std::vector<Sphere>{{{1, 2, 3}, 0}, {{4, 5, 6}, 0}}}) {
    const auto t = thickness_of(balls);
    EXPECT_EQ(t.samples, 0U);
    EXPECT_EQ(t.mean_mm, 0);
    EXPECT_EQ(t.volumes_mm3.size(), 40U);
  }
}

// Two specks a million kilometres apart: too far for a lattice that would show both.
TEST(Thickness, BearsWhateverIsFarApart) {
  const std::vector<Sphere> specks{{{0, 0, 0}, 1}, {{1e12, 0, 0}, 1}};
  const auto t = thickness_of(specks);
  EXPECT_LE(t.samples, 2U);
  EXPECT_TRUE(t.mean_mm == 0 || t.mean_mm == 2);
}

// The slow obvious model: the largest ball that holds a random point of the union.
TEST(Thickness, AgreesWithRandomPoints) {
  for (const std::uint64_t seed : {1, 2, 3}) {
    phantoms::Random random(seed);
    std::vector<Sphere> balls;
    for (int i = 0; i < 60; ++i) {
      balls.push_back({{6 * random.unit(), 4 * random.unit(), 5 * random.unit()}, 0.1 + 1.2 * random.unit()});
    }
    const auto t = thickness_of(balls, 1 << 20);
    Box box;
    for (const Sphere& ball : balls) box.include(ball);
    std::vector<double> found;
    const Vec3 extent = box.max - box.min;
    while (found.size() < 200'000) {
      const Vec3 p = box.min + Vec3{extent.x * random.unit(), extent.y * random.unit(), extent.z * random.unit()};
      double largest = -1;
      for (const Sphere& ball : balls) {
        if (squared_norm(p - ball.centre) <= ball.radius * ball.radius) largest = std::max(largest, ball.radius);
      }
      if (largest >= 0) found.push_back(2 * largest);
    }
    const auto n = static_cast<double>(found.size());
    const double mean = std::accumulate(found.begin(), found.end(), 0.0) / n;
    const double sd = std::sqrt(std::accumulate(found.begin(), found.end(), 0.0,
                                                [&](double s, double f) { return s + (f - mean) * (f - mean); }) /
                                n);
    EXPECT_NEAR(t.mean_mm, mean, 5 * sd / std::sqrt(n));
    EXPECT_NEAR(t.sd_mm, sd, 5 * sd / std::sqrt(n));
    std::ranges::sort(found);
    for (std::size_t i = 0; i < 5; ++i) {
      // Where the random points put this thickness is about this percent.
      const auto [from, to] = std::ranges::equal_range(found, t.percentiles_mm[i]);
      const double percent = LocalThickness::percents[i];
      EXPECT_LE(100 * static_cast<double>(from - found.begin()) / n, percent + 0.6);
      EXPECT_GE(100 * static_cast<double>(to - found.begin()) / n, percent - 0.6);
    }
  }
}

TEST(Thickness, OfPhantomsIsTheirs) {
  struct Case {
    const char* name;
    phantoms::Field field;
    Grid grid;
    double thickness;
  };
  const Grid flat{.dims = {40, 40, 16}, .spacing = {0.1, 0.1, 0.1}, .origin = {-2, -2, -0.8}, .direction = {}};
  const Grid tall{.dims = {26, 26, 60}, .spacing = {0.1, 0.1, 0.1}, .origin = {-1.25, -1.25, -3}, .direction = {}};
  for (const Case& c :
       {Case{"slab", phantoms::slab(0.02, 0.5), flat, 1}, Case{"cylinder", phantoms::cylinder({0, 0, 0}, 1), tall, 2},
        Case{"ball", phantoms::ball({0, 0, 0}, 1), phantoms::cubic_grid(28, 2.4), 2}}) {
    const auto model = build_model(phantoms::sample(c.field, c.grid), phantoms::threshold(0)).model;
    const auto t = local_thickness(model, measure_union(model).moments.volume, 40, 1 << 20);
    // Rims at the border are thinner.
    EXPECT_NEAR(t.percentiles_mm[2], c.thickness, 0.03 * c.thickness) << c.name;
    EXPECT_NEAR(t.mean_mm, c.thickness, 0.05 * c.thickness) << c.name;
    EXPECT_NEAR(static_cast<double>(t.samples), 1 << 20, 1000) << c.name;
  }
}

// Knowing which part of the union is whose changes the time and nothing else.
TEST(Thickness, OfARawModelIsThatOfItsBalls) {
  std::vector<SphereModel> models;
  for (const Border border : {Border::closed, Border::open}) {
    const Grid grid{.dims = {14, 12, 9}, .spacing = {1, 1, 2}, .origin = {9, 9, 9}, .direction = {}};
    models.push_back(build_model(phantoms::noise(grid, 9, 8), phantoms::threshold(4, border)).model);
  }
  models.push_back(build_model(phantoms::sample(phantoms::torus({0, 0, 0.01}, 0.9, 0.4), phantoms::cubic_grid(20, 3)),
                               phantoms::threshold(0))
                       .model);
  for (const SphereModel& model : models) {
    const double volume = measure_union(model).moments.volume;
    const auto raw = local_thickness(model, volume), plain = local_thickness(model.spheres, volume);
    EXPECT_EQ(raw.samples, plain.samples);
    EXPECT_EQ(raw.mean_mm, plain.mean_mm);
    EXPECT_EQ(raw.sd_mm, plain.sd_mm);
    EXPECT_EQ(raw.percentiles_mm, plain.percentiles_mm);
    EXPECT_EQ(raw.volumes_mm3, plain.volumes_mm3);
    EXPECT_NEAR(raw.sampled_volume_mm3, volume, 1e-3 * volume);
  }
}

TEST(Thickness, IsTheSameForAnyThreadCount) {
  const auto model =
      build_model(phantoms::noise({.dims = {20, 24, 22}, .spacing = {1, 1, 2}, .origin = {}, .direction = {}}, 9, 4),
                  phantoms::threshold(3))
          .model;
  const double volume = measure_union(model).moments.volume;
  const auto one = local_thickness(model, volume);
  for (const unsigned threads : {2U, 7U}) {
    const auto many = local_thickness(model, volume, 40, 1 << 22, {.threads = threads, .cancel = {}, .progress = {}});
    EXPECT_EQ(many.mean_mm, one.mean_mm);
    EXPECT_EQ(many.sd_mm, one.sd_mm);
    EXPECT_EQ(many.samples, one.samples);
    EXPECT_EQ(many.volumes_mm3, one.volumes_mm3);
  }
}

TEST(Thickness, RefusesWrongBucketsAndCanBeCancelled) {
  const std::vector<Sphere> ball{{{0, 0, 0}, 1}};
  for (const std::size_t bad : {std::size_t{0}, std::size_t{65537}}) {
    EXPECT_THROW(local_thickness(ball, 4, bad), Error);
  }
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THROW(thickness_of(ball, 1 << 18, {.threads = 1, .cancel = stop.get_token(), .progress = {}}), Error);
}

}  // namespace
}  // namespace spherule
