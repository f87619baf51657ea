// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/spheres.h"

#include <gtest/gtest.h>

#include <boost/multiprecision/cpp_int.hpp>
#include <cmath>
#include <vector>

#include "core/predicates.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

using Exact = boost::multiprecision::cpp_rational;

constexpr std::int32_t kLast = (1 << Lattice::coordinate_bits) - 1;

// The centre's offset from the first corner by Cramer's rule on 2 (p - a)·x = |p - a|², in rationals.
std::array<Exact, 3> exact_offset(const std::array<LatticePoint, 4>& t) {
  std::array<std::array<Exact, 4>, 3> m;
  for (std::size_t r = 0; r < 3; ++r) {
    Exact lift = 0;
    for (int a = 0; a < 3; ++a) {
      const Exact d = t[r + 1][a] - t[0][a];
      m[r][static_cast<std::size_t>(a)] = 2 * d;
      lift += d * d;
    }
    m[r][3] = lift;
  }
  const auto det = [&](std::size_t x, std::size_t y, std::size_t z) {
    return Exact(m[0][x] * (m[1][y] * m[2][z] - m[1][z] * m[2][y]) - m[0][y] * (m[1][x] * m[2][z] - m[1][z] * m[2][x]) +
                 m[0][z] * (m[1][x] * m[2][y] - m[1][y] * m[2][x]));
  };
  const Exact d = det(0, 1, 2);
  return {det(3, 1, 2) / d, det(0, 3, 2) / d, det(0, 1, 3) / d};
}

TEST(Circumsphere, OfARegularTetrahedron) {
  const Sphere s = circumsphere({{{0, 0, 0}, {2, 2, 0}, {2, 0, 2}, {0, 2, 2}}});
  EXPECT_EQ(s.centre, (Vec3{1, 1, 1}));
  EXPECT_EQ(s.radius, std::sqrt(3.0));
}

TEST(Circumsphere, OfARightCornerHasTheHypotenusesInItsMiddle) {
  const Sphere s = circumsphere({{{5, 5, 5}, {9, 5, 5}, {5, 11, 5}, {5, 5, 17}}});
  EXPECT_EQ(s.centre, (Vec3{7, 8, 11}));
  EXPECT_EQ(s.radius, 7);
}

TEST(Circumsphere, IsWithinItsErrorBoundForEveryShape) {
  phantoms::Random random(21);
  const auto below = [&](std::int64_t n) {
    return static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(n)));
  };
  int slivers = 0;
  for (int n = 0; n < 3000; ++n) {
    std::array<LatticePoint, 4> t;
    for (auto& p : t) {
      if (n % 3 == 0) p = {below(kLast + 1), below(kLast + 1), below(kLast + 1)};
      // Nearly flat at the far end of the lattice, and small.
      if (n % 3 == 1) p = {below(kLast + 1), below(kLast + 1), kLast - below(2)};
      if (n % 3 == 2) p = {kLast - below(40), below(40), kLast / 2 + below(40)};
    }
    const int o = exact::orientation(t[0], t[1], t[2], t[3]);
    if (o == 0) continue;
    if (o < 0) std::swap(t[0], t[1]);
    const auto offset = exact_offset(t);
    const Sphere s = circumsphere(t);
    Exact least = -1;
    for (int a = 0; a < 3; ++a) {
      const auto& x = offset[static_cast<std::size_t>(a)];
      // 2^-50 for the offset, and one rounding when it is added to the corner.
      const Exact error = abs(Exact(s.centre[a]) - (x + t[0][a]));
      ASSERT_LE(error, abs(x) * Exact(0x1p-50) + abs(x + t[0][a]) * Exact(0x1p-52)) << n;
    }
    slivers += s.radius > 1e9;
    for (const LatticePoint p : t) {
      Exact d = 0;
      for (int a = 0; a < 3; ++a) {
        const Exact c = offset[static_cast<std::size_t>(a)] + t[0][a] - p[a];
        d += c * c;
      }
      if (least < 0 || d < least) least = d;
    }
    // All four corners are at the true radius R. Of the computed centre's offset each component is off by 2^-50 R, so
    // each distance by less than 2 · 2^-50 R, and by little more after the square and the root.
    ASSERT_NEAR(s.radius, std::sqrt(least.convert_to<double>()), s.radius * 0x1p-48) << n;
  }
  EXPECT_GT(slivers, 100);
}

struct Built {
  Volume volume;
  ObjectRule rule;
  InsideSamples samples;
  SphereModel model;
};
Built build(const Volume& volume, const ObjectRule& rule, const Context& context = {}) {
  Built built{volume, rule, classify_samples(volume, rule), {}};
  auto boundary = extract_boundary(volume, rule, built.samples);
  auto cells = tetrahedralize(boundary.points);
  built.model = classify_spheres(volume, rule, built.samples, std::move(boundary), std::move(cells), context);
  return built;
}

// Trilinear interpolation as nested linear ones.
double interpolate(const Volume& volume, const std::array<std::int32_t, 3>& s, Vec3 t, auto&& value) {
  const auto mix = [](double a, double b, double w) { return a + (b - a) * w; };
  std::array<double, 4> along_x;
  for (std::int32_t c = 0; c < 4; ++c)
    along_x[static_cast<std::size_t>(c)] =
        mix(value(volume, s[0], s[1] + c % 2, s[2] + c / 2), value(volume, s[0] + 1, s[1] + c % 2, s[2] + c / 2), t.x);
  return mix(mix(along_x[0], along_x[1], t.y), mix(along_x[2], along_x[3], t.y), t.z);
}

// Tests every sample (with a closed border: and those around the grid) against every sphere. Returns how many cells
// were decided by {a sample, interpolation}.
std::array<int, 2> expect_as_defined(const Built& built) {
  const auto& [boundary, cells, inside_count] = *built.model.solid;
  const Lattice& lattice = boundary.lattice;
  const auto n = built.volume.grid.dims;
  const std::int32_t margin = built.rule.border == Border::closed ? 1 : 0;
  std::array<int, 2> decided{};
  EXPECT_TRUE(std::is_sorted(cells.begin(), cells.begin() + static_cast<std::ptrdiff_t>(inside_count)));
  EXPECT_TRUE(std::is_sorted(cells.begin() + static_cast<std::ptrdiff_t>(inside_count), cells.end()));
  EXPECT_EQ(built.model.spheres.size(), inside_count);
  for (std::size_t c = 0; c < cells.size(); ++c) {
    const bool claimed = c < inside_count;
    const std::array<LatticePoint, 4> t{boundary.points[cells[c][0]], boundary.points[cells[c][1]],
                                        boundary.points[cells[c][2]], boundary.points[cells[c][3]]};
    int in = 0, out = 0;
    for (std::int32_t k = -margin; k < n[2] + margin; ++k) {
      for (std::int32_t j = -margin; j < n[1] + margin; ++j) {
        for (std::int32_t i = -margin; i < n[0] + margin; ++i) {
          const LatticePoint p{lattice.plane(0, i), lattice.plane(1, j), lattice.plane(2, k)};
          if (exact::in_sphere(t[0], t[1], t[2], t[3], p) > 0)
            ++(built.samples.inside.test_or_outside(i, j, k) ? in : out);
        }
      }
    }
    EXPECT_TRUE(in == 0 || out == 0) << "samples in one empty ball disagree";
    if (in + out > 0) {
      ++decided[0];
      EXPECT_EQ(claimed, in > 0);
      continue;
    }
    const auto offset = exact_offset(t);
    std::array<std::int32_t, 3> low;
    Vec3 weight;
    bool within = true, padding = false;
    for (int a = 0; a < 3; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      const double centre = Exact(offset[axis] + t[0][a]).convert_to<double>();
      within &= centre >= lattice.plane(a, -margin) && centre <= lattice.plane(a, n[axis] - 1 + margin);
      low[axis] = -margin;
      while (low[axis] + 2 < n[axis] + margin && centre >= lattice.plane(a, low[axis] + 1)) ++low[axis];
      const double lo = lattice.plane(a, low[axis]), hi = lattice.plane(a, low[axis] + 1);
      weight[a] = (centre - lo) / (hi - lo);
      padding |= low[axis] < 0 || low[axis] + 1 >= n[axis];
    }
    if (!within) {
      EXPECT_FALSE(claimed);
      continue;
    }
    if (padding) continue;
    const bool by_label = built.rule.kind == ObjectRule::Kind::labels;
    const double value = interpolate(built.volume, low, weight, [&](const Volume& v, auto i, auto j, auto k) {
      return by_label ? (built.samples.inside.test(i, j, k) ? 1.0 : 0.0) : value_at(v, i, j, k);
    });
    double depth = by_label ? value - 0.5 : value - built.rule.lo;
    if (built.rule.kind == ObjectRule::Kind::range) depth = std::min(depth, built.rule.hi - value);
    if (built.rule.side == Side::below && !by_label) depth = -depth;
    // Closer than rounding the computation is free to go either way.
    if (std::abs(depth) < 1e-6) continue;
    ++decided[1];
    EXPECT_EQ(claimed, depth > 0) << depth;
  }
  return decided;
}

TEST(Classification, IsWhatEverySampleInTheBallSays) {
  std::array<int, 2> decided{};
  std::uint64_t seed = 100;
  for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{1, 1, 2}, Vec3{0.45, 0.45, 5}, Vec3{3, 1, 7}}) {
    for (const Border border : {Border::closed, Border::open}) {
      for (const Side side : {Side::above, Side::below}) {
        const Grid grid{.dims = {5, 6, 4}, .spacing = spacing, .origin = {}, .direction = {}};
        const Volume volume = phantoms::noise(grid, 9, ++seed);
        for (const ObjectRule& rule :
             {phantoms::threshold(4, border, side), phantoms::threshold(2.3, border, side),
              phantoms::range(2.5, 5.5, border, side), phantoms::labels({1, 2, 7}, border, side)}) {
          const auto d = expect_as_defined(build(volume, rule));
          for (std::size_t i = 0; i < 2; ++i) decided[i] += d[i];
        }
      }
    }
  }
  EXPECT_GT(decided[0], 5000);
  EXPECT_GT(decided[1], 500);
}

TEST(Classification, IsTheSameForEveryThreadCount) {
  const Volume volume = phantoms::noise(phantoms::cubic_grid(24, 23), 9, 1);
  const Built expected = build(volume, phantoms::threshold(5));
  for (unsigned threads = 2; threads <= 4; ++threads) {
    Context context;
    context.threads = threads;
    const Built built = build(volume, phantoms::threshold(5), context);
    EXPECT_EQ(built.model.spheres, expected.model.spheres);
    EXPECT_EQ(built.model.solid->cells, expected.model.solid->cells);
    EXPECT_EQ(built.model.solid->inside_count, expected.model.solid->inside_count);
  }
}

TEST(Model, OfOneSampleIsOneBallFourTimes) {
  Grid grid{.dims = {1, 1, 1}, .spacing = {2, 2, 2}, .origin = {10, 20, 30}, .direction = {}};
  const Built built = build(phantoms::noise(grid, 1, 0), phantoms::labels({0}));
  // An octahedron is cut into four tetrahedra around one of its diagonals.
  ASSERT_EQ(built.model.spheres.size(), 4U);
  for (const Sphere& s : built.model.spheres) EXPECT_EQ(s, (Sphere{{10, 20, 30}, 1}));
  EXPECT_NEAR(boundary_point_density(*built.model.solid), std::sqrt(2.0), 1e-12);
  const Box box = bounds(built.model);
  EXPECT_NEAR(norm(box.min - Vec3{9, 19, 29}), 0, 1e-9);
  EXPECT_NEAR(norm(box.max - Vec3{11, 21, 31}), 0, 1e-9);
}

TEST(Model, BoundsOfASetOfBallsAreThoseOfTheBalls) {
  SphereModel model;
  EXPECT_TRUE(bounds(model).empty());
  model.spheres = {{{0, 0, 0}, 2}, {{5, 0, 0}, 1}};
  EXPECT_EQ(bounds(model).min, (Vec3{-2, -2, -2}));
  EXPECT_EQ(bounds(model).max, (Vec3{6, 2, 2}));
}

TEST(Density, IsTheLargestDistanceToTheNearestOtherPoint) {
  const Built built = build(phantoms::noise(phantoms::cubic_grid(9, 8), 5, 3), phantoms::threshold(2.5));
  const auto& points = built.model.solid->boundary.points;
  double expected = 0;
  for (const LatticePoint p : points) {
    double nearest = HUGE_VAL;
    for (const LatticePoint q : points) {
      const double d = std::hypot(p.x - q.x, p.y - q.y, p.z - q.z);
      if (d > 0) nearest = std::min(nearest, d);
    }
    expected = std::max(expected, nearest);
  }
  EXPECT_NEAR(boundary_point_density(*built.model.solid), expected * built.model.solid->boundary.lattice.unit_mm, 1e-9);
  EXPECT_EQ(boundary_point_density(Solid{}), 0);
}

}  // namespace
}  // namespace spherule
