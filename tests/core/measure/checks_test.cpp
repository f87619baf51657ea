// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/checks.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <optional>

#include "core/predicates.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

struct Built {
  InsideSamples samples;
  Border border;
  SphereModel model;
  ModelChecks checks(const Context& context = {}) const { return check_model(model, samples.inside, border, context); }
};

// Nothing where the object has no solid.
std::optional<Built> build(const Volume& volume, const ObjectRule& rule) {
  Built built{classify_samples(volume, rule), rule.border, {}};
  auto boundary = extract_boundary(volume, rule, built.samples);
  auto cells = tetrahedralize(boundary.points);
  if (cells.empty()) return std::nullopt;
  built.model = classify_spheres(volume, rule, built.samples, std::move(boundary), std::move(cells));
  return built;
}

Grid grid_of(std::array<std::int32_t, 3> dims, Vec3 spacing = {1, 1, 1}) {
  return {.dims = dims, .spacing = spacing, .origin = {}, .direction = {}};
}

constexpr std::array<Vec3, 6> kSpacings{Vec3{1, 1, 1},  Vec3{1, 1, 2}, Vec3{1, 1, 5},
                                        Vec3{1, 1, 10}, Vec3{3, 1, 7}, Vec3{0.45, 0.45, 5}};
constexpr std::array<std::array<std::int32_t, 3>, 7> kShapes{
    {{1, 1, 1}, {1, 6, 1}, {2, 2, 2}, {1, 9, 9}, {5, 6, 4}, {9, 8, 7}, {65, 2, 3}}};

// Calls visit(volume, rule) for noise of many shapes, spacings and seeds, half of the thresholds with ties.
template <typename Visit>
void for_each_case(Border border, int seeds, Visit visit) {
  std::uint64_t seed = 0;
  for (const Vec3 spacing : kSpacings) {
    for (const auto& dims : kShapes) {
      for (int n = 0; n < seeds; ++n) {
        for (const Side side : {Side::above, Side::below}) {
          const Volume volume = phantoms::noise(grid_of(dims, spacing), 9, ++seed);
          for (const ObjectRule& rule :
               {phantoms::threshold(4, border, side), phantoms::threshold(2.3, border, side),
                phantoms::range(2.5, 5.5, border, side), phantoms::labels({1, 2, 7}, border, side)}) {
            visit(volume, rule);
            if (testing::Test::HasFatalFailure()) return;
          }
        }
      }
    }
  }
}

// Samples are covered rightly and balls are empty for every object, spacing and border.
TEST(Checks, CriteriaOneToThreeHoldForEveryObject) {
  int models = 0;
  for (const Border border : {Border::closed, Border::open}) {
    for_each_case(border, 1, [&](const Volume& volume, const ObjectRule& rule) {
      const auto built = build(volume, rule);
      if (!built) return;
      ++models;
      const CriteriaReport criteria = built->checks().criteria;
      ASSERT_EQ(criteria.inside_samples_not_covered, 0U);
      ASSERT_EQ(criteria.outside_samples_covered, 0U);
      ASSERT_EQ(criteria.boundary_points_inside_balls, 0U);
    });
  }
  EXPECT_GT(models, 400);
}

// With a closed border and one crossing on an edge, a point's inside end s is in the hull. The ball over the diameter
// from the point p to s is then empty: balls of equal spacing reach no other grid line nearer than half a voxel beside
// it, and along the grid lines through s and p it is tangent. A larger empty ball through p holds s, so some Delaunay
// ball at p does, and s makes it inside. The same holds while no spacing is more than twice another, and for labels at
// any spacing, because their points beside p are level with it.
TEST(Checks, EveryPointIsOnABallWhereverVoxelsAreNearlyCubicOrLabelled) {
  int models = 0;
  for_each_case(Border::closed, 2, [&](const Volume& volume, const ObjectRule& rule) {
    const Vec3 spacing = volume.grid.spacing;
    const bool nearly_cubic =
        std::max({spacing.x, spacing.y, spacing.z}) <= 2 * std::min({spacing.x, spacing.y, spacing.z});
    const bool labelled = rule.kind == ObjectRule::Kind::labels;
    if (!labelled && (!nearly_cubic || rule.kind == ObjectRule::Kind::range)) return;
    const auto built = build(volume, rule);
    if (!built) return;
    ++models;
    ASSERT_EQ(built->checks().criteria.violations(), 0U);
  });
  EXPECT_GT(models, 150);
}

// The same argument point by point, for every object: a boundary point may miss the inside balls only where it has no
// inside end (a range is jumped over), the inside end is outside the hull (an open border), or another point lies in
// the ball over the diameter between the two (spacings that differ by more than twice).
TEST(Checks, APointOffAllBallsHasAGeometricReason) {
  int missed = 0;
  for (const Border border : {Border::closed, Border::open}) {
    for_each_case(border, 1, [&](const Volume& volume, const ObjectRule& rule) {
      const auto built = build(volume, rule);
      if (!built) return;
      const auto& [boundary, cells, inside_count] = *built->model.solid;
      const auto& points = boundary.points;
      const Lattice& lattice = boundary.lattice;
      std::vector<bool> touched(points.size());
      for (std::size_t c = 0; c < inside_count; ++c) {
        for (const std::uint32_t v : cells[c]) touched[v] = true;
      }
      ASSERT_EQ(built->checks().criteria.boundary_points_on_no_ball,
                static_cast<std::uint64_t>(std::ranges::count(touched, false)));
      const auto adjacent = neighbours(cells, points.size());
      const auto in_hull = [&](LatticePoint s) {
        for (std::size_t c = 0; c < cells.size(); ++c) {
          for (std::size_t i = 0; i < 4; ++i) {
            if (adjacent[c][i] != no_cell) continue;
            std::array<LatticePoint, 4> t;
            for (std::size_t v = 0; v < 4; ++v) t[v] = v == i ? s : points[cells[c][v]];
            if (exact::orientation(t[0], t[1], t[2], t[3]) < 0) return false;
          }
        }
        return true;
      };
      for (std::size_t n = 0; n < points.size(); ++n) {
        if (touched[n]) continue;
        ++missed;
        // The ends of the edge that the point is on.
        std::array<std::array<std::int32_t, 3>, 2> ends;
        for (int axis = 0; axis < 3; ++axis) {
          const auto a = static_cast<std::size_t>(axis);
          const auto& planes = lattice.planes[a];
          const auto at_or_above = std::ranges::lower_bound(planes, points[n][axis]);
          ends[1][a] = static_cast<std::int32_t>(at_or_above - planes.begin()) - 1;
          ends[0][a] = *at_or_above == points[n][axis] ? ends[1][a] : ends[1][a] - 1;
        }
        for (const auto& e : ends) {
          if (!built->samples.inside.test_or_outside(e[0], e[1], e[2])) continue;
          using exact::operator-;
          const LatticePoint p = points[n], s{lattice.plane(0, e[0]), lattice.plane(1, e[1]), lattice.plane(2, e[2])};
          const bool ball_is_empty = std::ranges::none_of(points, [&](LatticePoint q) {
            const auto a = q - p, b = q - s;
            return q != p && a.x * b.x + a.y * b.y + a.z * b.z <= 0;
          });
          ASSERT_FALSE(ball_is_empty && in_hull(s));
        }
      }
    });
  }
  EXPECT_GT(missed, 100);
}

// The smallest of these: two columns of flat voxels, 8 below 12 and 9 below 19. The lower point of the second column is
// shadowed by the higher one of the first: none of its balls reaches a sample, and all their centres lie beside the
// object, where interpolation says outside.
TEST(Checks, FlatVoxelsCanLeaveAPointOffAllBalls) {
  Volume volume = phantoms::noise(grid_of({2, 1, 2}, {1, 1, 3}), 1, 0);
  phantoms::set_stored(volume, {0, 0, 0}, 8);
  phantoms::set_stored(volume, {1, 0, 0}, 9);
  phantoms::set_stored(volume, {0, 0, 1}, 12);
  phantoms::set_stored(volume, {1, 0, 1}, 19);
  const auto flat = build(volume, phantoms::threshold(10));
  ASSERT_TRUE(flat);
  EXPECT_EQ(flat->checks().criteria.boundary_points_on_no_ball, 1U);
  volume.grid.spacing = {1, 1, 2};
  EXPECT_EQ(build(volume, phantoms::threshold(10))->checks().criteria.boundary_points_on_no_ball, 0U);
}

TEST(Checks, BoundsHoldAndDescribeTheModel) {
  for_each_case(Border::closed, 1, [&](const Volume& volume, const ObjectRule& rule) {
    const auto built = build(volume, rule);
    if (!built) return;
    const ModelChecks checks = built->checks();
    ASSERT_EQ(checks.bounds.density_mm, boundary_point_density(*built->model.solid));
    ASSERT_LE(checks.bounds.density_mm, checks.bounds.density_bound_mm);
    ASSERT_LE(checks.bounds.tetrahedra_volume_mm3, checks.bounds.spheres_volume_bound_mm3);
    ASSERT_EQ(checks.bounds.cells_per_point, static_cast<double>(built->model.solid->inside_count) /
                                                 static_cast<double>(built->model.solid->boundary.points.size()));
  });
}

TEST(Checks, AreTheSameForEveryThreadCount) {
  const auto built = build(phantoms::noise(grid_of({20, 21, 22}), 9, 4), phantoms::range(3, 5, Border::open));
  ASSERT_TRUE(built);
  const ModelChecks expected = built->checks();
  for (unsigned threads = 2; threads <= 4; ++threads) {
    Context context;
    context.threads = threads;
    const ModelChecks checks = built->checks(context);
    EXPECT_EQ(checks.criteria.violations(), expected.criteria.violations());
    EXPECT_EQ(checks.bounds.density_mm, expected.bounds.density_mm);
    EXPECT_EQ(checks.bounds.tetrahedra_volume_mm3, expected.bounds.tetrahedra_volume_mm3);
  }
}

// Counts by definition: every sample of the padded grid against every claimed ball.
CriteriaReport slow_criteria(const Built& built) {
  const auto& [boundary, cells, inside_count] = *built.model.solid;
  const auto& points = boundary.points;
  const Lattice& lattice = boundary.lattice;
  const auto n = lattice.grid.dims;
  CriteriaReport report;
  for (std::int32_t k = -1; k <= n[2]; ++k) {
    for (std::int32_t j = -1; j <= n[1]; ++j) {
      for (std::int32_t i = -1; i <= n[0]; ++i) {
        bool covered = false;
        for (std::size_t c = 0; c < inside_count; ++c) {
          const auto& t = cells[c];
          covered |= exact::in_sphere(points[t[0]], points[t[1]], points[t[2]], points[t[3]],
                                      {lattice.plane(0, i), lattice.plane(1, j), lattice.plane(2, k)}) > 0;
        }
        const bool inside = built.samples.inside.test_or_outside(i, j, k);
        report.inside_samples_not_covered += inside && !covered;
        report.outside_samples_covered += !inside && covered;
      }
    }
  }
  return report;
}

// Every way in which a model can be wrong, on models that are made wrong on purpose.
TEST(Checks, CountWhatIsWrongWithABrokenModel) {
  phantoms::Random random(8);
  std::uint64_t uncovered = 0, covered = 0;
  for (std::uint64_t seed = 0; seed < 40; ++seed) {
    const Vec3 spacing = kSpacings[seed % kSpacings.size()];
    auto built = build(phantoms::noise(grid_of({5, 4, 4}, spacing), 9, seed), phantoms::threshold(4.5));
    ASSERT_TRUE(built);
    Solid& solid = *built->model.solid;
    // Forget some inside cells and claim some outside ones.
    for (auto keep = solid.inside_count / 10 + 1; solid.inside_count > keep;) {
      const std::size_t last = solid.inside_count - 1;
      std::swap(solid.cells[random.below(solid.inside_count)], solid.cells[last]);
      solid.inside_count = last;
    }
    for (int n = 0; n < 3; ++n) {
      const std::size_t chosen = solid.inside_count + random.below(solid.cells.size() - solid.inside_count);
      std::swap(solid.cells[chosen], solid.cells[solid.inside_count]);
      ++solid.inside_count;
    }
    const CriteriaReport expected = slow_criteria(*built), found = built->checks().criteria;
    ASSERT_EQ(found.inside_samples_not_covered, expected.inside_samples_not_covered) << seed;
    ASSERT_EQ(found.outside_samples_covered, expected.outside_samples_covered) << seed;
    uncovered += expected.inside_samples_not_covered;
    covered += expected.outside_samples_covered;
  }
  EXPECT_GT(uncovered, 40U);
  EXPECT_GT(covered, 40U);
}

TEST(Checks, ReportAnEmptyClaimAndAMovedPoint) {
  Volume volume = phantoms::noise(grid_of({3, 3, 3}), 1, 0);
  phantoms::set_stored(volume, {1, 1, 1}, 1);
  auto built = build(volume, phantoms::threshold(1));
  ASSERT_TRUE(built);
  EXPECT_EQ(built->checks().criteria.violations(), 0U);
  built->model.solid->inside_count = 0;
  EXPECT_EQ(built->checks().criteria.inside_samples_not_covered, 1U);
  EXPECT_EQ(built->checks().criteria.boundary_points_on_no_ball, 6U);

  auto moved = build(phantoms::noise(grid_of({4, 4, 4}), 9, 2), phantoms::threshold(4.5));
  ASSERT_TRUE(moved);
  auto& points = moved->model.solid->boundary.points;
  points[points.size() / 2].x += 1 << 18;
  EXPECT_GT(moved->checks().criteria.boundary_points_inside_balls, 0U);
}

}  // namespace
}  // namespace spherule
