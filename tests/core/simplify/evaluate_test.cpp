// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/evaluate.h"

#include <gtest/gtest.h>

#include <numbers>

#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

SampledObject object_of(const phantoms::Field& field, const Grid& grid, Border border = Border::closed) {
  const Volume volume = phantoms::sample(field, grid);
  return {grid, classify_samples(volume, phantoms::threshold(0, border)).inside, border};
}

TEST(Evaluate, ABallBesideItselfInClosedForm) {
  const double r = 1.2, d = 0.3;
  const SampledObject object = object_of(phantoms::ball({0, 0, 0}, r), phantoms::cubic_grid(100, 4));
  const std::vector<Sphere> shifted{{{d, 0, 0}, r}};
  const Achieved a = evaluate(shifted, object, {4 * kPi * r * r, {{1, 0, 0}, 1}});
  const double ball = 4 * kPi / 3 * r * r * r, lens = kPi / 12 * (4 * r + d) * (2 * r - d) * (2 * r - d);
  EXPECT_EQ(a.spheres, 1U);
  EXPECT_NEAR(a.iou, lens / (2 * ball - lens), 2e-3);
  EXPECT_NEAR(a.covered_mm3, lens, 5e-3 * ball);
  EXPECT_NEAR(a.spilled_mm3, ball - lens, 5e-3 * ball);
  EXPECT_NEAR(a.object_mm3, ball, 5e-3 * ball);
  EXPECT_NEAR(a.volume_mm3, ball, 1e-12 * ball);
  EXPECT_NEAR(a.volume_error, 0, 5e-3);
  EXPECT_NEAR(a.area_error, 0, 1e-12);
  ASSERT_TRUE(a.hausdorff);
  const double voxel = object.grid.spacing.x;
  EXPECT_NEAR(a.hausdorff->mm, d, 2 * voxel);
  EXPECT_NEAR(a.hausdorff->of_diagonal, d / (2 * std::sqrt(3.0) * r), 2 * voxel / r);
  EXPECT_EQ(a.before.betti, a.after.betti);
}

// All pairs of samples.
TEST(Evaluate, HausdorffAgreesWithTheSlowModel) {
  const Grid grid = grid_from_affine({15, 12, 9}, {{Vec3{0.3, 0, 0}, Vec3{0, -0.35, 0}, Vec3{0, 0, 0.5}}}, {-2, 2, -2});
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    const Border border = seed % 2 == 0 ? Border::open : Border::closed;
    const SampledObject object =
        object_of(seed % 3 == 0 ? phantoms::torus({0, 0, 0}, 1, 0.5) : sets::dumbbell(), grid, border);
    std::vector<Sphere> balls = sets::random_balls(1 + seed % 4, 3.5, 0.3, 1.2, seed).spheres;
    std::vector<Vec3> in_object, in_balls;
    for (std::int32_t k = -12; k < 21; ++k) {
      for (std::int32_t j = -12; j < 24; ++j) {
        for (std::int32_t i = -12; i < 27; ++i) {
          const Vec3 p = grid.to_patient({i * grid.spacing.x, j * grid.spacing.y, k * grid.spacing.z});
          const bool exists = i >= 0 && j >= 0 && k >= 0 && i < 15 && j < 12 && k < 9;
          if (object.inside.test_or_outside(i, j, k)) in_object.push_back(p);
          bool held = false;
          for (const Sphere& b : balls) held |= norm(p - b.centre) <= b.radius;
          if (held && (exists || border == Border::closed)) in_balls.push_back(p);
        }
      }
    }
    const auto farthest = [](const std::vector<Vec3>& from, const std::vector<Vec3>& to) {
      double most = 0;
      for (const Vec3 p : from) {
        double nearest = 1e9;
        for (const Vec3 q : to) nearest = std::min(nearest, norm(p - q));
        most = std::max(most, nearest);
      }
      return most;
    };
    const Achieved a = evaluate(balls, object, {1, {}});
    ASSERT_EQ(a.hausdorff.has_value(), !in_balls.empty());
    if (!a.hausdorff) continue;
    EXPECT_NEAR(a.hausdorff->to_spheres, farthest(in_object, in_balls), 1e-6) << seed;
    EXPECT_NEAR(a.hausdorff->to_object, farthest(in_balls, in_object), 1e-6) << seed;
    EXPECT_EQ(a.hausdorff->mm, std::max(a.hausdorff->to_object, a.hausdorff->to_spheres));
  }
}

TEST(Evaluate, BallsWithoutSamplesHaveNoHausdorffDistance) {
  const SampledObject object = object_of(phantoms::ball({0, 0, 0}, 1), phantoms::cubic_grid(20, 4));
  const std::vector<Sphere> tiny{{{0.05, 0.05, 0.05}, 1e-6}};
  const Achieved a = evaluate(tiny, object, {1, {}});
  EXPECT_EQ(a.iou, 0);
  EXPECT_FALSE(a.hausdorff);
}

TEST(Evaluate, TopologyBeforeAndAfter) {
  const SphereModel torus = sets::raw_model(phantoms::torus({0.011, 0.007, 0.003}, 1.1, 0.5), 20);
  const Reference reference = reference_of(torus);
  EXPECT_EQ(reference.topology.betti, (std::array<std::int64_t, 3>{1, 1, 0}));
  const SampledObject object = object_of(phantoms::torus({0.011, 0.007, 0.003}, 1.1, 0.5), phantoms::cubic_grid(20, 4));
  std::vector<Sphere> ring;
  for (int i = 0; i < 12; ++i) ring.push_back({{1.1 * std::cos(i * kPi / 6), 1.1 * std::sin(i * kPi / 6), 0}, 0.5});
  const Achieved a = evaluate(ring, object, reference);
  EXPECT_EQ(a.before.betti, a.after.betti);
  EXPECT_EQ(reference_of({.spheres = ring, .solid = {}}).topology.betti, a.after.betti);
  ring.resize(6);
  EXPECT_EQ(evaluate(ring, object, reference).after.betti, (std::array<std::int64_t, 3>{1, 0, 0}));
}

}  // namespace
}  // namespace spherule
