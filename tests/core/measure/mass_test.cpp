// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/mass.h"

#include <gtest/gtest.h>

namespace spherule {
namespace {

// A box with these edges about the origin.
Moments box(double a, double b, double c) {
  const double v = a * b * c;
  return {.volume = v,
          .first = {},
          .second = {{Vec3{v * a * a / 12, 0, 0}, Vec3{0, v * b * b / 12, 0}, Vec3{0, 0, v * c * c / 12}}}};
}

void expect_box(const MassProperties& mass, double a, double b, double c) {  // a > b > c
  const double v = a * b * c;
  EXPECT_NEAR(mass.volume_mm3, v, 1e-12);
  EXPECT_NEAR(mass.principal_moments_mm5[0], v * (b * b + c * c) / 12, 1e-10);
  EXPECT_NEAR(mass.principal_moments_mm5[1], v * (a * a + c * c) / 12, 1e-10);
  EXPECT_NEAR(mass.principal_moments_mm5[2], v * (a * a + b * b) / 12, 1e-10);
  EXPECT_NEAR(determinant(mass.principal_axes), 1, 1e-12);
}

TEST(MassProperties, OfNothing) {
  const MassProperties mass = mass_properties({});
  EXPECT_EQ(mass.volume_mm3, 0);
  EXPECT_EQ(mass.principal_axes, Mat3{});
}

TEST(MassProperties, OfABox) {
  const MassProperties mass = mass_properties(box(5, 3, 2));
  expect_box(mass, 5, 3, 2);
  EXPECT_NEAR(std::abs(mass.principal_axes.rows[0].x), 1, 1e-12) << "least inertia about the longest axis";
  EXPECT_GT(mass.principal_axes.rows[0].x, 0);
}

TEST(MassProperties, OfABoxMovedTurnedAndScaled) {
  const Mat3 turn{{Vec3{0, 0.6, 0.8}, Vec3{-1, 0, 0}, Vec3{0, -0.8, 0.6}}};
  const Moments m = translated(transformed(translated(box(5, 3, 2), {1, 2, 3}), turn, 2), {-10, 0, 7});
  const MassProperties mass = mass_properties(m);
  expect_box(mass, 10, 6, 4);
  const Vec3 expected = 2.0 * (turn * Vec3{1, 2, 3}) + Vec3{-10, 0, 7};
  EXPECT_NEAR(norm(mass.centroid_mm - expected), 0, 1e-12);
  // Rows are the axes: the longest edge lay along x.
  EXPECT_NEAR(std::abs(dot(mass.principal_axes.rows[0], turn.column(0))), 1, 1e-12);
}

TEST(Moments, OfDisjointPartsAdd) {
  Moments two = translated(box(1, 1, 1), {0.5, 0, 0});
  two += translated(box(1, 1, 1), {-0.5, 0, 0});
  const Moments one = box(2, 1, 1);
  EXPECT_NEAR(two.volume, one.volume, 1e-15);
  for (std::size_t i = 0; i < 3; ++i) EXPECT_NEAR(norm(two.second.rows[i] - one.second.rows[i]), 0, 1e-15);
}

}  // namespace
}  // namespace spherule
