// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/ball_cell.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/trees/box_tree.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

struct Plane {
  Vec3 normal;
  double offset;
};

BallPiece measure(double radius, const std::vector<Plane>& planes) {
  BallCell cell;
  cell.reset(radius);
  for (const Plane& p : planes)
    if (!cell.cut(p.normal, p.offset)) break;
  return cell.measure(radius);
}

TEST(BallCell, WholeBall) {
  const BallPiece piece = measure(2, {});
  EXPECT_NEAR(piece.moments.volume, 32 * kPi / 3, 1e-13);
  EXPECT_NEAR(piece.area, 16 * kPi, 1e-13);
  EXPECT_EQ(norm(piece.push), 0);
}

TEST(BallCell, OnePlane) {
  for (const double offset : {-1.9, -0.5, 0.0, 0.7, 1.99}) {
    const Vec3 n = normalised({1, -2, 0.5});
    const BallPiece piece = measure(2, {{n, offset}});
    const double height = 2 + offset, disk = kPi * (4 - offset * offset);
    EXPECT_NEAR(piece.moments.volume, kPi * height * height * (6 - height) / 3, 1e-12) << offset;
    EXPECT_NEAR(piece.area, 4 * kPi * height, 1e-12) << offset;
    EXPECT_NEAR(norm(piece.push + disk * n), 0, 1e-12) << offset;
    // The first moment of a cap: -π/4 (r² - h²)² along the normal.
    EXPECT_NEAR(dot(piece.moments.first, n), -kPi / 4 * std::pow(4 - offset * offset, 2), 1e-12) << offset;
  }
}

TEST(BallCell, PlanesThroughTheCentre) {
  const Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};
  const BallPiece wedge = measure(1, {{-x, 0}, {normalised(x - y), 0}});
  EXPECT_NEAR(wedge.moments.volume, 4 * kPi / 3 / 8, 1e-14);
  EXPECT_NEAR(wedge.area, 4 * kPi / 8, 1e-14);
  const BallPiece octant = measure(1, {{-x, 0}, {-y, 0}, {-z, 0}});
  EXPECT_NEAR(octant.moments.volume, kPi / 6, 1e-14);
  EXPECT_NEAR(octant.area, kPi / 2, 1e-14);
  EXPECT_NEAR(octant.moments.first.x, kPi / 16, 1e-14);
  EXPECT_NEAR(octant.moments.second.rows[0].x, 4 * kPi / 15 / 8, 1e-14);
  EXPECT_NEAR(octant.moments.second.rows[0].y, 1.0 / 15, 1e-14);
}

TEST(BallCell, CellsWithinAndBeyondTheBall) {
  const Vec3 x{1, 0, 0}, y{0, 1, 0}, z{0, 0, 1};
  const BallPiece cube = measure(2, {{x, 0.5}, {-x, 0.5}, {y, 0.5}, {-y, 0.5}, {z, 0.5}, {-z, 0.5}});
  EXPECT_NEAR(cube.moments.volume, 1, 1e-13);
  EXPECT_NEAR(cube.area, 0, 1e-13);
  EXPECT_NEAR(cube.moments.second.rows[1].y, 1.0 / 12, 1e-13);
  EXPECT_EQ(measure(1, {{x, -1.0}}).moments.volume, 0) << "touches";
  // A corner of the cell that is outside the ball, though each of its planes cuts the ball.
  const BallPiece beyond = measure(1, {{-x, -0.8}, {-y, -0.8}});
  EXPECT_EQ(beyond.moments.volume, 0);
  EXPECT_EQ(beyond.area, 0);
}

TEST(BallCell, PlanesThatMeetOnTheSphere) {
  // All through the pole, as the planes of a raw model's cells meet in boundary points. A pyramid of 12 sides with its
  // apex there is cut once more by planes that only touch the apex, in an order that rounding decides.
  const int n = 12;
  std::vector<Plane> planes;
  for (int i = 0; i < n; ++i) {
    const double a = 2 * kPi * i / n;
    const Vec3 normal = normalised({std::cos(a), std::sin(a), 0.75});
    planes.push_back({normal, normal.z});
  }
  const BallPiece pyramid = measure(1, planes);
  for (int i = 0; i < 2 * n; ++i) {
    const double a = kPi * i / n + 0.05;
    const Vec3 normal = normalised({std::cos(a), std::sin(a), 3});
    planes.push_back({normal, normal.z});
  }
  const BallPiece again = measure(1, planes);
  EXPECT_NEAR(again.moments.volume, pyramid.moments.volume, 1e-10);
  EXPECT_NEAR(again.area, pyramid.area, 1e-10);
}

// However the cell starts, its planes alone count.
TEST(BallCell, StartsAsTetrahedronOrBox) {
  const std::array<Vec3, 4> corners{{{0.2, -0.1, -0.3}, {0.1, 0.5, -0.2}, {0.6, 0.1, -0.1}, {0.2, 0.1, 0.4}}};
  const std::array<double, 4> outwards{0, 0.3, 0, 0.2};
  const std::array<std::array<std::size_t, 3>, 4> faces{{{1, 3, 2}, {0, 2, 3}, {0, 3, 1}, {0, 1, 2}}};
  std::vector<Plane> planes;
  Box box;
  for (std::size_t f = 0; f < 4; ++f) {
    const Vec3 a = corners[faces[f][0]], b = corners[faces[f][1]], c = corners[faces[f][2]];
    const Vec3 normal = normalised(cross(b - a, c - a));
    planes.push_back({normal, dot(normal, a) + outwards[f]});
    ASSERT_LT(dot(normal, corners[f]), planes.back().offset) << "face " << f << " is seen from outside";
  }
  box.include(Vec3{-1, -1, -1});
  box.include(Vec3{1, 1, 1});
  const BallPiece expected = measure(0.7, planes);
  ASSERT_GT(expected.moments.volume, 0.01);
  BallCell tetrahedron, cut_box;
  tetrahedron.reset(corners, outwards, {0.2, 0.1, 0});
  cut_box.reset(box, {});
  for (const Plane& p : planes) ASSERT_TRUE(cut_box.cut(p.normal, p.offset));
  for (BallCell* cell : {&tetrahedron, &cut_box}) {
    const BallPiece piece = cell->measure(0.7);
    EXPECT_NEAR(piece.moments.volume, expected.moments.volume, 1e-14);
    EXPECT_NEAR(piece.area, expected.area, 1e-14);
    EXPECT_EQ(piece.corners, expected.corners);
    EXPECT_EQ(piece.characteristic, expected.characteristic);
  }
}

TEST(BallCell, ManyCutsInAnyOrderLeaveTheSame) {
  // A polyhedron of 200 sides around the ball of radius 0.9, whose corners are all out of the unit ball or in it, by
  // turns; planes that come first lose most of their corners to later ones.
  phantoms::Random random(11);
  std::vector<Plane> planes;
  for (int i = 0; i < 200; ++i) {
    const Vec3 v{2 * random.unit() - 1, 2 * random.unit() - 1, 2 * random.unit() - 1};
    if (squared_norm(v) < 0.01) continue;
    planes.push_back({normalised(v), 0.9});
  }
  const BallPiece piece = measure(1, planes);
  std::ranges::reverse(planes);
  const BallPiece again = measure(1, planes);
  std::ranges::sort(planes, {}, [](const Plane& p) { return p.normal.x; });
  const BallPiece swept = measure(1, planes);
  for (const BallPiece& other : {again, swept}) {
    EXPECT_NEAR(other.moments.volume, piece.moments.volume, 1e-13);
    EXPECT_NEAR(other.area, piece.area, 1e-12);
    EXPECT_EQ(other.characteristic, piece.characteristic);
    EXPECT_EQ(other.corners, piece.corners);
  }
  // Beyond the reach nothing is cut.
  BallCell cell;
  cell.reset(1);
  for (const Plane& p : planes) ASSERT_TRUE(cell.cut(p.normal, p.offset));
  ASSERT_TRUE(cell.cut({0, 0, 1}, 50));
  EXPECT_LT(cell.reach(), 2);
  EXPECT_FALSE(cell.cut({0, 0, 1}, -50));
  EXPECT_TRUE(cell.empty());
  EXPECT_EQ(cell.measure(1).moments.volume, 0);
}

TEST(BallCell, AgreesWithSampling) {
  phantoms::Random random(7);
  const auto direction = [&] {
    for (;;) {
      const Vec3 v{2 * random.unit() - 1, 2 * random.unit() - 1, 2 * random.unit() - 1};
      if (squared_norm(v) < 1 && squared_norm(v) > 0.01) return normalised(v);
    }
  };
  for (int trial = 0; trial < 60; ++trial) {
    std::vector<Plane> planes(1 + random.below(8));
    for (Plane& p : planes) p = {direction(), 1.3 * random.unit() - 0.2};
    const BallPiece piece = measure(1, planes);
    const auto kept = [&](Vec3 v) {
      return std::ranges::all_of(planes, [&](const Plane& p) { return dot(p.normal, v) <= p.offset; });
    };
    const int samples = 20'000;
    int in_ball = 0, on_sphere = 0;
    for (int s = 0; s < samples; ++s) {
      const Vec3 d = direction();
      on_sphere += kept(d);
      in_ball += kept(std::cbrt(random.unit()) * d);
    }
    // Five standard deviations.
    const double noise = 5 * 0.5 / std::sqrt(samples);
    EXPECT_NEAR(piece.moments.volume / (4 * kPi / 3), in_ball / double(samples), noise) << trial;
    EXPECT_NEAR(piece.area / (4 * kPi), on_sphere / double(samples), noise) << trial;
  }
}

TEST(CapBox, HoldsTheCapTightly) {
  phantoms::Random random(8);
  for (int trial = 0; trial < 40; ++trial) {
    const Vec3 n = normalised({random.unit() - 0.5, random.unit() - 0.5, random.unit() - 0.4});
    const double offset = 1.9 * random.unit() - 0.95;
    const Box box = cap_box(1, n, offset);
    Box seen;
    for (int s = 0; s < 20'000; ++s) {
      const Vec3 v{2 * random.unit() - 1, 2 * random.unit() - 1, 2 * random.unit() - 1};
      if (squared_norm(v) > 1 || dot(n, v) < offset) continue;
      seen.include(v);
      for (int a = 0; a < 3; ++a) ASSERT_TRUE(box.min[a] <= v[a] && v[a] <= box.max[a]);
    }
    if (seen.empty()) continue;
    for (int a = 0; a < 3; ++a) {
      EXPECT_NEAR(seen.min[a], box.min[a], 0.35);
      EXPECT_NEAR(seen.max[a], box.max[a], 0.35);
    }
  }
}

TEST(BoxTree, FindsWhatBruteForceFinds) {
  phantoms::Random random(9);
  for (const std::size_t count : {0U, 1U, 7U, 8U, 9U, 500U}) {
    std::vector<Box> boxes(count);
    for (Box& b : boxes) {
      const Vec3 at{random.unit(), random.unit(), random.unit()};
      const double size = random.below(10) == 0 ? 0.5 : 0.05 * random.unit();
      b.include(at);
      b.include(at + Vec3{size, 0.5 * size, 2 * size});
    }
    const BoxTree tree(boxes);
    for (int query = 0; query < 30; ++query) {
      Box asked;
      asked.include(Vec3{random.unit(), random.unit(), random.unit()});
      asked.include(asked.min + 0.2 * Vec3{random.unit(), random.unit(), random.unit()});
      std::vector<std::uint32_t> found, expected;
      tree.for_each_overlap(asked, [&](std::size_t place) { found.push_back(tree.order()[place]); });
      for (std::uint32_t b = 0; b < count; ++b)
        if (overlap(boxes[b], asked)) expected.push_back(b);
      std::ranges::sort(found);
      EXPECT_EQ(found, expected);
    }
    for (std::size_t n = 0; n < count; ++n) {
      const Box& asked = boxes[tree.order()[n]];
      std::vector<std::uint32_t> leaves, found, expected;
      tree.find_leaves(tree.bounds(n / BoxTree::kFan), leaves);
      tree.for_each_overlap(leaves, asked, [&](std::size_t place) { found.push_back(tree.order()[place]); });
      for (std::uint32_t b = 0; b < count; ++b)
        if (overlap(boxes[b], asked)) expected.push_back(b);
      std::ranges::sort(found);
      EXPECT_EQ(found, expected);
    }
  }
}

}  // namespace
}  // namespace spherule
