// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/blob_balls.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <stop_token>

#include "core/base/error.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

std::vector<Sphere> balls_in(double side, std::size_t count, double least, double most) {
  phantoms::Random random(count);
  std::vector<Sphere> balls;
  for (std::size_t i = 0; i < count; ++i) {
    const Vec3 centre{side * random.unit(), side * random.unit(), side * random.unit()};
    balls.push_back({centre, least + (most - least) * random.unit()});
  }
  return balls;
}

bool holds(const Sphere& large, const Sphere& small, double slack) {
  const double room = large.radius + slack - small.radius;
  return room >= 0 && squared_norm(large.centre - small.centre) <= room * room;
}

TEST(BlendingBalls, AreThoseThatNoneTakenBeforeHolds) {
  for (const double side : {0.01, 1.0, 4.0, 40.0}) {
    for (const double slack : {0.0, 0.1, 1.0}) {
      std::vector<Sphere> balls = balls_in(side, 700, 0, 3);
      balls.push_back({{1, 1, 1}, 0});
      balls.insert(balls.end(), 20, {{0.5, 0.5, 0.5}, 2});
      const std::vector<std::uint32_t> blending = blending_balls(balls, slack, {});
      std::vector<char> taken(balls.size());
      for (auto next = blending.begin(); next != blending.end(); ++next) {
        const Sphere& ball = balls[*next];
        ASSERT_GT(ball.radius, 0);
        taken[*next] = 1;
        for (auto before = blending.begin(); before != next; ++before) {
          ASSERT_FALSE(holds(balls[*before], ball, slack));
          ASSERT_LE(ball.radius, 1.125 * balls[*before].radius);
        }
      }
      for (std::size_t i = 0; i < balls.size(); ++i) {
        ASSERT_TRUE(taken[i] || balls[i].radius == 0 ||
                    std::ranges::any_of(blending, [&](auto j) { return holds(balls[j], balls[i], slack); }));
      }
    }
  }
}

TEST(BlendingBalls, AreOneOfManyInOnePlace) {
  EXPECT_EQ(blending_balls(balls_in(1e-9, 2000, 1, 1), 1e-6, {}).size(), 1U);
  EXPECT_EQ(blending_balls(std::vector<Sphere>(2000, {{1, 2, 3}, 4}), 0, {}), std::vector<std::uint32_t>{0});
}

// All touch one sphere from inside, as those of a round object do.
TEST(BlendingBalls, OfARoundObjectAreFew) {
  std::vector<Sphere> balls = balls_in(1, 2000, 5, 9.9);
  for (Sphere& s : balls) {
    const Vec3 out = s.centre - Vec3{0.5, 0.5, 0.5};
    s.centre = (10 - s.radius) / norm(out) * out;
  }
  balls.push_back({{0, 0, 0}, 10});
  EXPECT_EQ(blending_balls(balls, 1e-9, {}), std::vector<std::uint32_t>{2000});
}

TEST(BlendingBalls, OfNothingAreNone) {
  EXPECT_TRUE(blending_balls({}, 1, {}).empty());
  EXPECT_TRUE(blending_balls(std::vector<Sphere>(3, {{0, 0, 0}, 0}), 1, {}).empty());
}

TEST(BlendingBalls, AreTheSameAtAllSizes) {
  for (const double scale : {0x1p-400, 0x1p-100, 0x1p100, 0x1p400}) {
    std::vector<Sphere> balls = balls_in(4, 100, 0.5, 2);
    for (Sphere& s : balls) s = {scale * s.centre, scale * s.radius};
    EXPECT_EQ(blending_balls(balls, 0, {}), blending_balls(balls_in(4, 100, 0.5, 2), 0, {})) << scale;
  }
}

TEST(BlendingBalls, HearACancel) {
  std::stop_source stop;
  stop.request_stop();
  const Context cancelled{.threads = 1, .cancel = stop.get_token(), .progress = {}};
  EXPECT_THROW(blending_balls(balls_in(1, 40'000, 1, 1), 0, cancelled), Error);
}

}  // namespace
}  // namespace spherule
