// SPDX-License-Identifier: GPL-3.0-or-later
//
// The patches against the slow obvious model: every ray against every ball.
#include "core/render/patches.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <limits>

#include "core/base/error.h"
#include "core/render/trace.h"
#include "core/trees/box_tree.h"
#include "tests/core/render/scenes.h"

namespace spherule {
namespace {

constexpr double kNever = std::numeric_limits<double>::infinity();

double slow_first_hit(std::span<const Sphere> spheres, const Ray& ray) {
  double first = kNever;
  for (const Sphere& s : spheres) {
    const Vec3 v = s.centre - ray.origin;
    const double along = dot(v, ray.direction);
    const double square = s.radius * s.radius - squared_norm(v - along * ray.direction);
    if (square > 0 && along - std::sqrt(square) >= 0) first = std::min(first, along - std::sqrt(square));
  }
  return first;
}

// Rays from outside the box of all balls towards places in and about random ones.
std::vector<Ray> rays_from_outside(std::span<const Sphere> spheres, std::size_t n) {
  Box box;
  for (const Sphere& s : spheres) box.include(s);
  const double far = 2 * norm(box.max - box.min);
  std::mt19937_64 random(3);
  std::uniform_real_distribution<double> part(-1, 1);
  std::vector<Ray> rays;
  while (rays.size() < n) {
    const Vec3 d{part(random), part(random), part(random)};
    if (norm(d) < 0.01) continue;
    const Sphere& s = spheres[random() % spheres.size()];
    const Vec3 target = s.centre + 1.2 * s.radius * Vec3{part(random), part(random), part(random)};
    rays.push_back({target - far * normalised(d), normalised(d)});
  }
  return rays;
}

void expect_same_hits(const SphereModel& model, std::size_t rays) {
  const auto patches = visible_patches(model);
  const auto tracer = trace_balls(model.spheres, patches, {}, {});
  std::size_t hits = 0;
  for (const Ray& ray : rays_from_outside(model.spheres, rays)) {
    const double expected = slow_first_hit(model.spheres, ray);
    const auto hit = tracer->first_hit(ray);
    ASSERT_EQ(hit.has_value(), expected < kNever);
    ASSERT_EQ(tracer->blocked(ray), hit.has_value());
    if (!hit) continue;
    ++hits;
    // Balls through the same corner may be a rounding apart there.
    ASSERT_NEAR(hit->distance, expected, 1e-9);
  }
  EXPECT_GT(hits, rays / 10);
}

TEST(Patches, OfARawModelShowWhatAllItsBallsShow) {
  const SphereModel model = raw_model();
  ASSERT_GT(model.spheres.size(), 4000U);
  expect_same_hits(model, 5000);
}

TEST(Patches, OfTheSameBallsWithoutTheirSolidShowTheSame) {
  SphereModel model = raw_model();
  const std::size_t of_solid = visible_patches(model).size();
  model.solid.reset();
  expect_same_hits(model, 5000);
  EXPECT_LT(visible_patches(model).size(), 20 * of_solid);
}

TEST(Patches, OfOverlappingBalls) {
  for (const std::size_t n : {1U, 5U, 300U, 3000U})
    for (const double radius : {2.0, 4.0, 9.0}) expect_same_hits(random_balls(n, radius), 5000);
}

TEST(Patches, OfBallsThatTouchInOnePoint) {
  SphereModel model;
  std::mt19937_64 random(1);
  std::normal_distribution<double> normal;
  for (int i = 0; i < 400; ++i) {
    const Vec3 d = normalised(Vec3{normal(random), normal(random), normal(random)});
    model.spheres.push_back({(1 + i % 5) * d, 1.0 + i % 5});  // all pass through the origin
  }
  expect_same_hits(model, 3000);
}

// All balls touch one sphere from inside, and each shows where it does: a ray must not try them all.
TEST(Patches, OfARoundObjectAreFewInOnePlace) {
  SphereModel model;
  std::mt19937_64 random(3);
  std::normal_distribution<double> normal;
  std::uniform_real_distribution<double> radii(5, 25);
  const auto direction = [&] { return normalised(Vec3{normal(random), normal(random), normal(random)}); };
  for (int i = 0; i < 10'000; ++i) {
    const double radius = radii(random);
    model.spheres.push_back({(30 - radius) * direction(), radius});
  }
  const auto patches = visible_patches(model);
  std::size_t met = 0;
  constexpr int kPlaces = 300;
  for (int i = 0; i < kPlaces; ++i) {
    const Vec3 place = 29.99 * direction();
    met += static_cast<std::size_t>(std::ranges::count_if(patches, [&](const Patch& patch) {
      Box box;
      box.include(place);
      return overlap(patch.box, box);
    }));
  }
  EXPECT_LT(met, 40U * kPlaces);
  expect_same_hits(model, 2000);
}

// Memory is a patch's times their number: 2³ of them a ball, however much surface there is to divide.
TEST(Patches, AreFewForManyBallsInARow) {
  for (const double apart : {0.01, 0.1, 1.0, 1.9}) {
    SphereModel row;
    for (int i = 0; i < 40'000; ++i) row.spheres.push_back({{apart * i, 0, 0}, 1});
    const auto patches = visible_patches(row);
    EXPECT_LE(patches.size(), (std::size_t{1} << 19) + 16 * row.spheres.size());
    EXPECT_GE(patches.size(), row.spheres.size() / 2);
  }
}

TEST(Patches, HiddenAndEmptyBallsHaveNone) {
  SphereModel model;
  model.spheres = {{{0, 0, 0}, 5}, {{1, 0, 0}, 0}};
  for (int i = 0; i < 100; ++i) model.spheres.push_back({{0.01 * i, 0, 0}, 2});
  for (const Patch& patch : visible_patches(model)) EXPECT_EQ(patch.ball, 0U);
  model.spheres = {{{1, 2, 3}, 0}};
  EXPECT_TRUE(visible_patches(model).empty());
  EXPECT_TRUE(visible_patches({}).empty());
}

TEST(Patches, AreTheSameForEveryThreadCount) {
  for (const SphereModel& model : {raw_model(), random_balls(3000, 2)}) {
    const auto one = visible_patches(model);
    Context many;
    many.threads = 5;
    const auto five = visible_patches(model, many);
    ASSERT_EQ(one.size(), five.size());
    for (std::size_t i = 0; i < one.size(); ++i) {
      ASSERT_EQ(one[i].ball, five[i].ball);
      ASSERT_EQ(one[i].box.min, five[i].box.min);
      ASSERT_EQ(one[i].box.max, five[i].box.max);
    }
  }
}

TEST(Tracer, HugeBallWithASmallPatchIsHitToTheNanometre) {
  const double radius = 1e6;
  const Sphere ball{{0, radius, 0}, radius};
  Patch patch;
  patch.box.include(Vec3{-1, -0.001, -1}), patch.box.include(Vec3{1, 0.001, 1});
  const auto tracer = trace_balls(std::span(&ball, 1), std::span(&patch, 1), {}, {});
  for (const double x : {-0.9, -0.3, 0.0, 0.5}) {
    const auto hit = tracer->first_hit({{x, -10, 0.2}, {0, 1, 0}});
    ASSERT_TRUE(hit);
    const double rim = x * x + 0.04;
    EXPECT_NEAR(hit->distance, 10 + rim / (radius + std::sqrt(radius * radius - rim)), 1e-6);
  }
}

TEST(Tracer, EqualDistancesGoToTheFirstBall) {
  std::vector<Sphere> spheres(20, Sphere{{0, 0, 0}, 1});
  std::vector<Patch> patches;
  for (std::uint32_t i = 20; i-- > 0;) {
    patches.push_back({{}, i});
    patches.back().box.include(spheres[i]);
  }
  const auto tracer = trace_balls(spheres, patches, {}, {});
  const auto hit = tracer->first_hit({{0.1, -5, 0.2}, {0, 1, 0}});
  ASSERT_TRUE(hit);
  EXPECT_EQ(hit->primitive, 0U);
}

TEST(Tracer, StopsWhenCancelled) {
  std::stop_source source;
  source.request_stop();
  Context context;
  context.cancel = source.get_token();
  const SphereModel model = random_balls(100, 1);
  EXPECT_THROW(trace_balls(model.spheres, visible_patches(model), {}, context), Error);
}

}  // namespace
}  // namespace spherule
