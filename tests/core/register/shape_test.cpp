// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/shape.h"

#include <gtest/gtest.h>

#include <numbers>
#include <numeric>

#include "core/measure/union.h"
#include "tests/core/register/poses.h"

namespace spherule {
namespace {

TEST(Shape, OfABallIsKnown) {
  const Vec3 centre{3, -2, 1};
  const SphereModel raw = poses::raw_model(phantoms::ball(centre, 5), centre, 6.5, 32);
  SphereModel ball;
  ball.spheres = {{centre, 5}};
  for (const SphereModel* model : std::initializer_list<const SphereModel*>{&raw, &ball}) {
    const Shape shape = shape_of(*model, 16);
    const double voxel = 13.0 / 31;
    EXPECT_NEAR(shape.volume_mm3, 4 * std::numbers::pi / 3 * 125, 0.01 * shape.volume_mm3);
    EXPECT_NEAR(norm(shape.centroid - centre), 0, 0.01);
    // Of the solid ball: a fifth of the squared radius along every axis.
    for (int a = 0; a < 3; ++a) EXPECT_NEAR(shape.covariance.rows[static_cast<std::size_t>(a)][a], 5, 0.1);
    EXPECT_GT(shape.surface.size(), 1000U);
    for (std::size_t i = 0; i < shape.surface.size(); ++i) {
      const Vec3 out = shape.surface.points[i] - centre;
      EXPECT_NEAR(norm(out), 5, 0.1 * voxel);
      EXPECT_GT(dot(shape.surface.normals[i], normalised(out)), 0.99);
    }
  }
}

TEST(Shape, MassesAreTheVolume) {
  for (const bool raw : {true, false}) {
    SphereModel model = poses::raw_model(poses::lopsided(), {}, 4, 28);
    if (!raw) model.solid.reset(), model.spheres.resize(300);
    const Shape shape = shape_of(model, 50);
    EXPECT_EQ(shape.spheres.size(), 50U);
    EXPECT_NEAR(std::accumulate(shape.masses.begin(), shape.masses.end(), 0.0), shape.volume_mm3,
                1e-9 * shape.volume_mm3);
  }
}

TEST(Shape, SurfaceOfSpheresIsOnTheirUnion) {
  SphereModel model;
  model.spheres = {{{0, 0, 0}, 2}, {{2, 0, 0}, 1.5}, {{0, 0.5, 0}, 1}};  // the last one is hidden
  const Shape shape = shape_of(model, 64, 5000);
  const double area = measure_union(model.spheres).area_mm2;
  EXPECT_NEAR(static_cast<double>(shape.surface.size()), 5000, 150);
  EXPECT_NEAR(shape.surface.spacing_mm * shape.surface.spacing_mm * 5000, area, 1e-9 * area);
  for (const Vec3 p : shape.surface.points) {
    EXPECT_GE(norm(p - model.spheres[0].centre), 2 - 1e-6);
    EXPECT_GE(norm(p - model.spheres[1].centre), 1.5 - 1e-6);
  }
}

TEST(Shape, NothingIsRefused) {
  SphereModel points;
  for (const int count : {0, 1, 5}) {
    points.spheres.assign(static_cast<std::size_t>(count), {{1, 2, 3}, 0});
    try {
      shape_of(points, 16);
      ADD_FAILURE();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::unusable);
    }
  }
}

TEST(PointTree, FindsTheNearest) {
  phantoms::Random random(1);
  for (const std::size_t count : {1U, 7U, 8U, 9U, 1000U}) {
    std::vector<Vec3> points;
    // On a lattice: many equal distances and coordinates.
    for (std::size_t i = 0; i < count; ++i)
      points.push_back({double(random.below(8)), double(random.below(8)), double(random.below(8))});
    const detail::PointTree tree(points);
    for (int t = 0; t < 200; ++t) {
      const Vec3 p = Vec3{4, 4, 4} + poses::within_cube(random, 12);
      double least = 1e300;
      for (const Vec3 q : points) least = std::min(least, squared_norm(q - p));
      const auto near = tree.nearest(p);
      EXPECT_EQ(near.squared, least);
      EXPECT_EQ(squared_norm(points[near.index] - p), least);
      EXPECT_EQ(tree.nearest(p, least).index, detail::PointTree::none);
      EXPECT_EQ(tree.nearest(p, least * 1.0001 + 1e-9).squared, least);
    }
  }
  EXPECT_EQ(detail::PointTree({}).nearest({}).index, detail::PointTree::none);
}

}  // namespace
}  // namespace spherule
