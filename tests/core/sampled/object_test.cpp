// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/sampled/object.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

// An oblique grid of uneven spacing, far from the origin.
Grid oblique() {
  const double c = std::cos(0.4), s = std::sin(0.4);
  return grid_from_affine({23, 17, 13}, {{Vec3{0.5 * c, -0.7 * s, 0}, Vec3{0.5 * s, 0.7 * c, 0}, Vec3{0, 0, -1.1}}},
                          {130, -250, 80});
}

SampledObject noise_object(const Grid& grid, Border border, std::uint64_t seed) {
  SampledObject object{grid, SampleBits(grid.dims), border};
  phantoms::Random random(seed);
  for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
        if (random.below(3) > 0) object.inside.row(j, k)[0] |= std::uint64_t{1} << i;
      }
    }
  }
  return object;
}

std::vector<Sphere> balls_near(const Grid& grid, std::size_t count, std::uint64_t seed) {
  phantoms::Random random(seed);
  std::vector<Sphere> balls;
  for (std::size_t b = 0; b < count; ++b) {
    Vec3 at;
    for (int a = 0; a < 3; ++a)
      at[a] = (1.4 * random.unit() - 0.2) * grid.spacing[a] * grid.dims[static_cast<std::size_t>(a)];
    balls.push_back({grid.to_patient(at), 3 * random.unit()});
  }
  return balls;
}

// Every sample of a grid much larger than the object's.
template <typename F>
void visit_widely(const Grid& grid, F&& f) {
  for (std::int32_t k = -15; k < grid.dims[2] + 15; ++k) {
    for (std::int32_t j = -15; j < grid.dims[1] + 15; ++j) {
      for (std::int32_t i = -15; i < grid.dims[0] + 15; ++i) {
        f(std::array<std::int32_t, 3>{i, j, k},
          grid.to_patient({i * grid.spacing.x, j * grid.spacing.y, k * grid.spacing.z}));
      }
    }
  }
}

class Borders : public testing::TestWithParam<Border> {};
INSTANTIATE_TEST_SUITE_P(Both, Borders, testing::Values(Border::closed, Border::open));

TEST_P(Borders, OverlapAgreesWithCountingEverySample) {
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const SampledObject object = noise_object(oblique(), GetParam(), seed);
    const std::vector<Sphere> balls = balls_near(object.grid, 1 + 3 * seed, seed);
    Overlap expected{.inside = object.inside.count()};
    visit_widely(object.grid, [&](std::array<std::int32_t, 3> s, Vec3 p) {
      bool held = false;
      for (const Sphere& b : balls) held |= norm(p - b.centre) <= b.radius;
      const bool exists = s[0] >= 0 && s[1] >= 0 && s[2] >= 0 && s[0] < object.grid.dims[0] &&
                          s[1] < object.grid.dims[1] && s[2] < object.grid.dims[2];
      const bool inside = object.inside.test_or_outside(s[0], s[1], s[2]);
      expected.covered += held && inside;
      expected.spilled += held && !inside && (exists || GetParam() == Border::closed);
    });
    for (const unsigned threads : {1U, 3U}) {
      const Overlap overlap = measure_overlap(balls, object, {.threads = threads, .cancel = {}, .progress = {}});
      EXPECT_EQ(overlap.inside, expected.inside);
      EXPECT_EQ(overlap.covered, expected.covered);
      EXPECT_EQ(overlap.spilled, expected.spilled);
    }
  }
}

TEST_P(Borders, ABallIsCutToTheNearestOutsideSample) {
  const SampledObject object = noise_object(oblique(), GetParam(), 5);
  std::size_t cut_balls = 0;
  for (const Sphere& ball : balls_near(object.grid, 60, 9)) {
    double nearest = ball.radius;
    visit_widely(object.grid, [&](std::array<std::int32_t, 3> s, Vec3 p) {
      const bool exists = s[0] >= 0 && s[1] >= 0 && s[2] >= 0 && s[0] < object.grid.dims[0] &&
                          s[1] < object.grid.dims[1] && s[2] < object.grid.dims[2];
      if (!object.inside.test_or_outside(s[0], s[1], s[2]) && (exists || GetParam() == Border::closed)) {
        nearest = std::min(nearest, norm(p - ball.centre));
      }
    });
    const Sphere cut = cut_to_object(ball, object);
    EXPECT_NEAR(cut.radius, nearest, 1e-9);
    EXPECT_TRUE(never_spills(std::span(&cut, 1), object));
    cut_balls += nearest < ball.radius;
    const Sphere touching{ball.centre, nearest};
    if (nearest < ball.radius) {
      EXPECT_FALSE(never_spills(std::span(&touching, 1), object)) << "doubt counts as spilling";
    }
  }
  EXPECT_GT(cut_balls, 20U);
}

TEST(Object, CoveringIsProvenToTheLastSample) {
  const Grid grid = oblique();
  SampledObject object{grid, SampleBits(grid.dims), Border::closed};
  object.inside.row(3, 4)[0] = 1U << 7;
  object.inside.row(9, 11)[0] = 1U << 2;
  const Vec3 centre = grid.to_patient({3, 4, 5});
  double far = 0;
  for (const std::array<std::int32_t, 3>& s : {std::array{7, 3, 4}, std::array{2, 9, 11}}) {
    far = std::max(far, radius_to_reach(centre, 0, s, object));
  }
  const auto covers = [&](double radius) {
    const Sphere ball{centre, radius};
    return covers_all(std::span(&ball, 1), object);
  };
  EXPECT_TRUE(covers(far));
  EXPECT_FALSE(covers(far * (1 - 1e-9)));
  EXPECT_EQ(radius_to_reach(centre, 2 * far, {7, 3, 4}, object), 2 * far);
  EXPECT_EQ(not_covered({}, object), (std::vector<std::array<std::int32_t, 3>>{{7, 3, 4}, {2, 9, 11}}));
}

TEST(Object, ARawModelOverlapsPerfectly) {
  const Volume volume = phantoms::sample(sets::dumbbell(), phantoms::cubic_grid(20, 4));
  const ObjectRule rule = phantoms::threshold(0);
  const SampledObject object{volume.grid, classify_samples(volume, rule).inside, rule.border};
  const SphereModel model = build_model(volume, rule).model;
  const Overlap overlap = measure_overlap(model.spheres, object);
  EXPECT_EQ(overlap.covered, overlap.inside);
  EXPECT_EQ(overlap.spilled, 0U);
  EXPECT_EQ(overlap.iou(), 1);
}

TEST(Object, AUnionIsSampledAsItIs) {
  const SphereModel model = sets::random_balls(40, 10, 0.3, 2, 4);
  const SampledObject object = sample_union(model.spheres, 20000);
  std::uint64_t inside = 0;
  for (std::int32_t k = 0; k < object.grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < object.grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < object.grid.dims[0]; ++i) {
        const Vec3 p = object.grid.to_patient(object.grid.spacing.x * Vec3{double(i), double(j), double(k)});
        bool held = false;
        for (const Sphere& s : model.spheres) held |= norm(p - s.centre) <= s.radius;
        ASSERT_EQ(held, object.inside.test(i, j, k));
        inside += held;
      }
    }
  }
  EXPECT_EQ(measure_overlap(model.spheres, object).covered, inside);
  EXPECT_EQ(measure_overlap(model.spheres, object).spilled, 0U) << "the grid holds the whole union";
  const std::vector<Sphere> point{{{1, 2, 3}, 0}};
  EXPECT_LE(sample_union(point, 1000).inside.count(), 1U) << "no size at all is no reason to fail";
  const std::vector<Sphere> line{{{0, 0, 0}, 0.001}, {{1000, 0, 0}, 0.001}};
  EXPECT_LT(sample_union(line, 100000).grid.sample_count(), 4000000U);
}

TEST(Object, SubsamplesTakeEveryNth) {
  const SampledObject object = noise_object(oblique(), Border::closed, 3);
  const SampledObject coarse = subsampled(object, {2, 1, 3});
  EXPECT_EQ(coarse.grid.dims, (std::array<std::int32_t, 3>{12, 17, 5}));
  EXPECT_EQ(coarse.grid.spacing, (Vec3{2 * object.grid.spacing.x, object.grid.spacing.y, 3 * object.grid.spacing.z}));
  for (std::int32_t k = 0; k < 5; ++k) {
    for (std::int32_t i = 0; i < 12; ++i) EXPECT_EQ(coarse.inside.test(i, 6, k), object.inside.test(2 * i, 6, 3 * k));
  }
}

}  // namespace
}  // namespace spherule
