// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/boundary.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <limits>
#include <set>

#include "core/crossings.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kInf = std::numeric_limits<double>::infinity();
constexpr double kNaN = std::numeric_limits<double>::quiet_NaN();

Grid grid_of(std::array<std::int32_t, 3> dims, Vec3 spacing = {1, 1, 1}) {
  return {.dims = dims, .spacing = spacing, .origin = {}, .direction = {}};
}

BoundaryPoints boundary_of(const Volume& volume, const ObjectRule& rule, const Context& context = {}) {
  const InsideSamples samples = classify_samples(volume, rule);
  BoundaryPoints boundary = extract_boundary(volume, rule, samples, std::size_t{1} << 31, context);
  EXPECT_EQ(count_boundary_points(samples, rule.border, context), boundary.points.size());
  return boundary;
}

// A volume of zeros with single samples set.
Volume zeros(std::array<std::int32_t, 3> dims, const std::vector<std::pair<std::array<std::int32_t, 3>, double>>& set,
             VoxelType type = VoxelType::float64) {
  Volume volume = phantoms::noise(grid_of(dims), 1, 0, type);
  for (const auto& [at, value] : set) phantoms::set_stored(volume, at, value);
  return volume;
}

// What the header promises, edge by edge: the axis and the real coordinate of every crossing, in the documented order.
struct Crossing {
  int axis;
  std::array<double, 3> at;
  std::array<std::int32_t, 2> ends;
};
std::vector<Crossing> slow_crossings(const Volume& volume, const ObjectRule& rule) {
  const InsideSamples samples = classify_samples(volume, rule);
  const Lattice lattice = make_lattice(volume.grid);
  const auto n = volume.grid.dims;
  std::vector<Crossing> result;
  for (std::int32_t k = -1; k < n[2]; ++k) {
    for (std::int32_t j = -1; j < n[1]; ++j) {
      for (int axis = 0; axis < 3; ++axis) {
        for (std::int32_t i = -1; i < n[0]; ++i) {
          const std::array<std::int32_t, 3> p{i, j, k};
          auto q = p;
          ++q[static_cast<std::size_t>(axis)];
          const auto in_grid = [&](const std::array<std::int32_t, 3>& s) {
            return s[0] >= 0 && s[1] >= 0 && s[2] >= 0 && s[0] < n[0] && s[1] < n[1] && s[2] < n[2];
          };
          const bool whole = in_grid(p) && in_grid(q);
          if (!whole && rule.border == Border::open) continue;
          const bool a_in = samples.inside.test_or_outside(p[0], p[1], p[2]);
          const bool b_in = samples.inside.test_or_outside(q[0], q[1], q[2]);
          const std::int32_t pa = lattice.plane(axis, p[static_cast<std::size_t>(axis)]),
                             pb = lattice.plane(axis, q[static_cast<std::size_t>(axis)]);
          const auto add = [&](double coordinate) {
            Crossing c{axis, {}, {pa, pb}};
            for (int a = 0; a < 3; ++a)
              c.at[static_cast<std::size_t>(a)] = lattice.plane(a, p[static_cast<std::size_t>(a)]);
            c.at[static_cast<std::size_t>(axis)] = coordinate;
            result.push_back(c);
          };
          if (!whole || rule.kind == ObjectRule::Kind::labels) {
            if (a_in != b_in) add((pa + pb) / 2.0);
            continue;
          }
          const double a = value_at(volume, p[0], p[1], p[2]), b = value_at(volume, q[0], q[1], q[2]);
          if (!std::isfinite(a) || !std::isfinite(b)) {
            if (a_in != b_in) add((pa + pb) / 2.0);
            continue;
          }
          const auto coordinate = [&](double iso) {
            return std::clamp(pa + (iso - a) / (b - a) * (pb - pa), pa + 1.0, pb - 1.0);
          };
          if (rule.kind == ObjectRule::Kind::threshold) {
            if (a_in != b_in) add(coordinate(rule.lo));
          } else {
            // Every iso-value that the values pass, in the order along the edge.
            const bool lo_crossed = (a >= rule.lo) != (b >= rule.lo), hi_crossed = (a > rule.hi) != (b > rule.hi);
            std::vector<double> isos;
            if (lo_crossed) isos.push_back(rule.lo);
            if (hi_crossed) isos.push_back(rule.hi);
            if (a > b) std::ranges::reverse(isos);
            for (const double iso : isos) add(coordinate(iso));
          }
        }
      }
    }
  }
  return result;
}

void expect_as_defined(const Volume& volume, const ObjectRule& rule) {
  const BoundaryPoints boundary = boundary_of(volume, rule);
  const auto expected = slow_crossings(volume, rule);
  ASSERT_EQ(boundary.points.size(), expected.size());
  for (std::size_t n = 0; n < expected.size(); ++n) {
    for (int a = 0; a < 3; ++a) {
      const double at = expected[n].at[static_cast<std::size_t>(a)];
      if (a == expected[n].axis) {
        // Half a unit for rounding; a unit more where two crossings of one edge are kept apart.
        ASSERT_LE(std::abs(boundary.points[n][a] - at), rule.kind == ObjectRule::Kind::range ? 1.5 : 0.5 + 1e-6) << n;
        ASSERT_GT(boundary.points[n][a], expected[n].ends[0]);
        ASSERT_LT(boundary.points[n][a], expected[n].ends[1]);
      } else {
        ASSERT_EQ(boundary.points[n][a], at) << n;
      }
    }
  }
  const std::set<LatticePoint> different(boundary.points.begin(), boundary.points.end());
  EXPECT_EQ(different.size(), boundary.points.size());
}

TEST(Boundary, OneSampleHasSixPointsHalfWay) {
  const Volume volume = zeros({3, 3, 3}, {{{1, 1, 1}, 2.0}});
  const BoundaryPoints boundary = boundary_of(volume, phantoms::threshold(1));
  const std::int32_t step = boundary.lattice.plane(0, 1) - boundary.lattice.plane(0, 0);
  const std::int32_t c = 2 * step, h = step / 2;
  EXPECT_EQ(boundary.points,
            (std::vector<LatticePoint>{
                {c, c, c - h}, {c, c - h, c}, {c - h, c, c}, {c + h, c, c}, {c, c + h, c}, {c, c, c + h}}));
  EXPECT_FALSE(boundary.touches_border);
}

TEST(Boundary, InterpolatesLinearly) {
  const Volume volume = zeros({3, 1, 1}, {{{1, 0, 0}, 10.0}, {{2, 0, 0}, 12.0}});
  const BoundaryPoints boundary = boundary_of(volume, phantoms::threshold(2.5, Border::open));
  const std::int32_t step = boundary.lattice.plane(0, 1) - boundary.lattice.plane(0, 0);
  ASSERT_EQ(boundary.points.size(), 1U);
  EXPECT_EQ(boundary.points[0].x, std::lround(1.25 * step));
  EXPECT_TRUE(boundary.touches_border);
}

TEST(Boundary, ASampleAtTheIsoValueHasSixPointsOneUnitAway) {
  const Volume volume = zeros({3, 3, 3}, {{{1, 1, 1}, 1.0}});
  const BoundaryPoints boundary = boundary_of(volume, phantoms::threshold(1));
  const std::int32_t c = boundary.lattice.plane(0, 1);
  EXPECT_EQ(boundary.points,
            (std::vector<LatticePoint>{
                {c, c, c - 1}, {c, c - 1, c}, {c - 1, c, c}, {c + 1, c, c}, {c, c + 1, c}, {c, c, c + 1}}));
}

TEST(Boundary, ARangeThatIsJumpedOverHasTwoOrderedPoints) {
  for (const bool down : {false, true}) {
    const Volume volume = zeros({2, 1, 1}, {{{down ? 0 : 1, 0, 0}, 8.0}});
    for (const Side side : {Side::above, Side::below}) {
      const BoundaryPoints boundary = boundary_of(volume, phantoms::range(2, 4, Border::open, side));
      const std::int32_t a = boundary.lattice.plane(0, 0), step = boundary.lattice.plane(0, 1) - a;
      ASSERT_EQ(boundary.points.size(), 2U);
      EXPECT_EQ(boundary.points[0].x, a + std::lround(down ? 0.5 * step : 0.25 * step));
      EXPECT_EQ(boundary.points[1].x, a + std::lround(down ? 0.75 * step : 0.5 * step));
    }
  }
}

TEST(Boundary, CrossingsOfAnEmptyRangeStayAUnitApart) {
  for (const double iso : {1e-12, 4.0, 8 - 1e-12}) {
    const Volume volume = zeros({2, 1, 1}, {{{1, 0, 0}, 8.0}});
    const BoundaryPoints boundary = boundary_of(volume, phantoms::range(iso, iso, Border::open));
    ASSERT_EQ(boundary.points.size(), 2U);
    EXPECT_EQ(boundary.points[1].x - boundary.points[0].x, 1) << iso;
    EXPECT_GT(boundary.points[0].x, boundary.lattice.plane(0, 0));
    EXPECT_LT(boundary.points[1].x, boundary.lattice.plane(0, 1));
  }
}

TEST(Boundary, AClosedBorderCutsHalfAVoxelBeyondTheLastSample) {
  const Volume volume = zeros({1, 1, 1}, {{{0, 0, 0}, 1.0}});
  const BoundaryPoints closed = boundary_of(volume, phantoms::threshold(0.001));
  const std::int32_t c = closed.lattice.plane(0, 0), h = (c - closed.lattice.plane(0, -1)) / 2;
  EXPECT_EQ(closed.points,
            (std::vector<LatticePoint>{
                {c, c, c - h}, {c, c - h, c}, {c - h, c, c}, {c + h, c, c}, {c, c + h, c}, {c, c, c + h}}));
  EXPECT_TRUE(closed.touches_border);
  EXPECT_TRUE(boundary_of(volume, phantoms::threshold(0.001, Border::open)).points.empty());
}

TEST(Boundary, FindsWhatTheSlowModelFinds) {
  const std::vector<std::array<std::int32_t, 3>> shapes{{1, 1, 1},  {1, 7, 1},  {2, 2, 2},   {63, 2, 3},
                                                        {64, 3, 2}, {65, 2, 2}, {130, 3, 2}, {5, 6, 7}};
  std::uint64_t seed = 0;
  for (const auto& dims : shapes) {
    for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{0.45, 0.45, 5}, Vec3{3, 1, 7}}) {
      for (const Border border : {Border::closed, Border::open}) {
        for (const Side side : {Side::above, Side::below}) {
          ++seed;
          for (const Volume& volume : {phantoms::noise(grid_of(dims, spacing), 7, seed),
                                       phantoms::noise_with_gaps(grid_of(dims, spacing), 7, seed)}) {
            expect_as_defined(volume, phantoms::threshold(3, border, side));
            expect_as_defined(volume, phantoms::threshold(2.3, border, side));
            expect_as_defined(volume, phantoms::range(2, 4, border, side));
            expect_as_defined(volume, phantoms::range(2.25, 2.75, border, side));
            expect_as_defined(volume, phantoms::range(3, 3, border, side));
            expect_as_defined(volume, phantoms::labels({1, 4}, border, side));
          }
          if (HasFatalFailure()) return;
        }
      }
    }
  }
}

TEST(Boundary, ValuesSoFarApartThatTheirDifferenceOverflowsStillCrossInTheMiddle) {
  const double huge = std::numeric_limits<double>::max();
  const Volume volume = zeros({2, 1, 1}, {{{0, 0, 0}, -huge}, {{1, 0, 0}, huge}});
  const BoundaryPoints boundary = boundary_of(volume, phantoms::threshold(0, Border::open));
  ASSERT_EQ(boundary.points.size(), 1U);
  EXPECT_EQ(2 * boundary.points[0].x, boundary.lattice.plane(0, 0) + boundary.lattice.plane(0, 1));
}

TEST(Boundary, IsHalfWayToNaNAndInfinity) {
  for (const double bad : {kNaN, kInf, -kInf}) {
    const Volume next_to = zeros({5, 3, 3}, {{{1, 1, 1}, 2.0}, {{2, 1, 1}, bad}});
    for (const ObjectRule& rule : {phantoms::threshold(1), phantoms::range(1, 3)}) {
      const BoundaryPoints boundary = boundary_of(next_to, rule);
      ASSERT_EQ(boundary.points.size(), 6U);
      const std::int32_t middle = (boundary.lattice.plane(0, 1) + boundary.lattice.plane(0, 2)) / 2;
      EXPECT_EQ(std::ranges::count(boundary.points, middle, &LatticePoint::x), 1);
    }
    // From above a range to what has no value: both are outside, and nothing says that the range lies between.
    const Volume above = zeros({5, 3, 3}, {{{1, 1, 1}, 9.0}, {{2, 1, 1}, bad}});
    EXPECT_EQ(boundary_of(above, phantoms::range(1, 3)).points.size(), 10U);
  }
}

TEST(Boundary, RefusesMorePointsThanTheLimit) {
  const Volume volume = zeros({3, 3, 3}, {{{1, 1, 1}, 2.0}});
  const ObjectRule rule = phantoms::threshold(1);
  const InsideSamples samples = classify_samples(volume, rule);
  EXPECT_EQ(extract_boundary(volume, rule, samples, 6).points.size(), 6U);
  try {
    extract_boundary(volume, rule, samples, 5);
    FAIL();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::too_large);
  }
}

TEST(Boundary, IsTheSameForEveryThreadCount) {
  const Volume volume = phantoms::noise(grid_of({67, 30, 20}), 9, 77);
  for (const ObjectRule& rule : {phantoms::threshold(4), phantoms::range(3, 5, Border::open)}) {
    const auto expected = boundary_of(volume, rule).points;
    for (unsigned threads = 2; threads <= 4; ++threads) {
      Context context;
      context.threads = threads;
      EXPECT_EQ(boundary_of(volume, rule, context).points, expected);
    }
  }
}

TEST(Boundary, KnowsWhenTheObjectTouchesTheBorder) {
  for (const std::array<std::int32_t, 3> at : {std::array{0, 2, 2}, std::array{4, 2, 2}, std::array{2, 0, 2},
                                               std::array{2, 4, 2}, std::array{2, 2, 0}, std::array{2, 2, 4}})
    EXPECT_TRUE(boundary_of(zeros({5, 5, 5}, {{at, 1.0}}), phantoms::threshold(1)).touches_border);
  EXPECT_FALSE(boundary_of(zeros({5, 5, 5}, {{{2, 3, 1}, 1.0}}), phantoms::threshold(1)).touches_border);
}

TEST(Boundary, AllOrNothingInsideAnOpenBorderHasNoPoints) {
  const Volume volume = zeros({4, 4, 4}, {});
  EXPECT_TRUE(boundary_of(volume, phantoms::threshold(1)).points.empty());
  EXPECT_TRUE(boundary_of(volume, phantoms::threshold(0, Border::open)).points.empty());
  EXPECT_EQ(boundary_of(volume, phantoms::threshold(0)).points.size(), 6U * 16);
}

TEST(Boundary, StopsWhenCancelled) {
  const Volume volume = phantoms::noise(grid_of({20, 20, 20}), 9, 1);
  const ObjectRule rule = phantoms::threshold(4);
  const InsideSamples samples = classify_samples(volume, rule);
  std::stop_source stop;
  stop.request_stop();
  Context context;
  context.cancel = stop.get_token();
  EXPECT_THROW(extract_boundary(volume, rule, samples, 1 << 20, context), Error);
}

}  // namespace
}  // namespace spherule
