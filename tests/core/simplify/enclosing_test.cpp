// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/enclosing.h"

#include <gtest/gtest.h>

#include <array>

#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

// Weights that add to 1 with which these points average to as near the origin as they can: normal equations by
// elimination.
std::vector<double> weights_of_origin(const std::vector<Vec3>& points) {
  const std::size_t m = points.size();
  std::vector<std::vector<double>> a(m, std::vector<double>(m + 1, 1));
  for (std::size_t i = 0; i < m; ++i) {
    for (std::size_t j = 0; j < m; ++j) a[i][j] = 1 + dot(points[i], points[j]);
  }
  for (std::size_t p = 0; p < m; ++p) {
    for (std::size_t i = p + 1; i < m; ++i) {
      if (std::abs(a[i][p]) > std::abs(a[p][p])) std::swap(a[i], a[p]);
    }
    for (std::size_t i = 0; i < m; ++i) {
      const double factor = i == p ? 0 : a[i][p] / a[p][p];
      for (std::size_t j = 0; j <= m; ++j) a[i][j] -= factor * a[p][j];
    }
  }
  std::vector<double> weights;
  for (std::size_t i = 0; i < m; ++i) weights.push_back(a[i][m] / a[i][i]);
  return weights;
}

Sphere around(const std::vector<Sphere>& balls) {
  return smallest_enclosing(balls, sets::all_of({.spheres = balls, .solid = {}})).sphere;
}

TEST(Enclosing, OfFewBallsInClosedForm) {
  EXPECT_EQ(around({{{1, 2, 3}, 4}}), (Sphere{{1, 2, 3}, 4}));
  EXPECT_EQ(around({{{1, 2, 3}, 0}}), (Sphere{{1, 2, 3}, 0}));
  const Sphere two = around({{{0, 0, 0}, 1}, {{5, 0, 0}, 2}});
  EXPECT_NEAR(two.radius, 4, 1e-12);
  EXPECT_NEAR(two.centre.x, 3, 1e-12);
  const Sphere nested = around({{{0, 0, 0}, 3}, {{1, 0, 0}, 1}, {{0, 1, 0}, 2}});
  EXPECT_NEAR(nested.radius, 3, 1e-12);
  EXPECT_NEAR(norm(nested.centre), 0, 1e-12);
  EXPECT_EQ(around({{{2, 0, 0}, 1}, {{2, 0, 0}, 1}, {{2, 0, 0}, 0.5}}), (Sphere{{2, 0, 0}, 1}));
  // Equal balls at the corners of a regular tetrahedron, of a square, and of a cube.
  const double h = 1 / std::sqrt(2.0);
  EXPECT_NEAR(around({{{1, 0, -h}, 0.5}, {{-1, 0, -h}, 0.5}, {{0, 1, h}, 0.5}, {{0, -1, h}, 0.5}}).radius,
              std::sqrt(1.5) + 0.5, 1e-12);
  EXPECT_NEAR(around({{{1, 1, 0}, 1}, {{-1, 1, 0}, 1}, {{1, -1, 0}, 1}, {{-1, -1, 0}, 1}}).radius, std::sqrt(2.0) + 1,
              1e-12);
  std::vector<Sphere> cube;
  for (int c = 0; c < 8; ++c) cube.push_back({{c & 1 ? 1. : -1., c & 2 ? 1. : -1., c & 4 ? 1. : -1.}, 0});
  EXPECT_NEAR(around(cube).radius, std::sqrt(3.0), 1e-12);
}

// A sphere around all balls is the smallest one when its centre is a convex combination of the centres of balls that it
// touches: moving it any way leaves one of these behind.
TEST(Enclosing, IsTheSmallestByItsOptimalityCondition) {
  for (std::uint64_t seed = 1; seed <= 300; ++seed) {
    const std::size_t n = 1 + seed % 40;
    const SphereModel model = sets::random_balls(n, 10, seed % 3 == 0 ? 0 : 0.1, seed % 5 == 0 ? 6 : 1, seed);
    const Enclosing e = smallest_enclosing(model.spheres, sets::all_of(model));
    for (const Sphere& s : model.spheres) ASSERT_LE(norm(s.centre - e.sphere.centre) + s.radius, e.sphere.radius);
    ASSERT_LE(e.support.size(), 4U);
    std::vector<Vec3> offsets;
    for (const std::uint32_t i : e.support) {
      const Sphere& s = model.spheres[i];
      EXPECT_NEAR(norm(s.centre - e.sphere.centre) + s.radius, e.sphere.radius, 1e-10);
      offsets.push_back(s.centre - e.sphere.centre);
    }
    const std::vector<double> weights = weights_of_origin(offsets);
    Vec3 mean;
    for (std::size_t i = 0; i < offsets.size(); ++i) {
      EXPECT_GT(weights[i], -1e-7) << seed;
      mean = mean + weights[i] * offsets[i];
    }
    EXPECT_LT(norm(mean), 1e-7) << seed;
  }
}

TEST(Enclosing, StaysTheSmallestForASubsetWithItsSupport) {
  const SphereModel model = sets::random_balls(60, 10, 0.1, 1, 7);
  const Enclosing e = smallest_enclosing(model.spheres, sets::all_of(model));
  std::vector<std::uint32_t> subset = e.support;
  for (std::uint32_t i = 0; i < 60; i += 7) subset.push_back(i);
  EXPECT_NEAR(smallest_enclosing(model.spheres, subset).sphere.radius, e.sphere.radius, 1e-11);
}

}  // namespace
}  // namespace spherule
