// SPDX-License-Identifier: GPL-3.0-or-later
//
// What small files can ask for: four times the size takes about four times as long, whatever the file holds.
#include "tests/core/hostile.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <ctime>
#include <functional>
#include <span>
#include <utility>

#include "core/compare/marching_cubes.h"
#include "core/measure/checks.h"
#include "core/measure/components.h"
#include "core/measure/enclosing.h"
#include "core/measure/power.h"
#include "core/measure/solid.h"
#include "core/measure/thickness.h"
#include "core/measure/union.h"
#include "core/pipeline.h"
#include "core/register/register.h"
#include "core/simplify/simplify.h"

namespace spherule {
namespace {

// Processor time of this thread, which does not depend on what else runs.
double seconds(const std::function<void()>& work) {
  const auto now = [] {
    timespec time{};
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &time);
    return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
  };
  const double begin = now();
  work();
  return now() - begin;
}

// n log n at sixteen times n is about twenty times as much, and up to eighty where what fitted caches does not any
// more; n² is 256 times. Below the least time caches decide.
constexpr double kMostGrowth = 128, kLeast = 0.004;

void expect_growth(const std::string& what, const std::function<void()>& few, const std::function<void()>& many) {
  const double before = seconds(few);
  double after = seconds(many);
  const double most = kMostGrowth * std::max(before, kLeast);
  if (after > most) after = std::min(after, seconds(many));
  EXPECT_LE(after, most) << what << ": " << before << " s, and " << after << " s for sixteen times as many";
}

SphereModel model_of(std::vector<Sphere> balls) { return {.spheres = std::move(balls), .solid = {}}; }

double volume_of(const SphereModel& model) { return measure_union(model).moments.volume; }

using Stage = std::pair<std::string, std::function<void(const SphereModel&)>>;

void expect_growth_of_ball_sets(std::size_t n, const std::vector<Stage>& stages) {
  const auto few = hostile::ball_sets(n), many = hostile::ball_sets(16 * n);
  for (std::size_t s = 0; s < few.size(); ++s) {
    const SphereModel less = model_of(few[s].balls), more = model_of(many[s].balls);
    for (const auto& [name, stage] : stages) {
      expect_growth(
          name + " of " + few[s].name, [&] { stage(less); }, [&] { stage(more); });
    }
  }
}

TEST(Hostile, MeasuresOfBallSetsTakeNoQuadraticTime) {
  expect_growth_of_ball_sets(
      300, {{"union", [](const SphereModel& m) { measure_union(m); }},
            {"topology", [](const SphereModel& m) { union_topology(m.spheres); }},
            {"components", [](const SphereModel& m) { first_of_component(m); }},
            {"enclosing", [](const SphereModel& m) { smallest_enclosing_sphere(m.spheres); }},
            {"inscribed", [](const SphereModel& m) { largest_inscribed_sphere(m.spheres); }},
            {"thickness", [](const SphereModel& m) { local_thickness(m.spheres, volume_of(m), 40, 1 << 12); }}});
}

TEST(Hostile, SimplifyingBallSetsTakesNoQuadraticTime) {
  expect_growth_of_ball_sets(
      300, {{"sphericity", [](const SphereModel& m) { cluster_by_sphericity(m, {.threshold = 0.95, .limit = 64}); }},
            {"splitting",
             [](const SphereModel& m) { split_spheres(m, {.k = static_cast<std::uint32_t>(m.spheres.size() / 4)}); }},
            {"pruning", [](const SphereModel& m) { prune_spheres(m, {.volume_share = 0.9}); }}});
}

TEST(Hostile, RegisteringBallSetsTakesNoQuadraticTime) {
  expect_growth_of_ball_sets(
      150, {{"registration", [](const SphereModel& m) { register_models(m, m, {.k = 16, .inits = 1}); }}});
}

TEST(Hostile, DiagramsThatAreQuadraticThemselvesAreRefused) {
  const auto code_of = [](const auto& work) {
    try {
      work();
    } catch (const Error& e) {
      return e.code();
    }
    return ErrorCode::conflict;
  };
  const auto few = hostile::skew_lines(300), many = hostile::skew_lines(5000);
  EXPECT_EQ(union_topology(few).betti, (std::array<std::int64_t, 3>{1, 0, 0}));
  EXPECT_GT(measure_union(std::span(few)).area_mm2, 0);
  EXPECT_EQ(code_of([&] { measure_union(std::span(many)); }), ErrorCode::too_large);
}

TEST(Hostile, ThinVolumesTakeNoQuadraticTime) {
  struct Made {
    const Volume& volume;
    InsideSamples samples;
    BuiltModel built;
  };
  const auto few = hostile::volumes(800), many = hostile::volumes(12800);
  const ObjectRule rule = phantoms::threshold(0.5);
  const std::vector<std::pair<std::string, std::function<void(const Made&)>>> stages{
      {"model", [&](const Made& m) { build_model(m.volume, rule); }},
      {"union", [](const Made& m) { measure_union(m.built.model); }},
      {"tetrahedra", [](const Made& m) { measure_tetrahedra(*m.built.model.solid); }},
      {"marching cubes",
       [&](const Made& m) { measure_marching_cubes(m.volume, rule, m.samples, m.built.model.solid->boundary); }},
      {"components", [](const Made& m) { first_of_component(m.built.model); }},
      {"thickness",
       [](const Made& m) {
         local_thickness(m.built.model, static_cast<double>(m.samples.inside.count()), 40, 1 << 12);
       }},
      {"checks", [](const Made& m) { check_model(m.built.model, m.samples.inside, Border::closed); }},
      {"sphericity", [](const Made& m) { cluster_by_sphericity(m.built.model, {.limit = 64}); }},
      {"splitting", [](const Made& m) { split_spheres(m.built.model, {.k = 64}); }},
      {"registration", [](const Made& m) { register_models(m.built.model, m.built.model, {.k = 16, .inits = 1}); }}};
  for (std::size_t v = 0; v < few.size(); ++v) {
    const auto made = [&](const Volume& volume) {
      return Made{volume, classify_samples(volume, rule), build_model(volume, rule)};
    };
    const Made less = made(few[v].volume), more = made(many[v].volume);
    for (const auto& [name, stage] : stages) {
      expect_growth(
          name + " of " + few[v].name, [&] { stage(less); }, [&] { stage(more); });
    }
  }
}

}  // namespace
}  // namespace spherule
