// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/slice/slice.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <numbers>
#include <set>

#include "core/boundary.h"
#include "core/predicates.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

using namespace phantoms;

Grid plane_grid(std::int32_t n, std::int32_t m, Vec3 spacing = {1, 1, 1}) {
  Grid grid;
  grid.dims = {n, m, 1};
  grid.spacing = spacing;
  return grid;
}

std::vector<LatticePoint> random_points(std::size_t n, std::int32_t range, std::uint64_t seed) {
  Random random(seed);
  std::set<LatticePoint> points;
  while (points.size() < n) {
    points.insert({static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(range))),
                   static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(range))), 7});
  }
  std::vector<LatticePoint> shuffled(points.begin(), points.end());
  random.shuffle(shuffled);
  return shuffled;
}

// Every circle is empty, and the areas add up to that of the hull, which is that of all triangles that face outwards.
void expect_delaunay(const std::vector<LatticePoint>& points, const std::vector<PlaneTriangle>& triangles) {
  for (const auto& [a, b, c] : triangles) {
    ASSERT_GT(exact::two_areas(points[a], points[b], points[c]), 0);
    for (const LatticePoint p : points) ASSERT_LE(exact::in_circle(points[a], points[b], points[c], p), 0);
  }
}

TEST(Triangulate, CirclesAreEmptyAndTrianglesFillTheHull) {
  for (const std::int32_t range : {12, 1000, 1 << 24}) {
    const auto points = random_points(range == 12 ? 90 : 200, range, 5);
    const auto triangles = triangulate(points);
    expect_delaunay(points, triangles);
    // Euler: t = 2n - 2 - h, with h the edges of one triangle only.
    std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
    for (const auto& t : triangles)
      for (std::size_t i = 0; i < 3; ++i) ++edges[std::minmax(t[i], t[(i + 1) % 3])];
    const auto hull = std::ranges::count_if(edges, [](const auto& e) { return e.second == 1; });
    EXPECT_EQ(triangles.size(), 2 * points.size() - 2 - static_cast<std::size_t>(hull));
  }
}

TEST(Triangulate, IsAFunctionOfTheSetOfPoints) {
  // A full square of lattice points: every circle is shared by four.
  std::vector<LatticePoint> points;
  for (std::int32_t y = 0; y < 9; ++y)
    for (std::int32_t x = 0; x < 9; ++x) points.push_back({64 * x, 64 * y, 0});
  const auto as_points = [](const std::vector<LatticePoint>& all, const std::vector<PlaneTriangle>& triangles) {
    std::set<std::set<LatticePoint>> set;
    for (const auto& [a, b, c] : triangles) set.insert({all[a], all[b], all[c]});
    return set;
  };
  const auto expected = as_points(points, triangulate(points));
  EXPECT_EQ(expected.size(), 128U);
  Random random(3);
  for (int i = 0; i < 5; ++i) {
    random.shuffle(points);
    EXPECT_EQ(as_points(points, triangulate(points)), expected);
  }
}

TEST(Triangulate, FewPointsAndPointsOnALineGiveNone) {
  std::vector<LatticePoint> points;
  for (std::int32_t i = 0; i < 5; ++i) {
    EXPECT_TRUE(triangulate(points).empty());
    points.push_back({10 * i, 20 * i, 0});
  }
}

TEST(SliceOf, KeepsSamplesAndPlaces) {
  Grid grid;
  grid.dims = {4, 3, 5};
  grid.spacing = {1, 2, 3};
  grid.origin = {-7, 8, 9};
  grid.direction = {{Vec3{0, -1, 0}, Vec3{1, 0, 0}, Vec3{0, 0, 1}}};
  const Volume volume = noise(grid, 30000, 4, VoxelType::int16);
  for (const int axis : {0, 1, 2}) {
    const Volume slice = slice_of(volume, axis, 1);
    const std::array<int, 2> along{axis == 0 ? 1 : 0, axis == 2 ? 1 : 2};
    ASSERT_EQ(slice.grid.dims[2], 1);
    for (std::int32_t y = 0; y < slice.grid.dims[1]; ++y)
      for (std::int32_t x = 0; x < slice.grid.dims[0]; ++x) {
        std::array<std::int32_t, 3> at{};
        at[static_cast<std::size_t>(along[0])] = x, at[static_cast<std::size_t>(along[1])] = y;
        at[static_cast<std::size_t>(axis)] = 1;
        ASSERT_EQ(value_at(slice, x, y, 0), value_at(volume, at[0], at[1], at[2]));
        const Vec3 here = slice.grid.to_patient({x * slice.grid.spacing.x, y * slice.grid.spacing.y, 0});
        EXPECT_LT(norm(here - grid.to_patient({at[0] * 1.0, at[1] * 2.0, at[2] * 3.0})), 1e-12);
      }
  }
}

TEST(SliceOf, RefusesSlicesThatAreNotThere) {
  const Volume volume = noise(cubic_grid(4, 4), 2, 1);
  for (const std::int32_t index : {-1, 4}) {
    try {
      static_cast<void>(slice_of(volume, 1, index));
      ADD_FAILURE();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::not_found);
      EXPECT_NE(std::string(error.what()).find("0 to 3"), std::string::npos);
    }
  }
}

// What the header promises of every slice.
void expect_sound(const Volume& slice, const ObjectRule& rule, const PlaneModel& model) {
  const InsideSamples samples = classify_samples(slice, rule);
  EXPECT_EQ(model.inside_samples, samples.inside.count());
  EXPECT_EQ(model.circles.size(), model.inside_count);
  expect_delaunay(model.points, model.triangles);
  const Lattice& lattice = model.lattice;
  std::size_t covered = 0;
  for (std::int32_t y = 0; y < slice.grid.dims[1]; ++y)
    for (std::int32_t x = 0; x < slice.grid.dims[0]; ++x) {
      const LatticePoint sample{lattice.plane(0, x), lattice.plane(1, y), lattice.plane(2, 0)};
      const bool held = std::ranges::any_of(std::span(model.triangles).first(model.inside_count), [&](const auto& t) {
        return exact::in_circle(model.points[t[0]], model.points[t[1]], model.points[t[2]], sample) > 0;
      });
      EXPECT_LE(held, samples.inside.test(x, y, 0)) << x << ' ' << y;
      covered += held;
    }
  if (rule.border == Border::closed) {
    EXPECT_EQ(covered, model.inside_samples);
    std::vector<int> ends(model.points.size()), starts(model.points.size());
    for (const auto& [a, b] : model.contour) ++starts[a], ++ends[b];
    EXPECT_TRUE(std::ranges::all_of(starts, [](int n) { return n == 1; }));
    EXPECT_TRUE(std::ranges::all_of(ends, [](int n) { return n == 1; }));
  }
  for (std::size_t c = 0; c < model.circles.size(); ++c)
    for (const std::uint32_t p : model.triangles[c]) {
      const double distance = norm(lattice.to_patient(model.points[p]) - model.circles[c].centre);
      EXPECT_GE(distance, model.circles[c].radius * (1 - 1e-12));
      EXPECT_LE(distance, model.circles[c].radius + lattice.unit_mm);
    }
}

// Twice the area within the contour, in square lattice units, by the shoelace formula.
std::int64_t twice_contour_area(const PlaneModel& model) {
  std::int64_t twice = 0;
  for (const auto& [a, b] : model.contour)
    twice += std::int64_t{model.points[a].x} * model.points[b].y - std::int64_t{model.points[a].y} * model.points[b].x;
  return twice;
}

TEST(PlaneModel, OfTheEquatorOfABallIsItsDisc) {
  // The paper's ball: threshold 120 is a radius of 11.5 (1 - 120 / 255), and its density is linear along each ray.
  const double radius = 11.5 * (1 - 120.0 / 255);
  const Grid grid = cubic_grid(25, 24);
  const Volume slice = slice_of(sample(paper_ball({0, 0, 0}), grid), 2, 12);
  const ObjectRule rule = threshold(120);
  const PlaneModel model = build_plane_model(slice, rule);
  expect_sound(slice, rule, model);
  for (const LatticePoint p : model.points) EXPECT_NEAR(norm(model.lattice.to_patient(p)), radius, 0.05);
  const double area = std::numbers::pi * radius * radius;
  EXPECT_NEAR(model.area_mm2, area, 0.02 * area);
  EXPECT_NEAR(0.5 * static_cast<double>(twice_contour_area(model)) * model.lattice.unit_mm * model.lattice.unit_mm,
              area, 0.02 * area);
  for (const Sphere& circle : model.circles) EXPECT_LT(norm(circle.centre) + circle.radius, radius + 0.15);
}

TEST(PlaneModel, HasThePointsOfTheModelInSpace) {
  const Volume volume = noise(cubic_grid(9, 8), 200, 11);
  const ObjectRule rule = threshold(130.25);
  const BoundaryPoints boundary = extract_boundary(volume, rule, classify_samples(volume, rule));
  for (const int axis : {0, 1, 2}) {
    const PlaneModel model = build_plane_model(slice_of(volume, axis, 4), rule);
    std::vector<Vec3> expected;
    for (const LatticePoint p : boundary.points)
      if (p[axis] == boundary.lattice.plane(axis, 4)) expected.push_back(boundary.lattice.to_patient(p));
    ASSERT_EQ(model.points.size(), expected.size());
    for (const LatticePoint p : model.points) {
      const Vec3 here = model.lattice.to_patient(p);
      EXPECT_TRUE(std::ranges::any_of(
          expected, [&](Vec3 e) { return norm(e - here) <= boundary.lattice.unit_mm + model.lattice.unit_mm; }));
    }
  }
}

TEST(PlaneModel, KeepsItsPromisesOnNoise) {
  std::uint64_t seed = 1;
  for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{0.7, 2.5, 4}})
    for (const std::uint32_t levels : {2U, 5U, 200U})
      for (const Border border : {Border::closed, Border::open})
        for (const Side side : {Side::above, Side::below}) {
          const Volume slice = noise(plane_grid(11, 8, spacing), levels, ++seed);
          for (const ObjectRule& rule :
               {threshold(levels / 2.0, border, side), threshold(levels / 2.0 + 0.3, border, side),
                range(0.3 * levels, 0.6 * levels, border, side), labels({0, 1}, border, side)}) {
            expect_sound(slice, rule, build_plane_model(slice, rule));
          }
        }
}

TEST(PlaneModel, OutlineEnclosesTheObjectOnItsLeft) {
  // One inside sample: a diamond, half a voxel to each side, on a grid of 1 x 2 mm.
  Volume slice = noise(plane_grid(3, 3, {1, 2, 1}), 1, 1);
  set_stored(slice, {1, 1, 0}, 100);
  PlaneModel model = build_plane_model(slice, threshold(50));
  ASSERT_EQ(model.points.size(), 4U);
  const double square_mm = model.lattice.unit_mm * model.lattice.unit_mm;
  EXPECT_NEAR(0.5 * static_cast<double>(twice_contour_area(model)) * square_mm, 1, 1e-6);
  EXPECT_NEAR(model.area_mm2, 1, 1e-6);
  // The other side of it: the border square of 3 x 6 without its corners, less the diamond.
  model = build_plane_model(slice, threshold(50, Border::closed, Side::below));
  EXPECT_NEAR(0.5 * static_cast<double>(twice_contour_area(model)) * square_mm, 18 - 4 * 0.25 - 1, 1e-5);
}

TEST(PlaneModel, SaddlesFollowTheValues) {
  // Two inside corners across a cell, joined or not by the saddle a·c - b·d of the values less the threshold.
  for (const auto& [low, joined] : {std::pair{40.0, true}, {10.0, false}}) {
    Volume slice = noise(plane_grid(4, 4), 1, 1);
    set_stored(slice, {1, 1, 0}, 80), set_stored(slice, {2, 2, 0}, 80);
    set_stored(slice, {1, 2, 0}, low), set_stored(slice, {2, 1, 0}, low);
    const PlaneModel model = build_plane_model(slice, threshold(50));
    std::map<std::uint32_t, std::uint32_t> next;
    for (const auto& [a, b] : model.contour) next[a] = b;
    std::size_t length = 1;
    for (std::uint32_t at = next.at(0); at != 0; at = next.at(at)) ++length;
    EXPECT_EQ(length == model.points.size(), joined) << low;
  }
}

TEST(PlaneModel, ARangeThatIsJumpedOverIsAStrip) {
  // A step from 0 to 100 with the range in between: no sample is inside, the strip is 0.2 wide and 3 long.
  Volume slice = noise(plane_grid(4, 3), 1, 1);
  for (std::int32_t y = 0; y < 3; ++y)
    for (const std::int32_t x : {2, 3}) set_stored(slice, {x, y, 0}, 100);
  const PlaneModel model = build_plane_model(slice, range(40, 60));
  ASSERT_EQ(model.points.size(), 6U);
  // Its ends are drawn at the first and the last row of samples.
  EXPECT_NEAR(0.5 * static_cast<double>(twice_contour_area(model)) * model.lattice.unit_mm * model.lattice.unit_mm,
              0.2 * 2, 1e-5);
}

TEST(PlaneModel, WithoutABoundaryIsEmpty) {
  const Volume slice = noise(plane_grid(5, 4), 1, 1);
  const PlaneModel none = build_plane_model(slice, threshold(10));
  EXPECT_TRUE(none.points.empty() && none.contour.empty() && none.triangles.empty());
  const PlaneModel all = build_plane_model(slice, threshold(0, Border::open));
  EXPECT_TRUE(all.points.empty() && all.triangles.empty());
  EXPECT_EQ(all.inside_samples, 20U);
  // One row of samples, and one sample.
  EXPECT_EQ(build_plane_model(noise(plane_grid(1, 1), 1, 1), threshold(0)).points.size(), 4U);
  EXPECT_TRUE(build_plane_model(noise(plane_grid(7, 1), 5, 2), threshold(2.5, Border::open)).triangles.empty());
}

TEST(PlaneModel, StopsWhenCancelledAndRefusesTooManyPoints) {
  const Volume slice = noise(plane_grid(50, 50), 2, 2);
  std::stop_source stop;
  stop.request_stop();
  EXPECT_THROW(static_cast<void>(build_plane_model(slice, threshold(0.5), 1 << 20,
                                                   {.threads = 1, .cancel = stop.get_token(), .progress = {}})),
               Error);
  EXPECT_THROW(static_cast<void>(build_plane_model(slice, threshold(0.5), 100)), Error);
}

}  // namespace
}  // namespace spherule
