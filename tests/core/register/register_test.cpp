// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/register.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "core/register/rotations.h"
#include "tests/core/register/poses.h"

namespace spherule {
namespace {

struct Pair {
  SphereModel fixed, moving;
  AffineMap truth;  // moving to fixed
};

AffineMap random_similarity(phantoms::Random& random) {
  const double scale = 0.7 * std::pow(2.0, random.unit());
  return {scaled(scale, poses::random_rotation(random)), poses::within_cube(random, 40)};
}

// The field on a fine grid, and seen through the inverse of `truth` on one of `n` samples.
Pair made(const phantoms::Field& field, const AffineMap& truth, double reach, std::int32_t fine, std::int32_t coarse) {
  const AffineMap back = inverse(truth);
  return {poses::raw_model(field, {}, reach, fine),
          poses::raw_model(poses::moved(field, back), back({}), scale_of(back) * reach * 1.2, coarse), truth};
}

double degrees_off(const AffineMap& a, const AffineMap& b) {
  return angle_between(nearest_rotation(a.linear), nearest_rotation(b.linear));
}

void expect_right(const AffineMap& found, const Pair& pair, double degrees, double scale, double size) {
  EXPECT_LT(degrees_off(found, pair.truth), degrees);
  EXPECT_NEAR(scale_of(found) / scale_of(pair.truth), 1, scale);
  const Vec3 middle = inverse(pair.truth)({});
  EXPECT_LT(norm(found(middle) - pair.truth(middle)), scale * size);
}

TEST(Register, FindsSimilaritiesOfAnyPose) {
  phantoms::Random random(1);
  for (int t = 0; t < 4; ++t) {
    const bool coarse = t % 2 == 1;
    const Pair pair = made(poses::lopsided(), random_similarity(random), 4.2, 36, coarse ? 20 : 36);
    const Registration r = register_models(pair.fixed, pair.moving);
    expect_right(r.moving_to_fixed, pair, coarse ? 1 : 0.3, coarse ? 0.02 : 0.005, 8);
    EXPECT_FALSE(r.poor);
    EXPECT_TRUE(r.others.empty());
    EXPECT_TRUE(r.warnings.empty());
    EXPECT_GT(r.overlap.dice, coarse ? 0.93 : 0.97);
    EXPECT_FALSE(r.overlap.exact);
    EXPECT_TRUE(r.spheres_overlap.exact);
    EXPECT_GT(r.matched_share, 0.7);
    EXPECT_LT(r.surfaces.mean_mm, 0.2);
  }
}

TEST(Register, TheInverseAgrees) {
  phantoms::Random random(2);
  for (int t = 0; t < 2; ++t) {
    const Pair pair = made(poses::lopsided(), random_similarity(random), 4.2, 36, 26);
    const AffineMap there = register_models(pair.fixed, pair.moving).moving_to_fixed;
    const AffineMap back = register_models(pair.moving, pair.fixed).moving_to_fixed;
    EXPECT_LT(degrees_off(composed(there, back), {}), 0.3);
    EXPECT_NEAR(scale_of(there) * scale_of(back), 1, 0.005);
    EXPECT_LT(norm(there(back({})) - Vec3{}), 0.05);
  }
}

TEST(Register, ThreadsAndRepetitionChangeNothing) {
  phantoms::Random random(3);
  const Pair pair = made(poses::lopsided(), random_similarity(random), 4.2, 30, 30);
  for (const RegistrationMethod method : {RegistrationMethod::global, RegistrationMethod::matching}) {
    const RegistrationOptions options{.method = method, .inits = 12, .seed = 5};
    const Registration one =
        register_models(pair.fixed, pair.moving, options, {.threads = 1, .cancel = {}, .progress = {}});
    for (const unsigned threads : {2U, 5U}) {
      const Registration more =
          register_models(pair.fixed, pair.moving, options, {.threads = threads, .cancel = {}, .progress = {}});
      EXPECT_EQ(one.moving_to_fixed, more.moving_to_fixed);
      EXPECT_EQ(one.overlap.dice, more.overlap.dice);
      EXPECT_EQ(one.surfaces.p95_mm, more.surfaces.p95_mm);
      EXPECT_EQ(one.pairs, more.pairs);
    }
  }
}

TEST(Register, MatchingSpheresIsEnoughForNearTwins) {
  phantoms::Random random(4);
  for (int t = 0; t < 3; ++t) {
    const Pair pair = made(poses::lopsided(), random_similarity(random), 4.2, 36, 36);
    const Registration r =
        register_models(pair.fixed, pair.moving, {.method = RegistrationMethod::matching, .refine = false});
    expect_right(r.moving_to_fixed, pair, 12, 0.1, 8);
    expect_right(register_models(pair.fixed, pair.moving, {.method = RegistrationMethod::matching}).moving_to_fixed,
                 pair, 0.3, 0.005, 8);
    EXPECT_NEAR(r.radius_ratio / scale_of(pair.truth), 1, 0.05);
  }
}

TEST(Register, RigidKeepsLengths) {
  phantoms::Random random(5);
  const AffineMap truth{poses::random_rotation(random), {5, 6, 7}};
  const Pair pair = made(poses::lopsided(), truth, 4.2, 32, 32);
  const Registration r = register_models(pair.fixed, pair.moving, {.transform = TransformKind::rigid});
  EXPECT_NEAR(scale_of(r.moving_to_fixed), 1, 1e-12);
  expect_right(r.moving_to_fixed, pair, 0.4, 0.006, 8);
}

TEST(Register, FindsAffineMapsOfAnyPose) {
  phantoms::Random random(6);
  for (int t = 0; t < 3; ++t) {
    const Mat3 stretch{{Vec3{1.3, 0.1, 0}, Vec3{0.1, 0.9, -0.15}, Vec3{0, -0.15, 0.8}}};
    const AffineMap truth{poses::random_rotation(random) * stretch * poses::random_rotation(random),
                          poses::within_cube(random, 30)};
    const Pair pair = made(poses::lopsided(), truth, 4.2, 36, 36);
    const AffineMap found =
        register_models(pair.fixed, pair.moving, {.transform = TransformKind::affine}).moving_to_fixed;
    // Every point of the object within a few hundredths of a mm (a voxel is a quarter of one).
    for (int s = 0; s < 20; ++s) {
      const Vec3 p = inverse(truth)(poses::within_cube(random, 5));
      EXPECT_LT(norm(found(p) - truth(p)), 0.1);
    }
  }
}

TEST(Register, SpheresWithoutAScanToo) {
  phantoms::Random random(7);
  SphereModel fixed, moving;
  for (int i = 0; i < 12; ++i) fixed.spheres.push_back({poses::within_cube(random, 8), 0.6 + 1.5 * random.unit()});
  const AffineMap truth = random_similarity(random);
  for (const Sphere& s : fixed.spheres)
    moving.spheres.push_back({inverse(truth)(s.centre), s.radius / scale_of(truth)});
  const Registration r = register_models(fixed, moving);
  poses::expect_maps_near(r.moving_to_fixed, truth, 1e-3, 8);
  EXPECT_TRUE(r.overlap.exact);
  EXPECT_GT(r.overlap.dice, 0.998);
  ASSERT_EQ(r.pairs.size(), 12U);
  for (const SpherePair& p : r.pairs) EXPECT_EQ(p.moving, p.fixed);
  EXPECT_NEAR(r.matched_share, 1, 1e-12);
  EXPECT_LT(r.residual_rms_mm, 0.01);
}

// A cube lies on itself in 24 ways, and all of them come back.
TEST(Register, ACubeHasTwentyFourPoses) {
  phantoms::Random random(8);
  const Pair pair = made(phantoms::cube({}, 3), random_similarity(random), 5.5, 30, 30);
  const Registration r = register_models(pair.fixed, pair.moving);
  EXPECT_EQ(r.others.size(), 23U);
  ASSERT_FALSE(r.warnings.empty());
  std::vector<AffineMap> found{r.moving_to_fixed};
  for (const FoundPose& other : r.others) found.push_back(other.moving_to_fixed);
  std::size_t seen = 0;
  for (const Vec3 x : {Vec3{1, 0, 0}, Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, -1, 0}, Vec3{0, 0, 1}, Vec3{0, 0, -1}}) {
    for (const Vec3 y : {Vec3{1, 0, 0}, Vec3{-1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, -1, 0}, Vec3{0, 0, 1}, Vec3{0, 0, -1}}) {
      if (dot(x, y) != 0) continue;
      const AffineMap truth{Mat3{{x, y, cross(x, y)}} * pair.truth.linear, {}};
      seen += std::ranges::any_of(found, [&](const AffineMap& f) { return degrees_off(f, truth) < 1; });
    }
  }
  EXPECT_EQ(seen, 24U);
}

TEST(Register, ACylinderTurnsAboutItsAxis) {
  phantoms::Random random(9);
  const Pair pair = made(phantoms::capped_cylinder({}, 1.5, 3.5), random_similarity(random), 5.5, 32, 32);
  const Registration r = register_models(pair.fixed, pair.moving);
  EXPECT_GE(r.others.size(), 6U);
  bool up = false, down = false;
  for (const FoundPose& other : r.others) {
    const double along = nearest_rotation(other.moving_to_fixed.linear * inverse(pair.truth.linear)).rows[2].z;
    EXPECT_GT(std::abs(along), 0.999);  // of the cosine between the axes
    (along > 0 ? up : down) = true;
  }
  EXPECT_TRUE(up && down);
}

TEST(Register, ABallTurnsAnyWay) {
  phantoms::Random random(10);
  const Pair pair = made(phantoms::ball({}, 3), random_similarity(random), 4.5, 28, 28);
  const Registration r = register_models(pair.fixed, pair.moving, {.inits = 16});
  EXPECT_EQ(r.others.size(), 15U);
  EXPECT_NEAR(scale_of(r.moving_to_fixed) / scale_of(pair.truth), 1, 0.002);
  EXPECT_LT(norm(r.moving_to_fixed(inverse(pair.truth)({}))), 0.01);
}

TEST(Register, DifferentObjectsArePoorMatches) {
  const SphereModel lopsided = poses::raw_model(poses::lopsided(), {}, 4.2, 30);
  const SphereModel torus = poses::raw_model(phantoms::torus({}, 3, 1), {}, 5, 30);
  const SphereModel cube = poses::raw_model(phantoms::cube({}, 3), {}, 5, 30);
  for (const auto& [a, b] : {std::pair{&lopsided, &torus}, {&torus, &cube}, {&cube, &lopsided}}) {
    const Registration r = register_models(*a, *b, {.inits = 8});
    EXPECT_TRUE(r.poor);
    EXPECT_FALSE(r.warnings.empty());
  }
}

TEST(Register, ScalesOutOfBoundsAreTold) {
  phantoms::Random random(11);
  const Pair pair = made(poses::lopsided(), {scaled(2, poses::random_rotation(random)), {}}, 4.2, 28, 28);
  const Registration r = register_models(pair.fixed, pair.moving, {.min_scale = 0.5, .max_scale = 1.5});
  EXPECT_LE(scale_of(r.moving_to_fixed), 1.5 * (1 + 1e-9));
  EXPECT_TRUE(std::ranges::any_of(r.warnings, [](const std::string& w) { return w.find("bound") != w.npos; }));
}

TEST(Register, BadOptionsAndModelsAreRefused) {
  const SphereModel ball{.spheres = {{{0, 0, 0}, 1}}, .solid = {}};
  const auto refused = [&](const RegistrationOptions& options, const std::string& field) {
    try {
      register_models(ball, ball, options);
      ADD_FAILURE() << field;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      ASSERT_EQ(error.fields().size(), 1U);
      EXPECT_EQ(error.fields()[0].pointer, field);
    }
  };
  refused({.k = 3}, "/k");
  refused({.k = 513}, "/k");
  refused({.inits = 0}, "/inits");
  refused({.min_scale = 2, .max_scale = 1}, "/scale_bounds");
  refused({.min_scale = std::numeric_limits<double>::quiet_NaN()}, "/scale_bounds");
  refused({.weights = {.position = -1}}, "/weights");
  EXPECT_THROW(register_models(ball, {}), Error);
  EXPECT_THROW(register_models({}, ball), Error);
  // The smallest model there is still works.
  const Registration r = register_models(ball, ball);
  EXPECT_NEAR(scale_of(r.moving_to_fixed), 1, 1e-4);
  EXPECT_NEAR(r.overlap.dice, 1, 1e-3);
}

TEST(Register, StopsWhenAsked) {
  const SphereModel model = poses::raw_model(poses::lopsided(), {}, 4.2, 24);
  std::stop_source stop;
  const Context context{.threads = 1, .cancel = stop.get_token(), .progress = [&](std::string_view, double fraction) {
                          if (fraction >= 0.3) stop.request_stop();
                        }};
  try {
    register_models(model, model, {}, context);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::cancelled);
  }
}

TEST(Overlaps, OfTwoBallsAreKnown) {
  // Two unit balls one radius apart: the lens has 5/16 of a ball's volume.
  SphereModel a, b;
  a.spheres = {{{0, 0, 0}, 1}};
  b.spheres = {{{5, 0, 0}, 0.5}};
  const AffineMap map{scaled(2, Mat3{}), {-9, 0, 0}};
  const double lens = 5.0 / 16;
  const UnionOverlap exact = exact_overlap(a.spheres, b.spheres, map);
  EXPECT_NEAR(exact.dice, lens, 1e-12);
  EXPECT_NEAR(exact.iou, lens / (2 - lens), 1e-12);
  const UnionOverlap sampled = sampled_overlap(a, b, map);
  EXPECT_NEAR(sampled.dice, exact.dice, 0.002);
  EXPECT_NEAR(sampled.iou, exact.iou, 0.002);
  EXPECT_EQ(sampled_overlap(a, b, {{}, {100, 0, 0}}).dice, 0);
  EXPECT_EQ(exact_overlap(a.spheres, b.spheres, {{}, {100, 0, 0}}).iou, 0);
}

}  // namespace
}  // namespace spherule
