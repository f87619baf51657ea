// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/best.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <numbers>

#include "core/measure/union.h"
#include "core/read/read.h"
#include "core/simplify/cover.h"
#include "core/simplify/fit.h"
#include "core/simplify/together.h"
#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

using Mode = BestOptions::Mode;

struct Case {
  SphereModel model;
  SampledObject object;
};
Case made(const Volume& volume, const ObjectRule& rule) {
  return {build_model(volume, rule).model, {volume.grid, classify_samples(volume, rule).inside, rule.border}};
}
Case made(const phantoms::Field& field, std::int32_t n) {
  return made(phantoms::sample(field, phantoms::cubic_grid(n, 4)), phantoms::threshold(0));
}

double iou(std::span<const Sphere> balls, const SampledObject& object) { return measure_overlap(balls, object).iou(); }

std::vector<Sphere> best(const Case& c, std::uint32_t k, Mode mode = Mode::best) {
  const BestSpheres result = best_spheres(c.model, c.object, {.mode = mode, .k = k, .iou = {}});
  EXPECT_TRUE(is_valid(result.simplification, c.model.spheres.size()));
  return spheres_at(result.simplification, k);
}

TEST(Cover, IsTheGreedyOrderWithinItsBoundOfTheBestChoice) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    const SphereModel candidates = sets::random_balls(14, 3.5, 0.3, 1.2, seed);
    SampledObject object = sample_union(candidates.spheres, 4000);
    for (std::size_t k = 1; k <= 3; ++k) {
      const detail::Cover cover = detail::greedy_cover(candidates.spheres, object, k, {});
      ASSERT_EQ(cover.order.size(), k);
      std::vector<Sphere> chosen;
      for (std::size_t i = 0; i < k; ++i) {
        // The slow greedy step: try them all.
        std::uint64_t most = 0;
        std::uint32_t which = 0;
        for (std::uint32_t c = 0; c < 14; ++c) {
          chosen.push_back(candidates.spheres[c]);
          const std::uint64_t covered = measure_overlap(chosen, object).covered;
          if (covered > most) most = covered, which = c;
          chosen.pop_back();
        }
        chosen.push_back(candidates.spheres[which]);
        EXPECT_EQ(cover.order[i], which);
        EXPECT_EQ(cover.covered[i], most);
      }
      // The optimum by brute force.
      std::uint64_t optimum = 0;
      for (std::size_t a = 0; a < 14; ++a) {
        for (std::size_t b = k > 1 ? a + 1 : a; b < (k > 1 ? 14 : a + 1); ++b) {
          for (std::size_t c = k > 2 ? b + 1 : b; c < (k > 2 ? 14 : b + 1); ++c) {
            const std::vector<Sphere> set{candidates.spheres[a], candidates.spheres[b], candidates.spheres[c]};
            optimum = std::max(optimum, measure_overlap(set, object).covered);
          }
        }
      }
      EXPECT_LE(optimum, cover.bound);
      EXPECT_GE(static_cast<double>(cover.covered.back()), (1 - 1 / std::numbers::e) * static_cast<double>(optimum));
    }
  }
}

TEST(Cover, PolesAreTheLargestInsideBallsOfThePoints) {
  const SphereModel model = sets::raw_model(sets::dumbbell(), 12);
  const std::vector<Sphere> poles = detail::poles(model);
  const Solid& solid = *model.solid;
  for (std::uint32_t v = 0; v < solid.boundary.points.size(); ++v) {
    double largest = 0;
    for (std::size_t c = 0; c < solid.inside_count; ++c) {
      if (std::ranges::find(solid.cells[c], v) != solid.cells[c].end())
        largest = std::max(largest, model.spheres[c].radius);
    }
    EXPECT_TRUE(std::ranges::any_of(poles, [&](const Sphere& p) { return p.radius == largest; }));
  }
  EXPECT_LT(poles.size(), model.spheres.size());
}

TEST(Fit, GainIsTheChangeOfTheScore) {
  for (const Border border : {Border::closed, Border::open}) {
    const Case c = made(sets::dumbbell(), 14);
    const SampledObject object{c.object.grid, c.object.inside, border};
    const auto score = [&](const std::vector<Sphere>& local) {
      std::vector<Sphere> balls;
      for (const Sphere& b : local) balls.push_back({object.grid.to_patient(b.centre), b.radius});
      const Overlap o = measure_overlap(balls, object);
      return static_cast<std::int64_t>(o.covered) - static_cast<std::int64_t>(o.spilled);
    };
    detail::Fit fit(object);
    std::vector<Sphere> laid;
    phantoms::Random random(3);
    for (int step = 0; step < 60; ++step) {
      if (laid.size() > 4) {
        const std::size_t i = random.below(laid.size());
        fit.remove(laid[i]);
        laid.erase(laid.begin() + static_cast<std::ptrdiff_t>(i));
      }
      const Sphere ball{{4 * random.unit(), 4 * random.unit(), 4 * random.unit()}, 1.2 * random.unit()};
      const std::int64_t before = score(laid), gain = fit.gain(ball);
      laid.push_back(ball);
      EXPECT_EQ(gain, score(laid) - before);
      fit.add(ball);
    }
  }
}

TEST(Together, MovesBallsOntoTheObject) {
  const std::array two{Sphere{{-1.1, 0.1, -0.2}, 0.9}, Sphere{{0.9, -0.1, 0.3}, 1.2}};
  const Case c = made(
      phantoms::either(phantoms::ball(two[0].centre, two[0].radius), phantoms::ball(two[1].centre, two[1].radius)), 40);
  std::vector<Sphere> start;
  for (const Sphere& ball : two) {
    start.push_back(detail::to_grid(c.object.grid, Sphere{ball.centre + Vec3{0.2, -0.1, 0.15}, 0.8 * ball.radius}));
  }
  const auto moved = detail::moved_together(start, c.object, 100, {});
  for (std::size_t i = 0; i < two.size(); ++i) {
    EXPECT_LT(norm(c.object.grid.to_patient(moved[i].centre) - two[i].centre), 0.02);
    EXPECT_NEAR(moved[i].radius, two[i].radius, 0.02);
  }
  EXPECT_EQ(detail::moved_together(start, c.object, 100, {.threads = 3, .cancel = {}, .progress = {}}), moved);
}

// A ball smaller than its soft shell, with a sample at its very centre.
TEST(Together, BallsOfASampleStayFinite) {
  const Case c = made(phantoms::ball({0, 0, 0}, 1), 12);
  const Vec3 step = c.object.grid.spacing;
  const Sphere small{{6 * step.x, 6 * step.y, 6 * step.z}, 0.5 * step.x};
  for (const Sphere& ball : detail::moved_together({small, small}, c.object, 5, {})) {
    EXPECT_TRUE(std::isfinite(ball.centre.x + ball.centre.y + ball.centre.z + ball.radius));
  }
}

TEST(Best, OneBallIsAsGoodAsAnyByBruteForce) {
  for (const phantoms::Field& field : {phantoms::cube({0.07, -0.03, 0.02}, 1.3), phantoms::torus({0, 0, 0}, 1.1, 0.55),
                                       phantoms::capped_cylinder({0.05, 0, 0}, 0.8, 1.4), sets::dumbbell()}) {
    const Case c = made(field, 12);
    // Of all samples, the part in which ball and object differ.
    const auto differ = [&](const Sphere& ball) {
      const Overlap o = measure_overlap(std::span(&ball, 1), c.object);
      return static_cast<double>(o.inside - o.covered + o.spilled) / static_cast<double>(o.inside);
    };
    double optimum = 1;
    for (int n = 0; n < 17 * 17 * 17; ++n) {
      const Vec3 centre{0.25 * (n % 17 - 8), 0.25 * (n / 17 % 17 - 8), 0.25 * (n / 289 - 8)};
      for (double radius = 0.3; radius < 2.2; radius += 0.1) optimum = std::min(optimum, differ({centre, radius}));
    }
    EXPECT_LE(differ(best(c, 1)[0]), optimum + 0.03);
  }
}

TEST(Best, TwoAndThreeBallsAreAsGoodAsAnyOnACoarseGridOfChoices) {
  const Case c = made(sets::dumbbell(), 12);
  std::vector<Sphere> choices;
  for (int n = 0; n < 9 * 2 * 2; ++n) {
    for (const double radius : {0.3, 0.5, 0.65, 0.8}) {
      choices.push_back({{0.45 * (n % 9 - 4), 0.2 * (n / 9 % 2), 0.2 * (n / 18)}, radius});
    }
  }
  std::vector<double> optimum(4, 0);
  for (std::size_t a = 0; a < choices.size(); ++a) {
    for (std::size_t b = a + 1; b < choices.size(); ++b) {
      const std::vector<Sphere> two{choices[a], choices[b]};
      optimum[2] = std::max(optimum[2], iou(two, c.object));
      for (std::size_t d = b + 1; d < choices.size(); d += 7) {
        const std::vector<Sphere> three{choices[a], choices[b], choices[d]};
        optimum[3] = std::max(optimum[3], iou(three, c.object));
      }
    }
  }
  EXPECT_GE(iou(best(c, 2), c.object), optimum[2]);
  EXPECT_GE(iou(best(c, 3), c.object), optimum[3]);
}

TEST(Best, ABallTakesOneBallAndItsVolume) {
  const Case c = made(phantoms::ball({0.013, -0.021, 0.009}, 1.5), 40);
  const std::vector<Sphere> one = best(c, 1);
  EXPECT_LT(norm(one[0].centre - Vec3{0.013, -0.021, 0.009}), 0.02);
  EXPECT_NEAR(one[0].radius, 1.5, 0.01);
  EXPECT_GT(iou(one, c.object), 0.98);
}

TEST(Best, TheUnionHasTheVolumeOfTheSamples) {
  const Case c = made(sets::dumbbell(), 32);
  const double wanted = static_cast<double>(c.object.inside.count()) * c.object.sample_mm3();
  for (const std::uint32_t k : {8U, 32U}) {
    EXPECT_NEAR(measure_union(best(c, k)).moments.volume, wanted, 1e-8 * wanted);
  }
}

TEST(Best, MoreBallsOverlapMoreAndEveryLevelIsThere) {
  const Case c = made(phantoms::torus({0.01, 0.02, 0.03}, 1.3, 0.4), 40);
  const BestSpheres result = best_spheres(c.model, c.object, {.k = 100, .iou = {}});
  ASSERT_TRUE(is_valid(result.simplification, c.model.spheres.size()));
  EXPECT_EQ(result.simplification.members.size(), c.model.spheres.size()) << "every sphere is a member";
  EXPECT_FALSE(result.optimality_gap);
  double before = 0;
  for (std::uint32_t k = 1; k <= 100; ++k) {
    EXPECT_EQ(shown_at(result.simplification, k).size(), k);
    const double now = iou(spheres_at(result.simplification, k), c.object);
    EXPECT_GT(now, before - 0.02) << k;
    before = std::max(before, now);
  }
  EXPECT_GT(before, 0.97);
  const std::vector<std::uint32_t> levels{1, 8, 64};
  for (const TreeLevel& level : tree_of(result.simplification, levels)) {
    if (level.spheres.size() == 1) continue;
    EXPECT_TRUE(std::ranges::none_of(level.parents, [](std::uint32_t p) { return p == no_parent; }));
  }
}

TEST(Best, InnerNeverSpillsAndOuterCoversAll) {
  const double c = std::cos(0.3), s = std::sin(0.3);
  const Grid oblique = grid_from_affine(
      {40, 30, 20}, {{Vec3{0.1 * c, -0.14 * s, 0}, Vec3{0.1 * s, 0.14 * c, 0}, Vec3{0, 0, 0.2}}}, {-1.2, -2.5, -2});
  for (const Border border : {Border::closed, Border::open}) {
    const Case made_case = made(phantoms::sample(sets::dumbbell(), oblique), phantoms::threshold(0, border));
    const BestSpheres inner =
        best_spheres(made_case.model, made_case.object, {.mode = Mode::inner, .k = 40, .iou = {}});
    const BestSpheres outer =
        best_spheres(made_case.model, made_case.object, {.mode = Mode::outer, .k = 40, .iou = {}});
    ASSERT_TRUE(is_valid(inner.simplification, made_case.model.spheres.size()));
    ASSERT_TRUE(is_valid(outer.simplification, made_case.model.spheres.size()));
    for (const std::uint32_t k : {1U, 2U, 3U, 7U, 16U, 23U, 40U}) {
      const std::vector<Sphere> in = spheres_at(inner.simplification, k), out = spheres_at(outer.simplification, k);
      EXPECT_TRUE(never_spills(in, made_case.object));
      EXPECT_EQ(measure_overlap(in, made_case.object).spilled, 0U);
      EXPECT_TRUE(covers_all(out, made_case.object)) << k;
      const Overlap overlap = measure_overlap(out, made_case.object);
      EXPECT_EQ(overlap.covered, overlap.inside);
    }
    EXPECT_GE(*inner.optimality_gap, 0);
    EXPECT_LT(*inner.optimality_gap, 0.3);
    EXPECT_GT(iou(spheres_at(inner.simplification, 40), made_case.object), 0.8);
    EXPECT_GT(iou(spheres_at(outer.simplification, 40), made_case.object), 0.6);
  }
}

TEST(Best, ReachesTheOverlapAskedForWithFewSpheres) {
  const Case c = made(sets::dumbbell(), 24);
  for (const Mode mode : {Mode::inner, Mode::best}) {
    const BestSpheres result = best_spheres(c.model, c.object, {.mode = mode, .k = {}, .iou = 0.9});
    ASSERT_TRUE(is_valid(result.simplification, c.model.spheres.size()));
    const std::uint32_t k = result.simplification.last_level();
    EXPECT_GE(iou(spheres_at(result.simplification, k), c.object), 0.9);
    EXPECT_LT(iou(spheres_at(result.simplification, k * 3 / 4), c.object), 0.9) << k;
  }
  try {
    best_spheres(c.model, c.object, {.mode = Mode::outer, .k = {}, .iou = 1});
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unusable);
    EXPECT_TRUE(std::string(error.what()).ends_with("."));
  }
}

TEST(Best, IsTheSameOnAnyNumberOfThreads) {
  const Case c = made(sets::dumbbell(), 24);
  for (const Mode mode : {Mode::inner, Mode::best, Mode::outer}) {
    std::vector<double> progress;
    Context context{.threads = 1, .cancel = {}, .progress = [&](std::string_view, double p) { progress.push_back(p); }};
    const BestSpheres one = best_spheres(c.model, c.object, {.mode = mode, .k = 50, .iou = {}}, context);
    EXPECT_TRUE(std::ranges::is_sorted(progress));
    EXPECT_EQ(progress.back(), 1);
    for (const unsigned threads : {2U, 5U}) {
      const Context many{.threads = threads, .cancel = {}, .progress = {}};
      const BestSpheres other = best_spheres(c.model, c.object, {.mode = mode, .k = 50, .iou = {}}, many);
      EXPECT_EQ(other.simplification, one.simplification);
    }
  }
}

TEST(Best, ImportedBallsAreSimplifiedToo) {
  Case c{sets::random_balls(400, 3, 0.2, 0.6, 11), {}};
  c.object = sample_union(c.model.spheres, 60000);
  EXPECT_GT(iou(best(c, 60), c.object), 0.85);
  EXPECT_TRUE(covers_all(best(c, 20, Mode::outer), c.object));
  // All of them, when as many are wanted.
  const std::vector<Sphere> all = best(c, 400, Mode::inner);
  EXPECT_GT(iou(all, c.object), 0.999);
}

TEST(Best, StopsWhenAsked) {
  const Case c = made(sets::dumbbell(), 24);
  std::stop_source stop;
  const Context context{.threads = 2, .cancel = stop.get_token(), .progress = [&](std::string_view, double p) {
                          if (p > 0.1) stop.request_stop();
                        }};
  EXPECT_THROW(best_spheres(c.model, c.object, {.k = 50, .iou = {}}, context), Error);
}

TEST(Best, BadInputGetsASentence) {
  const Case c = made(sets::dumbbell(), 10);
  const auto code = [&](const BestOptions& options, const SampledObject& object) {
    try {
      best_spheres(c.model, object, options);
    } catch (const Error& error) {
      EXPECT_TRUE(std::string(error.what()).ends_with("."));
      return error.code();
    }
    return ErrorCode::busy;
  };
  EXPECT_EQ(code({.k = {}, .iou = {}}, c.object), ErrorCode::invalid_argument);
  EXPECT_EQ(code({.k = 3, .iou = 0.5}, c.object), ErrorCode::invalid_argument);
  EXPECT_EQ(code({.k = 0, .iou = {}}, c.object), ErrorCode::invalid_argument);
  EXPECT_EQ(code({.k = static_cast<std::uint32_t>(c.model.spheres.size() + 1), .iou = {}}, c.object),
            ErrorCode::invalid_argument);
  for (const double wanted : {0.0, -1.0, 1.1, std::nan("")}) {
    EXPECT_EQ(code({.k = {}, .iou = wanted}, c.object), ErrorCode::invalid_argument);
  }
  EXPECT_EQ(code({.k = 3, .iou = {}}, {c.object.grid, SampleBits(c.object.grid.dims), Border::closed}),
            ErrorCode::unusable);
  const SphereModel points{.spheres = {{{0, 0, 0}, 0}, {{1, 0, 0}, 0}}, .solid = {}};
  EXPECT_THROW(best_spheres(points, c.object, {.k = 1, .iou = {}}), Error);
}

// The overlap that compact organs are due, less a margin for other compilers.
TEST(BestOnScans, CompactOrgans) {
  struct Organ {
    const char* file;
    ObjectRule rule;
    double at_64, at_256;
  };
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  for (const Organ& organ :
       {Organ{"abdomen-ct-small-labels.nii.gz", phantoms::labels({5}, Border::open), 0.93, 0.98},  // liver
        Organ{"abdomen-ct-small-labels.nii.gz", phantoms::labels({5}), 0.89, 0.97},
        Organ{"abdomen-ct-small-labels.nii.gz", phantoms::labels({1}), 0.92, 0.98},  // spleen
        Organ{"pet.nii", phantoms::threshold(0.3, Border::open), 0.96, 0.985}}) {    // head
    if (!std::filesystem::exists(folder / organ.file)) GTEST_SKIP() << "no shared test data";
    const Case c = made(read_volume({folder / organ.file}), organ.rule);
    const BestSpheres result =
        best_spheres(c.model, c.object, {.k = 256, .iou = {}}, {.threads = 2, .cancel = {}, .progress = {}});
    EXPECT_GT(iou(spheres_at(result.simplification, 64), c.object), organ.at_64) << organ.file;
    EXPECT_GT(iou(spheres_at(result.simplification, 256), c.object), organ.at_256) << organ.file;
  }
}

}  // namespace
}  // namespace spherule
