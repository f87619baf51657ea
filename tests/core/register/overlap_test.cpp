// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/overlap.h"

#include <gtest/gtest.h>

#include "core/register/rotations.h"
#include "tests/core/register/poses.h"

namespace spherule {
namespace {

SoftBalls random_balls(std::size_t count, std::uint64_t seed) {
  phantoms::Random random(seed);
  SoftBalls balls;
  for (std::size_t i = 0; i < count; ++i)
    balls.push_back({poses::within_cube(random, 2), 0.1 + 0.2 * random.unit(), 0.2 + random.unit()});
  return balls;
}

double value_at(const SoftBalls& fixed, const SoftBalls& moving, const Pose& pose) {
  return overlap(fixed, moving, pose, self_overlap(fixed) * self_overlap(moving)).value;
}

// `pose` after the step whose derivative the gradient is.
Pose stepped(const Pose& pose, int parameter, double by) {
  Pose next = pose;
  if (parameter < 3) {
    Vec3 turn;
    turn[parameter] = by;
    next.rotation = rotation(turn) * pose.rotation;
    next.shift = rotation(turn) * pose.shift;
  } else if (parameter < 6) {
    next.shift[parameter - 3] += by;
  } else {
    next.scale *= std::exp(by);
    next.shift = std::exp(by) * pose.shift;
  }
  return next;
}

TEST(Overlap, IsOneWithItselfAndNoughtApart) {
  const SoftBalls balls = random_balls(20, 1);
  EXPECT_NEAR(value_at(balls, balls, {}), 1, 1e-12);
  EXPECT_EQ(value_at(balls, balls, {.rotation = {}, .scale = 1, .shift = {100, 0, 0}}), 0);
  // A scaled copy, scaled back, is the same again: masses and widths follow the scale.
  SoftBalls twice = balls;
  for (SoftBall& b : twice) b.centre = 2.0 * b.centre, b.sigma *= 2, b.mass *= 8;
  EXPECT_NEAR(value_at(twice, balls, {.rotation = {}, .scale = 2, .shift = {}}), 1, 1e-12);
  EXPECT_LT(value_at(twice, balls, {}), 0.9);
}

TEST(Overlap, GradientIsThatOfTheValue) {
  phantoms::Random random(2);
  for (int t = 0; t < 20; ++t) {
    const SoftBalls fixed = random_balls(10, 100 + t), moving = random_balls(12, 200 + t);
    const Pose pose{poses::random_rotation(random), 0.8 + 0.4 * random.unit(), poses::within_cube(random, 0.5)};
    const OverlapValue v = overlap(fixed, moving, pose, self_overlap(fixed) * self_overlap(moving));
    for (int p = 0; p < 7; ++p) {
      constexpr double h = 1e-5;
      const double slope =
          (value_at(fixed, moving, stepped(pose, p, h)) - value_at(fixed, moving, stepped(pose, p, -h))) / (2 * h);
      EXPECT_NEAR(v.gradient[static_cast<std::size_t>(p)], slope, 1e-7);
    }
  }
}

TEST(Overlap, AllRotationsAtOnceAreTheSameOneByOne) {
  const SoftBalls fixed = random_balls(21, 3), moving = random_balls(17, 4);
  const std::vector<Mat3> rotations = even_rotations(53);
  const std::vector<float> values = overlaps(fixed, moving, rotations);
  for (std::size_t i = 0; i < rotations.size(); ++i)
    EXPECT_NEAR(values[i], value_at(fixed, moving, {rotations[i], 1, {}}), 1e-5);
  EXPECT_EQ(values, overlaps(fixed, moving, rotations, {.threads = 3, .cancel = {}, .progress = {}}));
}

TEST(Overlap, ClimbsBackToTheTruth) {
  phantoms::Random random(5);
  for (int t = 0; t < 20; ++t) {
    const SoftBalls moving = random_balls(25, 300 + t);
    const Pose truth{poses::random_rotation(random), 0.7 + 0.6 * random.unit(), poses::within_cube(random, 1)};
    SoftBalls fixed = moving;
    for (SoftBall& b : fixed) {
      b.centre = truth(b.centre);
      b.sigma *= truth.scale;
    }
    const Pose start{rotation(poses::within_cube(random, 0.1)) * truth.rotation, truth.scale * 1.04,
                     truth.shift + poses::within_cube(random, 0.05)};
    const Climbed top = climb(fixed, moving, start, true, 60);
    EXPECT_GE(top.value, value_at(fixed, moving, start));
    EXPECT_LT(angle_between(top.pose.rotation, truth.rotation), 0.2);
    EXPECT_NEAR(top.pose.scale / truth.scale, 1, 0.005);
    // Without the scale it stays where it was.
    EXPECT_EQ(climb(fixed, moving, start, false, 10).pose.scale, start.scale);
  }
}

}  // namespace
}  // namespace spherule
