// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/transform.h"

#include <gtest/gtest.h>

#include "core/register/rotations.h"
#include "tests/core/register/poses.h"

namespace spherule {
namespace {

using poses::expect_maps_near;

TEST(Transform, InverseUndoes) {
  phantoms::Random random(1);
  for (int t = 0; t < 50; ++t) {
    AffineMap map{poses::random_rotation(random), poses::within_cube(random, 100)};
    for (Vec3& row : map.linear.rows) row = row + poses::within_cube(random, 0.5);
    expect_maps_near(composed(inverse(map), map), {}, 1e-11, 10);
    expect_maps_near(composed(map, inverse(map)), {}, 1e-11, 10);
  }
}

TEST(Transform, PartsOfKnownTurns) {
  const Decomposition quarter = decompose({rotation(Vec3{0, 0, std::numbers::pi / 2}), {1, 2, 3}}, {});
  EXPECT_NEAR(quarter.angle_deg, 90, 1e-12);
  EXPECT_NEAR(norm(quarter.axis - Vec3{0, 0, 1}), 0, 1e-12);
  EXPECT_NEAR(norm(quarter.euler_xyz_deg - Vec3{0, 0, 90}), 0, 1e-12);
  EXPECT_NEAR(norm(quarter.scales - Vec3{1, 1, 1}), 0, 1e-12);
  EXPECT_EQ(quarter.translation, (Vec3{1, 2, 3}));
  // A half turn, where w is 0.
  const Decomposition half = decompose({rotation(Vec3{std::numbers::pi, 0, 0}), {}}, {});
  EXPECT_NEAR(half.angle_deg, 180, 1e-10);
  EXPECT_NEAR(std::abs(half.axis.x), 1, 1e-12);
  EXPECT_EQ(decompose({}, {5, 5, 5}).angle_deg, 0);
}

TEST(Transform, PartsMakeTheWhole) {
  phantoms::Random random(2);
  for (int t = 0; t < 200; ++t) {
    AffineMap map{scaled(0.3 + random.unit(), poses::random_rotation(random)), poses::within_cube(random, 100)};
    if (t % 2 == 0)
      for (Vec3& row : map.linear.rows) row = row + poses::within_cube(random, 0.1);
    const Decomposition parts = decompose(map, poses::within_cube(random, 50));
    expect_maps_near(composed(parts), map, 1e-12, 10);
    EXPECT_NEAR(norm(parts.centre + parts.translation - map(parts.centre)), 0, 1e-11);
    if (t % 2 == 1) {
      EXPECT_NEAR(norm(parts.shear), 0, 1e-12);
      EXPECT_NEAR(parts.scales.x, parts.scales.y, 1e-12);
      EXPECT_NEAR(parts.scales.x, parts.scales.z, 1e-12);
    }
    // Euler angles in the named order are the rotation.
    const double rad = std::numbers::pi / 180;
    const Mat3 euler =
        rotation(Vec3{0, 0, rad * parts.euler_xyz_deg.z}) *
        (rotation(Vec3{0, rad * parts.euler_xyz_deg.y, 0}) * rotation(Vec3{rad * parts.euler_xyz_deg.x, 0, 0}));
    EXPECT_LT(angle_between(euler, parts.rotation), 1e-5);
    EXPECT_LT(angle_between(rotation(parts.quaternion), parts.rotation), 1e-5);
  }
  // Where two of the axes fall together.
  for (const double sign : {-1.0, 1.0}) {
    const Mat3 locked = rotation(Vec3{0, sign * std::numbers::pi / 2, 0}) * rotation(Vec3{0.3, 0, 0});
    const Decomposition parts = decompose({locked, {}}, {});
    const double rad = std::numbers::pi / 180;
    EXPECT_LT(angle_between(
                  rotation(Vec3{0, 0, rad * parts.euler_xyz_deg.z}) * rotation(Vec3{0, rad * parts.euler_xyz_deg.y, 0}),
                  locked),
              1e-5);
  }
}

TEST(Transform, NearestRotation) {
  phantoms::Random random(3);
  for (int t = 0; t < 50; ++t) {
    const Mat3 turn = poses::random_rotation(random);
    EXPECT_LT(angle_between(nearest_rotation(scaled(2, turn)), turn), 1e-5);
    // Times a symmetric positive matrix it is still the nearest.
    EXPECT_LT(
        angle_between(nearest_rotation(turn * Mat3{{Vec3{2, 0.3, 0.1}, Vec3{0.3, 1, 0.2}, Vec3{0.1, 0.2, 3}}}), turn),
        1e-5);
  }
}

TEST(Rotations, AreEvenlySpread) {
  const std::vector<Mat3> all = even_rotations(4608);
  phantoms::Random random(4);
  double farthest = 0;
  for (int t = 0; t < 400; ++t) {
    const Mat3 turn = poses::random_rotation(random);
    double nearest = 180;
    for (const Mat3& r : all) nearest = std::min(nearest, angle_between(r, turn));
    farthest = std::max(farthest, nearest);
  }
  EXPECT_LT(farthest, 14.5);
  for (const std::uint64_t seed : {0U, 1U, 99U})
    for (const Mat3& r : even_rotations(100, seed)) EXPECT_NEAR(determinant(r), 1, 1e-12);
  EXPECT_EQ(even_rotations(10, 5), even_rotations(10, 5));
  EXPECT_NE(even_rotations(10, 5), even_rotations(10, 6));
}

}  // namespace
}  // namespace spherule
