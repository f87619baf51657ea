// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/enclosing.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <vector>

#include "tests/phantoms.h"

namespace spherule {
namespace {

void expect_near(const Sphere& a, const Sphere& b, double tolerance = 1e-12) {
  EXPECT_NEAR(norm(a.centre - b.centre), 0, tolerance);
  EXPECT_NEAR(a.radius, b.radius, tolerance);
}

double reach(Vec3 from, const std::vector<Sphere>& balls) {
  double most = 0;
  for (const Sphere& ball : balls) most = std::max(most, norm(ball.centre - from) + ball.radius);
  return most;
}

TEST(SmallestEnclosing, OfOneAndTwoAndNestedBalls) {
  expect_near(smallest_enclosing_sphere({}), {});
  const Sphere one{{1, 2, 3}, 4};
  expect_near(smallest_enclosing_sphere(std::vector{one}), one);
  expect_near(smallest_enclosing_sphere(std::vector{one, one, one}), one);
  expect_near(smallest_enclosing_sphere(std::vector<Sphere>{{{5, 0, 0}, 0}}), {{5, 0, 0}, 0});
  // From -1 to 12 along x.
  expect_near(smallest_enclosing_sphere(std::vector<Sphere>{{{0, 0, 0}, 1}, {{10, 0, 0}, 2}}), {{5.5, 0, 0}, 6.5});
  expect_near(smallest_enclosing_sphere(std::vector<Sphere>{{{0, 0, 0}, 5}, {{1, 1, 0}, 2}, {{0, 0, 3}, 2}}),
              {{0, 0, 0}, 5});
}

TEST(SmallestEnclosing, OfRegularArrangements) {
  std::vector<Sphere> corners;
  for (int i = 0; i < 8; ++i) corners.push_back({{i & 1 ? 7. : 5., i & 2 ? 1. : -1., i & 4 ? 1. : -1.}, 0.5});
  expect_near(smallest_enclosing_sphere(corners), {{6, 0, 0}, std::sqrt(3.0) + 0.5});
  const std::vector<Sphere> tetrahedron{{{1, 1, 1}, 1}, {{1, -1, -1}, 1}, {{-1, 1, -1}, 1}, {{-1, -1, 1}, 1}};
  expect_near(smallest_enclosing_sphere(tetrahedron), {{0, 0, 0}, std::sqrt(3.0) + 1});
}

// The reach of a centre is convex: where no small step in any direction shortens it, it is least.
TEST(SmallestEnclosing, IsTheLeastOnRandomSets) {
  for (std::uint64_t seed = 1; seed <= 40; ++seed) {
    phantoms::Random random(seed);
    std::vector<Sphere> balls;
    const auto count = 1 + random.below(seed % 2 ? 6 : 300);
    for (std::uint64_t i = 0; i < count; ++i) {
      balls.push_back({{random.unit(), 2 * random.unit(), random.unit()}, 0.5 * random.unit() * random.unit()});
    }
    const Sphere found = smallest_enclosing_sphere(balls);
    ASSERT_EQ(found.radius, reach(found.centre, balls));
    for (int d = 0; d < 500; ++d) {
      const Vec3 step{random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.5};
      for (const double length : {1e-5, 1e-2}) {
        ASSERT_GE(reach(found.centre + length * step, balls), found.radius - 1e-13) << seed;
      }
    }
    std::ranges::reverse(balls);
    expect_near(smallest_enclosing_sphere(balls), found, 1e-9);
  }
}

TEST(LargestSphere, IsTheFirstOfTheLargest) {
  expect_near(largest_sphere({}), {});
  EXPECT_EQ(largest_sphere(std::vector<Sphere>{{{1, 0, 0}, 1}, {{2, 0, 0}, 3}, {{3, 0, 0}, 3}, {{4, 0, 0}, 2}}),
            (Sphere{{2, 0, 0}, 3}));
}

TEST(LargestInscribed, IsTheLargestMemberWhereBallsOnlyTouchOrNest) {
  expect_near(largest_inscribed_sphere({}), {});
  const Sphere one{{1, 2, 3}, 4};
  expect_near(largest_inscribed_sphere(std::vector{one, one}), one);
  expect_near(largest_inscribed_sphere(std::vector<Sphere>{{{0, 0, 0}, 1}, {{1, 0, 0}, 1.2}, {{9, 0, 0}, 0}}),
              {{1, 0, 0}, 1.2});
}

// Balls around the corners of a cube that hold its middle: four of them meet over each of its faces.
TEST(LargestInscribed, SpansEightBallsOnACube) {
  std::vector<Sphere> balls;
  for (int i = 0; i < 8; ++i) balls.push_back({{i & 1 ? 6. : 4., i & 2 ? 1. : -1., i & 4 ? 1. : -1.}, 1.9});
  const double expected = 1 + std::sqrt(1.9 * 1.9 - 2);
  expect_near(largest_inscribed_sphere(balls), {{5, 0, 0}, expected}, 1e-8);
  // Balls that leave a hole in the middle have none larger than themselves.
  for (Sphere& ball : balls) ball.radius = 1.7;
  EXPECT_EQ(largest_inscribed_sphere(balls).radius, 1.7);
}

// Four equal balls whose centres form a regular tetrahedron of circumradius 1: three meet beyond each face, at 1/3 and
// the height of a point at the radius from corners √8/3 away from the face's middle.
TEST(LargestInscribed, SpansFourBallsOnATetrahedron) {
  for (const double radius : {1.1, 1.5, 3.0}) {
    const double s = 1 / std::sqrt(3.0);
    const std::vector<Sphere> balls{
        {{s, s, s}, radius}, {{s, -s, -s}, radius}, {{-s, s, -s}, radius}, {{-s, -s, s}, radius}};
    const double expected = std::max(radius, 1.0 / 3 + std::sqrt(radius * radius - 8.0 / 9));
    EXPECT_NEAR(largest_inscribed_sphere(balls).radius, expected, 1e-8) << radius;
  }
}

// Climbs on the distance to points of the surface.
TEST(LargestInscribed, IsWhatClimbingFinds) {
  int larger = 0;
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    phantoms::Random random(seed);
    const auto unit = [&] { return random.unit(); };
    std::vector<Sphere> balls(12);
    for (Sphere& b : balls) b = {{1.6 * unit(), 1.6 * unit(), 1.6 * unit()}, 0.6 + 0.4 * unit()};
    std::vector<Vec3> surface;
    for (const Sphere& b : balls) {
      for (int i = 0; i < 2000; ++i) {
        const double z = (2 * i + 1) / 2000.0 - 1, angle = 2.399963229728653 * i, r = std::sqrt(1 - z * z);
        const Vec3 p = b.centre + b.radius * Vec3{r * std::cos(angle), r * std::sin(angle), z};
        if (std::ranges::none_of(balls, [&](const Sphere& o) { return norm(p - o.centre) < o.radius - 1e-12; }))
          surface.push_back(p);
      }
    }
    const auto depth = [&](Vec3 p) {
      if (std::ranges::none_of(balls, [&](const Sphere& o) { return norm(p - o.centre) < o.radius; })) return 0.0;
      double least = 1e9;
      for (const Vec3 q : surface) least = std::min(least, squared_norm(p - q));
      return std::sqrt(least);
    };
    double deepest = 0;
    for (const Sphere& start : balls) {
      Vec3 at = start.centre;
      double here = depth(at);
      for (double step = 0.3; step > 1e-3; step *= 0.6) {
        for (int tried = 0; tried < 12; ++tried) {
          const Vec3 there = at + step * Vec3{unit() - 0.5, unit() - 0.5, unit() - 0.5};
          const double d = depth(there);
          if (d > here) at = there, here = d;
        }
      }
      deepest = std::max(deepest, here);
    }
    const Sphere found = largest_inscribed_sphere(balls);
    // Points of the surface are about 0.06 apart, so that the depth is too large by less than that squared and halved.
    EXPECT_NEAR(found.radius, deepest, 0.015) << seed;
    larger += found.radius > largest_sphere(balls).radius;
  }
  EXPECT_GE(larger, 1);
}

}  // namespace
}  // namespace spherule
