// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/pipeline.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstdio>
#include <filesystem>
#include <numbers>

#include "core/measure/checks.h"
#include "core/measure/solid.h"
#include "core/predicates.h"
#include "core/read/read.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

using phantoms::cubic_grid;
using phantoms::Field;
constexpr double kPi = std::numbers::pi;

// Off every symmetry of the grids below, so that no error cancels by luck.
constexpr Vec3 kOff{0.0131, -0.0217, 0.0093};

struct Truth {
  const char* name;
  Field field;
  double volume, area;
  std::array<std::int64_t, 3> betti;
  Border border = Border::closed;
  double reach = 0;  ///< the least radius of curvature
  bool smooth = true;
};

// In a grid of edge 4 about the origin.
std::vector<Truth> bodies() {
  const auto ball_volume = [](double r) { return 4 * kPi / 3 * r * r * r; };
  const auto ball_area = [](double r) { return 4 * kPi * r * r; };
  return {
      {"ball", phantoms::ball(kOff, 1.5), ball_volume(1.5), ball_area(1.5), {1, 0, 0}, Border::closed, 1.5, true},
      {"torus",
       phantoms::torus(kOff, 1.2, 0.5),
       2 * kPi * kPi * 1.2 * 0.25,
       4 * kPi * kPi * 1.2 * 0.5,
       {1, 1, 0},
       Border::closed,
       0.5,
       true},
      {"cylinder",
       phantoms::cylinder(kOff, 1.5),
       kPi * 2.25 * 4,
       2 * kPi * 1.5 * 4 + 2 * kPi * 2.25,
       {1, 0, 0},
       Border::open,
       1.5,
       true},
      {"two balls",
       phantoms::either(phantoms::ball(kOff + Vec3{-1, 0, 0}, 0.8), phantoms::ball(kOff + Vec3{1, 0, 0}, 0.8)),
       2 * ball_volume(0.8),
       2 * ball_area(0.8),
       {2, 0, 0},
       Border::closed,
       0.8,
       true},
      {"shell",
       phantoms::shell(kOff, 1.6, 0.8),
       ball_volume(1.6) - ball_volume(0.8),
       ball_area(1.6) + ball_area(0.8),
       {1, 0, 1},
       Border::closed,
       0.8,
       true},
      {"cube", phantoms::cube(kOff, 1.2), 2.4 * 2.4 * 2.4, 6 * 2.4 * 2.4, {1, 0, 0}, Border::closed, 0, false},
      {"capped cylinder",
       phantoms::capped_cylinder(kOff, 1.2, 1.3),
       kPi * 1.44 * 2.6,
       2 * kPi * 1.2 * 2.6 + 2 * kPi * 1.44,
       {1, 0, 0},
       Border::closed,
       0,
       false},
  };
}

struct Errors {
  double volume, area;
};
Errors errors(const Truth& body, std::int32_t n) {
  const auto built = build_model(phantoms::sample(body.field, cubic_grid(n, 4)), phantoms::threshold(0, body.border));
  const auto measures = measure_tetrahedra(*built.model.solid);
  EXPECT_EQ(measures.topology.betti, body.betti) << body.name << " at " << n;
  return {measures.volume_mm3 - body.volume, measures.area_mm2 - body.area};
}

// How far the boundary can be from a smooth surface, h the voxel and r its least radius of curvature. Along a grid edge
// the distance field bends by at most 1/(r - h), so linear interpolation misplaces a point by h²/8(r - h). A facet's
// empty ball centred on the surface cannot hold a whole voxel, so the facet is within a circle of radius sqrt(3) h and
// sags by 3h²/2r. Together below 1.63 h²/(r - h); times the area, and a quarter more for the area's own change.
double volume_bound(const Truth& body, double h) { return 1.25 * 1.63 * h * h / (body.reach - h) * body.area; }

TEST(Convergence, OfSmoothBodiesIsOfSecondOrderWithinTheDerivedBound) {
  for (const Truth& body : bodies()) {
    if (!body.smooth) continue;
    std::vector<double> volume, area;
    for (const std::int32_t n : {17, 33, 65}) {
      const Errors e = errors(body, n);
      const double h = 4.0 / (n - 1);
      EXPECT_LT(std::abs(e.volume), volume_bound(body, h)) << body.name << " at " << n;
      volume.push_back(std::abs(e.volume));
      area.push_back(std::abs(e.area));
    }
    // Halving h twice divides an error of second order by 16; how the surface falls between samples changes the
    // constant by up to a quarter at either end.
    const double volume_order = std::log2(volume.front() / volume.back()) / 2;
    const double area_order = std::log2(area.front() / area.back()) / 2;
    std::printf("[ measured ] %-10s volume error %.1e, order %.2f; area error %.1e, order %.2f\n", body.name,
                volume.back(), volume_order, area.back(), area_order);
    EXPECT_GT(volume_order, 1.7) << body.name;
    EXPECT_LT(volume_order, 2.3) << body.name;
    EXPECT_GT(area_order, 1.6) << body.name;
    EXPECT_LT(area_order, 2.4) << body.name;
  }
}

// Sharp edges are chamfered over a voxel: that takes h² of volume and h of area for a unit of edge.
TEST(Convergence, OfBodiesWithEdgesLosesOneOrderInArea) {
  for (const Truth& body : bodies()) {
    if (body.smooth) continue;
    const Errors coarse = errors(body, 17), fine = errors(body, 65);
    const double volume_order = std::log2(std::abs(coarse.volume / fine.volume)) / 2;
    const double area_order = std::log2(std::abs(coarse.area / fine.area)) / 2;
    EXPECT_LT(fine.volume, 0) << body.name;
    EXPECT_LT(fine.area, 0) << body.name;
    EXPECT_GT(volume_order, 1.6) << body.name;
    EXPECT_GT(area_order, 0.7) << body.name;
  }
}

// Linear interpolation of a concave field never leaves the ball, so the polyhedron of its points is inside it.
TEST(Convergence, ABallIsApproachedFromInside) {
  for (const std::int32_t n : {9, 12, 17, 26}) EXPECT_LT(errors(bodies()[0], n).volume, 0);
}

TEST(Topology, OfMorePhantoms) {
  const auto betti = [](const Field& field, std::int32_t n, const ObjectRule& rule) {
    const auto built = build_model(phantoms::sample(field, cubic_grid(n, 4)), rule);
    return measure_tetrahedra(*built.model.solid).topology.betti;
  };
  const auto rule = phantoms::threshold(0);
  using Betti = std::array<std::int64_t, 3>;
  EXPECT_EQ(betti(phantoms::slab(0.1, 0.7), 21, rule), (Betti{1, 0, 0}));
  EXPECT_EQ(betti(phantoms::either(phantoms::torus({-0.9, 0, 0}, 0.75, 0.25), phantoms::torus({0.9, 0, 0}, 0.75, 0.25)),
                  41, rule),
            (Betti{1, 2, 0}));
  // The complement of a ball in a closed box has a void; of a torus, a tunnel and a void.
  EXPECT_EQ(betti(phantoms::ball(kOff, 1), 21, phantoms::threshold(0, Border::closed, Side::below)), (Betti{1, 0, 1}));
  EXPECT_EQ(betti(phantoms::torus(kOff, 1, 0.4), 31, phantoms::threshold(0, Border::closed, Side::below)),
            (Betti{1, 1, 1}));
  // A range of the distance to a centre is a shell.
  EXPECT_EQ(betti(phantoms::ball(kOff, 1.5), 21, phantoms::range(0, 0.7)), (Betti{1, 0, 1}));
}

TEST(Slab, OpenIsABoxExactly) {
  // Between z = -0.5 and 0.75, through the whole grid: planes are interpolated without error.
  const Grid grid = cubic_grid(9, 4);
  const auto built =
      build_model(phantoms::sample(phantoms::slab(0.125, 0.625), grid), phantoms::threshold(0, Border::open));
  const auto measures = measure_tetrahedra(*built.model.solid);
  const double unit = built.model.solid->boundary.lattice.unit_mm;
  EXPECT_NEAR(measures.volume_mm3, 4 * 4 * 1.25, 4 * 4 * unit);
  EXPECT_NEAR(measures.area_mm2, 2 * 16 + 4 * 4 * 1.25, 16 * unit);
  ASSERT_EQ(built.warnings.size(), 1U);
}

bool same_bytes(const SphereModel& a, const SphereModel& b) {
  return a.spheres == b.spheres && a.solid->cells == b.solid->cells && a.solid->inside_count == b.solid->inside_count &&
         a.solid->boundary.points == b.solid->boundary.points;
}

TEST(Pipeline, GivesTheSameModelOnAnyNumberOfThreads) {
  const Volume noise =
      phantoms::noise({.dims = {22, 19, 13}, .spacing = {1, 1, 2.5}, .origin = {}, .direction = {}}, 9, 3);
  for (const ObjectRule& rule : {phantoms::threshold(5), phantoms::range(2.5, 4.5, Border::open)}) {
    const auto expected = build_model(noise, rule);
    for (const unsigned threads : {1U, 2U, 4U}) {
      Context context;
      context.threads = threads;
      EXPECT_TRUE(same_bytes(build_model(noise, rule, {}, context).model, expected.model)) << threads;
    }
  }
}

// Moving the object by whole voxels moves every lattice point by the same amount and changes nothing else.
TEST(Pipeline, MovesWithTheObject) {
  const Volume object = phantoms::noise({.dims = {7, 6, 5}, .spacing = {1, 1, 2}, .origin = {}, .direction = {}}, 9, 8);
  const auto at = [&](std::array<std::int32_t, 3> shift) {
    Volume volume = phantoms::noise({.dims = {80, 12, 11}, .spacing = {1, 1, 2}, .origin = {}, .direction = {}}, 1, 0);
    for (std::int32_t k = 0; k < 5; ++k) {
      for (std::int32_t j = 0; j < 6; ++j) {
        for (std::int32_t i = 0; i < 7; ++i)
          phantoms::set_stored(volume, {i + shift[0], j + shift[1], k + shift[2]}, value_at(object, i, j, k));
      }
    }
    return build_model(volume, phantoms::threshold(4.5));
  };
  const auto expected = at({1, 1, 1});
  for (const std::array<std::int32_t, 3> shift : {std::array{2, 1, 1}, std::array{60, 3, 4}, std::array{72, 5, 5}}) {
    const auto moved = at(shift);
    EXPECT_EQ(moved.model.solid->cells, expected.model.solid->cells);
    EXPECT_EQ(moved.model.solid->inside_count, expected.model.solid->inside_count);
    ASSERT_EQ(moved.model.spheres.size(), expected.model.spheres.size());
    for (std::size_t s = 0; s < moved.model.spheres.size(); ++s)
      ASSERT_NEAR(moved.model.spheres[s].radius, expected.model.spheres[s].radius,
                  1e-9 * expected.model.spheres[s].radius);
  }
}

// A mirror image breaks ties the other way, but cells that share a sphere are decided alike: the solid is the same.
TEST(Pipeline, TheMirrorImageHasTheSameMeasures) {
  const Grid grid{.dims = {9, 9, 9}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  for (std::uint64_t seed = 0; seed < 10; ++seed) {
    const Volume volume = phantoms::noise(grid, 4, seed);
    const ObjectRule rule = phantoms::labels({1});
    const auto expected = measure_tetrahedra(*build_model(volume, rule).model.solid);
    for (int axis = 0; axis < 3; ++axis) {
      Volume mirror = volume;
      for (std::int32_t k = 0; k < 9; ++k) {
        for (std::int32_t j = 0; j < 9; ++j) {
          for (std::int32_t i = 0; i < 9; ++i) {
            std::array<std::int32_t, 3> to{i, j, k};
            to[static_cast<std::size_t>(axis)] = 8 - to[static_cast<std::size_t>(axis)];
            phantoms::set_stored(mirror, to, value_at(volume, i, j, k));
          }
        }
      }
      const auto measures = measure_tetrahedra(*build_model(mirror, rule).model.solid);
      EXPECT_EQ(measures.volume_mm3, expected.volume_mm3) << seed;
      EXPECT_NEAR(measures.area_mm2, expected.area_mm2, 1e-12 * expected.area_mm2) << seed;
      EXPECT_EQ(measures.topology.betti, expected.topology.betti) << seed;
    }
  }
}

// The same on a sphere that several cells share: it cannot be inside for one and outside for another.
TEST(Pipeline, CellsOnOneSphereAreDecidedAlike) {
  for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{1, 2, 4}, Vec3{0.7, 0.7, 3}}) {
    const Grid grid{.dims = {9, 9, 9}, .spacing = spacing, .origin = {}, .direction = {}};
    int shared = 0;
    for (std::uint64_t seed = 0; seed < 6; ++seed) {
      for (const ObjectRule& rule : {phantoms::labels({1}), phantoms::threshold(1.5), phantoms::threshold(2)}) {
        const auto model = build_model(phantoms::noise(grid, 4, seed), rule).model;
        const auto& [boundary, cells, inside_count] = model.solid.value();
        const auto& points = boundary.points;
        const auto adjacent = neighbours(cells, points.size());
        for (std::size_t c = 0; c < cells.size(); ++c) {
          const auto& t = cells[c];
          for (const std::uint32_t other : adjacent[c]) {
            if (other == no_cell) continue;
            const bool one_sphere = std::ranges::all_of(cells[other], [&](std::uint32_t v) {
              return exact::in_sphere(points[t[0]], points[t[1]], points[t[2]], points[t[3]], points[v]) == 0;
            });
            shared += one_sphere;
            if (one_sphere) {
              ASSERT_EQ(c < inside_count, other < inside_count) << seed;
            }
          }
        }
      }
    }
    EXPECT_GT(shared, 1000);
  }
}

TEST(Pipeline, TheGridsPlaceInThePatientMovesAndTurnsTheSpheres) {
  Volume volume = phantoms::noise({.dims = {6, 7, 8}, .spacing = {1, 2, 3}, .origin = {}, .direction = {}}, 9, 5);
  const auto plain = build_model(volume, phantoms::threshold(5));
  const double c = std::cos(0.4), s = std::sin(0.4);
  volume.grid.origin = {-100, 50, 7};
  volume.grid.direction = {{Vec3{c, -s, 0}, Vec3{s, c, 0}, Vec3{0, 0, -1}}};
  const auto turned = build_model(volume, phantoms::threshold(5));
  ASSERT_EQ(turned.model.spheres.size(), plain.model.spheres.size());
  for (std::size_t n = 0; n < plain.model.spheres.size(); ++n) {
    EXPECT_EQ(turned.model.spheres[n].radius, plain.model.spheres[n].radius);
    const Vec3 expected = volume.grid.to_patient(plain.model.spheres[n].centre);
    ASSERT_NEAR(norm(turned.model.spheres[n].centre - expected), 0, 1e-12 * (200 + norm(expected)));
  }
}

TEST(Pipeline, StatesItsStagesAndWarnings) {
  const auto inner = build_model(phantoms::sample(phantoms::ball({}, 1), cubic_grid(9, 4)), phantoms::threshold(0));
  EXPECT_TRUE(inner.warnings.empty());
  std::vector<std::string> stages;
  for (const StageTime& t : inner.timings) stages.push_back(t.stage);
  EXPECT_EQ(stages, (std::vector<std::string>{"samples", "boundary", "delaunay", "spheres"}));
  EXPECT_EQ(inner.boundary_point_density_mm, boundary_point_density(*inner.model.solid));
  for (const Border border : {Border::closed, Border::open})
    EXPECT_EQ(build_model(phantoms::sample(phantoms::cylinder({}, 1), cubic_grid(9, 4)), phantoms::threshold(0, border))
                  .warnings.size(),
              1U);
}

ErrorCode refusal(const Volume& volume, const ObjectRule& rule, const ModelLimits& limits = {},
                  const Context& context = {}) {
  try {
    build_model(volume, rule, limits, context);
  } catch (const Error& error) {
    return error.code();
  }
  ADD_FAILURE() << "not refused";
  return ErrorCode::busy;
}

TEST(Pipeline, LeavesAVoidAroundASampleThatIsNoNumber) {
  Volume hole = phantoms::sample(phantoms::ball({}, 1), cubic_grid(9, 4));
  const BuiltModel whole = build_model(hole, phantoms::threshold(0));
  phantoms::set_stored(hole, {4, 4, 4}, NAN);
  const BuiltModel pierced = build_model(hole, phantoms::threshold(0));
  EXPECT_EQ(measure_tetrahedra(*whole.model.solid).topology.betti, (std::array<std::int64_t, 3>{1, 0, 0}));
  EXPECT_EQ(measure_tetrahedra(*pierced.model.solid).topology.betti, (std::array<std::int64_t, 3>{1, 0, 1}));
}

TEST(Pipeline, RefusesObjectsWithoutASolid) {
  const Volume ball = phantoms::sample(phantoms::ball({}, 1), cubic_grid(9, 4));
  EXPECT_EQ(refusal(ball, phantoms::threshold(100)), ErrorCode::unusable);
  EXPECT_EQ(refusal(ball, phantoms::threshold(-100, Border::open)), ErrorCode::unusable);
  // An open half space has its points in one plane.
  const Volume half = phantoms::sample([](Vec3 p) { return p.x; }, cubic_grid(9, 4));
  EXPECT_EQ(refusal(half, phantoms::threshold(0.1, Border::open)), ErrorCode::unusable);
  EXPECT_EQ(refusal(ball, phantoms::threshold(0), {.max_points = 10}), ErrorCode::too_large);
  EXPECT_EQ(refusal(ball, phantoms::threshold(NAN)), ErrorCode::invalid_argument);
  std::stop_source stop;
  stop.request_stop();
  Context context;
  context.cancel = stop.get_token();
  EXPECT_EQ(refusal(ball, phantoms::threshold(0), {}, context), ErrorCode::cancelled);
}

TEST(Pipeline, ProgressNeverGoesBackWithinAStage) {
  std::string stage;
  double last = 0;
  Context context;
  context.threads = 3;
  context.progress = [&](std::string_view name, double fraction) {
    if (name != stage) stage = name, last = 0;
    EXPECT_GE(fraction, last) << name;
    EXPECT_LE(fraction, 1) << name;
    last = fraction;
  };
  build_model(phantoms::noise(cubic_grid(30, 29), 9, 1), phantoms::threshold(5), {}, context);
  EXPECT_EQ(stage, "spheres");
}

// Real scans: counts of voxels from the data's own description; volumes within the surface's share of a voxel.
struct Scan {
  const char* files[2];
  ObjectRule rule;
  std::uint64_t voxels;
};
TEST(RealScans, HaveTheDocumentedVoxelsAndASoundModel) {
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  if (!std::filesystem::exists(folder)) GTEST_SKIP() << "no test volumes at " << SPHERULE_SHARED_DATA;
  for (const Scan& scan : {Scan{{"mr-small.mhd", "mr-small.raw"}, phantoms::threshold(30), 36'922},
                           Scan{{"abdomen-ct-small-labels.nii.gz", nullptr}, phantoms::labels({5}), 38'634},
                           Scan{{"abdomen-ct-small.nii.gz", nullptr}, phantoms::threshold(200), 3'377},
                           Scan{{"ct-head.mhd", "ct-head.raw"}, phantoms::threshold(1150), 34'295}}) {
    std::vector<std::filesystem::path> files;
    for (const char* file : scan.files) {
      if (file) files.push_back(folder / file);
    }
    const Volume volume = read_volume(files);
    const InsideSamples samples = classify_samples(volume, scan.rule);
    EXPECT_EQ(samples.inside.count(), scan.voxels) << scan.files[0];
    const auto built = build_model(volume, scan.rule);
    const ModelChecks checks = check_model(built.model, samples.inside, scan.rule.border);
    // Every voxel that the surface passes has a boundary point on one of its edges.
    const double voxel_volume = measure_voxels(volume.grid, samples.inside).volume_mm3;
    const double passed = static_cast<double>(built.model.solid->boundary.points.size()) * voxel_volume /
                          static_cast<double>(scan.voxels);
    EXPECT_LT(std::abs(checks.bounds.tetrahedra_volume_mm3 - voxel_volume), passed) << scan.files[0];
    EXPECT_EQ(checks.criteria.violations(), 0U) << scan.files[0];
    EXPECT_LE(checks.bounds.density_mm, checks.bounds.density_bound_mm) << scan.files[0];
  }
}

// Ranjan and Fournier's synthetic volumes, 8-bit, in 24^3 samples around the centre. They publish 1704 points and 5120
// spheres for the ball at 30.5, and 736 and 2381 for the cylinder at 100.5; their sampling is not described.
TEST(PaperPhantoms, HaveTheCountsThatWeHad) {
  struct Case {
    const char* name;
    Field field;
    double threshold;
    std::size_t points, spheres;
  };
  const Vec3 centre{11.5, 11.5, 11.5};
  const Grid grid{.dims = {24, 24, 24}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  for (const Case& c : {Case{"ball", phantoms::paper_ball(centre), 30.5, 1896, 5466},
                        Case{"cylinder", phantoms::paper_cylinder(centre), 100.5, 1656, 4875}}) {
    const Volume volume = phantoms::sample(c.field, grid, VoxelType::uint8);
    const auto rule = phantoms::threshold(c.threshold);
    const auto built = build_model(volume, rule);
    std::printf("[ measured ] %s: %zu points, %zu spheres\n", c.name, built.model.solid->boundary.points.size(),
                built.model.spheres.size());
    EXPECT_EQ(built.model.solid->boundary.points.size(), c.points) << c.name;
    EXPECT_EQ(built.model.spheres.size(), c.spheres) << c.name;
    EXPECT_EQ(check_model(built.model, classify_samples(volume, rule).inside, rule.border).criteria.violations(), 0U);
  }
}

}  // namespace
}  // namespace spherule
