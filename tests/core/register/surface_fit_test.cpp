// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/surface_fit.h"

#include <gtest/gtest.h>

#include "tests/core/register/poses.h"

namespace spherule {
namespace {

using poses::expect_maps_near;

// Fibonacci points of the unit sphere, from `phase` on, stretched to an ellipsoid with exact normals.
Surface ellipsoid(Vec3 radii, int count, double phase = 0) {
  Surface surface;
  for (int i = 0; i < count; ++i) {
    const double z = 1 - (2.0 * i + 1) / count, across = std::sqrt(1 - z * z), angle = 2.39996322972865332 * i + phase;
    const Vec3 unit{across * std::cos(angle), across * std::sin(angle), z};
    surface.points.push_back({radii.x * unit.x, radii.y * unit.y, radii.z * unit.z});
    surface.normals.push_back(normalised({unit.x / radii.x, unit.y / radii.y, unit.z / radii.z}));
  }
  surface.tree = detail::PointTree(surface.points);
  surface.spacing_mm = std::sqrt(4 * std::numbers::pi * std::pow(radii.x * radii.y * radii.z, 2.0 / 3) / count);
  return surface;
}

Surface moved(const Surface& surface, const AffineMap& map) {
  Surface result;
  const Mat3 cotangent = transposed(inverse(map.linear));
  for (std::size_t i = 0; i < surface.size(); ++i) {
    result.points.push_back(map(surface.points[i]));
    result.normals.push_back(normalised(cotangent * surface.normals[i]));
  }
  result.tree = detail::PointTree(result.points);
  result.spacing_mm = scale_of(map) * surface.spacing_mm;
  return result;
}

Surface both(const Surface& a, const Surface& b) {
  Surface result = a;
  result.points.insert(result.points.end(), b.points.begin(), b.points.end());
  result.normals.insert(result.normals.end(), b.normals.begin(), b.normals.end());
  result.tree = detail::PointTree(result.points);
  return result;
}

SurfaceFitOptions exactly(TransformKind kind) {
  return {.kind = kind,
          .samples = 100'000,
          .iterations = 60,
          .settled = 1e-9,
          .reach_mm = 1,
          .centre = {},
          .size_mm = 3,
          .min_scale = 0.01,
          .max_scale = 100};
}

// A start some degrees, per cents and tenths of a mm away from the truth.
AffineMap near_to(const AffineMap& truth, phantoms::Random& random, double growth) {
  const AffineMap off{scaled(growth, rotation(poses::within_cube(random, 0.15))), poses::within_cube(random, 0.2)};
  return composed(off, truth);
}

constexpr Vec3 kRadii{1, 1.4, 2};

// The same points on both sides: nothing is left at the truth, and it is found to rounding. (Two ellipsoids: one alone
// lies on itself under many affine maps.)
TEST(FitSurfaces, FindsTheMapOfEveryKind) {
  phantoms::Random random(1);
  const Surface fixed = both(ellipsoid(kRadii, 2000), moved(ellipsoid({0.8, 0.4, 0.6}, 600), {{}, {1.5, 1.2, -1}}));
  for (int t = 0; t < 4; ++t) {
    const AffineMap turn{poses::random_rotation(random), poses::within_cube(random, 30)};
    const AffineMap similar{scaled(0.5 + random.unit(), turn.linear), turn.shift};
    AffineMap affine = similar;
    for (Vec3& row : affine.linear.rows) row = row + poses::within_cube(random, 0.1);
    for (const auto& [kind, truth] : {std::pair{TransformKind::rigid, turn},
                                      {TransformKind::similarity, similar},
                                      {TransformKind::affine, affine}}) {
      const Surface moving = moved(fixed, inverse(truth));
      const AffineMap start = near_to(truth, random, kind == TransformKind::rigid ? 1 : 1.05);
      const AffineMap found = fit_surfaces(fixed, moving, start, exactly(kind));
      expect_maps_near(found, truth, 1e-6, 2);
      if (kind == TransformKind::rigid) {
        EXPECT_NEAR(scale_of(found), 1, 1e-12);
      }
    }
  }
}

// Other points of the same two spheres: along the mean of both normals their distances vanish all the same, so centre
// and scale are those of the spheres, however sparse the points. The turn that nothing tells stays as it was.
TEST(FitSurfaces, OfSpheresKnowsCentreAndScaleAndLeavesTheTurn) {
  const Surface fixed = ellipsoid({2, 2, 2}, 900), small = ellipsoid({0.5, 0.5, 0.5}, 400, 1);
  const Surface moving = moved(small, {{}, {7, 8, 9}});
  const Mat3 turn = rotation(Vec3{0.3, -0.2, 0.5});
  const AffineMap start{scaled(3.8, turn), Vec3{0.1, 0.05, -0.1} - 3.8 * (turn * Vec3{7, 8, 9})};
  const AffineMap found = fit_surfaces(fixed, moving, start, exactly(TransformKind::similarity));
  EXPECT_NEAR(scale_of(found), 4, 1e-6);
  EXPECT_LT(norm(found({7, 8, 9})), 1e-5);
  // Points of another grid pull a little to and fro: by less than their own spacing.
  EXPECT_LT(angle_between(nearest_rotation(found.linear), turn), 3.5);
}

// Other points of an ellipsoid: the error is a small part of the points' spacing.
TEST(FitSurfaces, OtherPointsOfOneSurface) {
  phantoms::Random random(2);
  const Surface fixed = ellipsoid(kRadii, 3000), other = ellipsoid(kRadii, 1000, 2);
  for (int t = 0; t < 4; ++t) {
    const AffineMap truth{scaled(0.7 + random.unit(), poses::random_rotation(random)), poses::within_cube(random, 30)};
    const AffineMap found = fit_surfaces(fixed, moved(other, inverse(truth)), near_to(truth, random, 0.95),
                                         exactly(TransformKind::similarity));
    EXPECT_NEAR(scale_of(found) / scale_of(truth), 1, 1e-3);
    EXPECT_LT(angle_between(nearest_rotation(found.linear), nearest_rotation(truth.linear)), 0.3);
    EXPECT_LT(norm(found(inverse(truth)({}))), 0.03 * other.spacing_mm);
  }
}

// A ball beside the ellipsoid that only one of the two has does not pull.
TEST(FitSurfaces, WhatOnlyOneSurfaceHasDoesNotPull) {
  phantoms::Random random(3);
  const Surface moving = ellipsoid(kRadii, 2500);
  const Surface fixed = both(moving, moved(ellipsoid({0.8, 0.8, 0.8}, 400), {{}, {1.9, 0, 0}}));
  const AffineMap found = fit_surfaces(fixed, moving, near_to({}, random, 1.03), exactly(TransformKind::similarity));
  EXPECT_NEAR(scale_of(found), 1, 5e-3);
  EXPECT_LT(angle_between(nearest_rotation(found.linear), {}), 0.5);
  EXPECT_LT(norm(found.shift), 0.01);
}

TEST(FitSurfaces, KeepsWithinTheBoundsOfTheScale) {
  const Surface fixed = ellipsoid({2, 2, 2}, 900), moving = ellipsoid({1, 1, 1}, 900);
  SurfaceFitOptions options = exactly(TransformKind::similarity);
  options.max_scale = 1.9;
  const AffineMap found = fit_surfaces(fixed, moving, {scaled(1.85, Mat3{}), {}}, options);
  EXPECT_GE(scale_of(found), 1.85 - 1e-9);
  EXPECT_LE(scale_of(found), 1.9);
}

TEST(FitSurfaces, ThreadsChangeNothingAndNothingNearIsLeftAlone) {
  phantoms::Random random(4);
  const Surface fixed = ellipsoid(kRadii, 5000), moving = ellipsoid(kRadii, 4000, 1);
  const AffineMap start = near_to({}, random, 1.05);
  const SurfaceFitOptions options = exactly(TransformKind::similarity);
  const AffineMap one = fit_surfaces(fixed, moving, start, options);
  for (const unsigned threads : {2U, 3U})
    EXPECT_EQ(fit_surfaces(fixed, moving, start, options, {.threads = threads, .cancel = {}, .progress = {}}), one);
  const AffineMap far{{}, {50, 0, 0}};
  EXPECT_EQ(fit_surfaces(fixed, moving, far, options), far);
}

// Spheres about one centre, a tenth of a radius apart.
TEST(SurfaceDistance, OfConcentricSpheresIsKnown) {
  const Surface fixed = ellipsoid({1, 1, 1}, 4000), moving = ellipsoid({1.1, 1.1, 1.1}, 5000, 1);
  const double reach = 0.2, agreement = std::pow(1 - 0.25, 2);
  for (const unsigned threads : {1U, 3U}) {
    const SurfaceDistance d =
        surface_distance(fixed, moving, {}, 100'000, reach, {.threads = threads, .cancel = {}, .progress = {}});
    EXPECT_NEAR(d.mean_mm, 0.1, 1e-3);
    EXPECT_NEAR(d.p95_mm, 0.1, 2e-3);
    EXPECT_EQ(d.fixed_within, 1);
    EXPECT_EQ(d.moving_within, 1);
    EXPECT_NEAR(d.agreement, agreement, 0.01);
    EXPECT_EQ(d.agreement, surface_agreement(fixed, moving, {}, 100'000, reach));
  }
  const SurfaceDistance beyond = surface_distance(fixed, moving, {}, 1000, 0.09);
  EXPECT_EQ(beyond.fixed_within, 0);
  EXPECT_EQ(beyond.agreement, 0);
  EXPECT_EQ(surface_agreement(fixed, moving, {}, 1000, 0.09), 0);
  // The same sphere scaled onto the other.
  EXPECT_NEAR(surface_agreement(fixed, moving, {scaled(1 / 1.1, Mat3{}), {}}, 1000, 0.1), 1, 2e-3);
}

}  // namespace
}  // namespace spherule
