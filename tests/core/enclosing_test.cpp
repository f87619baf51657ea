// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/enclosing.h"

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

}  // namespace
}  // namespace spherule
