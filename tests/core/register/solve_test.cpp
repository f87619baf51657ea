// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/solve.h"

#include <gtest/gtest.h>

#include <cmath>

#include "tests/core/register/poses.h"

namespace spherule {
namespace {

using poses::expect_maps_near;

std::vector<PointPair> pairs_under(const AffineMap& map, std::size_t count, std::uint64_t seed) {
  phantoms::Random random(seed);
  std::vector<PointPair> pairs;
  for (std::size_t i = 0; i < count; ++i) {
    const Vec3 p = poses::within_cube(random, 10);
    pairs.push_back({p, map(p), 0.1 + random.unit()});
  }
  return pairs;
}

double cost(const AffineMap& map, std::span<const PointPair> pairs) {
  double sum = 0;
  for (const PointPair& p : pairs) sum += p.weight * squared_norm(p.fixed - map(p.moving));
  return sum;
}

TEST(Solve, RecoversExactMaps) {
  phantoms::Random random(1);
  for (int t = 0; t < 50; ++t) {
    const Mat3 turn = poses::random_rotation(random);
    const Vec3 shift = poses::within_cube(random, 500);
    const AffineMap rigid{turn, shift}, similar{scaled(0.2 + 3 * random.unit(), turn), shift};
    AffineMap affine = similar;
    for (Vec3& row : affine.linear.rows) row = row + poses::within_cube(random, 0.1);
    for (const TransformKind kind : {TransformKind::rigid, TransformKind::similarity, TransformKind::affine}) {
      expect_maps_near(solve(kind, pairs_under(rigid, 12, t)), rigid, 1e-10, 10);
      if (kind == TransformKind::rigid) continue;
      expect_maps_near(solve(kind, pairs_under(similar, 12, t)), similar, 1e-10, 10);
      if (kind == TransformKind::similarity) continue;
      expect_maps_near(solve(kind, pairs_under(affine, 12, t)), affine, 1e-10, 10);
    }
  }
}

TEST(Solve, ThreePointsAreEnough) {
  phantoms::Random random(2);
  const AffineMap truth{scaled(1.7, poses::random_rotation(random)), {3, -4, 5}};
  // For affine maps too: three points lie in a plane, and the best similarity is what is left.
  for (const TransformKind kind : {TransformKind::similarity, TransformKind::affine})
    expect_maps_near(solve(kind, pairs_under(truth, 3, 5)), truth, 1e-9, 10);
}

// No small step away from the answer is better: at noisy pairs, where nothing fits exactly.
TEST(Solve, IsTheLeastOfItsKind) {
  phantoms::Random random(3);
  for (int t = 0; t < 20; ++t) {
    std::vector<PointPair> pairs = pairs_under({poses::random_rotation(random), {1, 2, 3}}, 9, 100 + t);
    for (PointPair& p : pairs) p.fixed = p.fixed + poses::within_cube(random, 3);
    for (const TransformKind kind : {TransformKind::rigid, TransformKind::similarity, TransformKind::affine}) {
      const AffineMap best = solve(kind, pairs);
      const double least = cost(best, pairs);
      for (int s = 0; s < 60; ++s) {
        AffineMap other = best;
        other.linear = rotation(poses::within_cube(random, 0.02)) * other.linear;
        other.shift = other.shift + poses::within_cube(random, 0.02);
        if (kind != TransformKind::rigid) other.linear = scaled(1 + 0.02 * (random.unit() - 0.5), other.linear);
        if (kind == TransformKind::affine)
          for (Vec3& row : other.linear.rows) row = row + poses::within_cube(random, 0.02);
        EXPECT_GE(cost(other, pairs), least * (1 - 1e-12));
      }
    }
  }
}

TEST(Solve, NeverReflects) {
  phantoms::Random random(4);
  std::vector<PointPair> pairs = pairs_under({}, 20, 7);
  for (PointPair& p : pairs) p.fixed.x = -p.fixed.x;
  for (const TransformKind kind : {TransformKind::rigid, TransformKind::similarity, TransformKind::affine}) {
    const AffineMap best = solve(kind, pairs);
    EXPECT_GT(determinant(best.linear), 0);
    // Every other rotation about the centroids is worse, at the same scale.
    Vec3 moving, fixed;
    double weight = 0;
    for (const PointPair& p : pairs) {
      moving = moving + p.weight * p.moving, fixed = fixed + p.weight * p.fixed;
      weight += p.weight;
    }
    for (int s = 0; s < 300; ++s) {
      AffineMap other{scaled(scale_of(best), poses::random_rotation(random)), {}};
      other.shift = (1 / weight) * (fixed - other.linear * moving);
      EXPECT_GE(cost(other, pairs), cost(best, pairs) * (1 - 1e-12));
    }
  }
}

TEST(Solve, DegeneratePointsGiveAMapAllTheSame) {
  const auto is_proper = [](const AffineMap& m) { return determinant(m.linear) > 0 && std::isfinite(m.shift.x); };
  for (const TransformKind kind : {TransformKind::rigid, TransformKind::similarity, TransformKind::affine}) {
    EXPECT_EQ(solve(kind, {}), AffineMap{});
    const std::vector<PointPair> one{{{1, 2, 3}, {4, 5, 6}, 1}};
    EXPECT_TRUE(is_proper(solve(kind, one)));
    EXPECT_NEAR(norm(solve(kind, one)({1, 2, 3}) - Vec3{4, 5, 6}), 0, 1e-12);
    const std::vector<PointPair> line{{{0, 0, 0}, {1, 0, 0}, 1}, {{1, 0, 0}, {1, 1, 0}, 1}, {{2, 0, 0}, {1, 2, 0}, 1}};
    EXPECT_TRUE(is_proper(solve(kind, line)));
    EXPECT_NEAR(rms_residual(solve(kind, line), line), 0, 1e-12);
    const std::vector<PointPair> weightless{{{1, 2, 3}, {4, 5, 6}, 0}};
    EXPECT_EQ(solve(kind, weightless), AffineMap{});
  }
}

}  // namespace
}  // namespace spherule
