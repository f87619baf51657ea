// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls that touch, or nearly: one exact test decides what is joined, for components and for topology.
#include <gtest/gtest.h>

#include <array>
#include <cmath>
#include <cstdint>
#include <set>
#include <vector>

#include "core/base/int128.h"
#include "core/measure/components.h"
#include "core/measure/power.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

using Betti = std::array<std::int64_t, 3>;

Betti betti_of(const std::vector<Sphere>& balls) { return union_topology(balls).betti; }

std::int64_t pieces_of(const std::vector<Sphere>& balls) {
  const auto first = first_of_component({.spheres = balls, .solid = {}});
  return static_cast<std::int64_t>(std::set(first.begin(), first.end()).size());
}

// Numbers here are whole multiples of this below 8: sums of squares of them fit 128 bits.
constexpr double kGrid = 0x1p-52;
double on_grid(double x) { return std::round(x / kGrid) * kGrid; }

bool meet_exactly(const Sphere& a, const Sphere& b) {
  const auto whole = [](double x) { return static_cast<Int128>(x / kGrid); };
  Int128 squared = 0;
  for (int axis = 0; axis < 3; ++axis) {
    const Int128 d = whole(a.centre[axis]) - whole(b.centre[axis]);
    squared += d * d;
  }
  const Int128 reach = whole(a.radius) + whole(b.radius);
  return squared <= reach * reach;
}

// A ball that touches another one, but for rounding.
Sphere beside(const Sphere& ball, phantoms::Random& random) {
  Vec3 way;
  do way = 2 * Vec3{random.unit(), random.unit(), random.unit()} - Vec3{1, 1, 1};
  while (squared_norm(way) > 1 || squared_norm(way) < 0.01);
  const double radius = on_grid(0.2 + 0.4 * random.unit());
  const Vec3 at = ball.centre + (ball.radius + radius) * normalised(way);
  return {{on_grid(at.x), on_grid(at.y), on_grid(at.z)}, radius};
}
Sphere anywhere(phantoms::Random& random) {
  return {{on_grid(3 + random.unit()), on_grid(3 + random.unit()), on_grid(3 + random.unit())},
          on_grid(0.2 + 0.4 * random.unit())};
}

TEST(Touching, APairWhoseSquaresRoundApart) {
  const std::vector<Sphere> pair{{{0, 0, 0}, 1.2846013396875808}, {{2.6857337778072194, 0, 0}, 1.4011324381196386}};
  EXPECT_TRUE(meet(pair[0], pair[1]));
  EXPECT_EQ(pieces_of(pair), 1);
  EXPECT_EQ(betti_of(pair), (Betti{1, 0, 0}));
}

TEST(Touching, PairsAreJoinedExactlyWhenTheyMeet) {
  phantoms::Random random(1);
  int joined = 0, apart = 0;
  for (int i = 0; i < 401; ++i) {
    const Sphere a = anywhere(random), b = beside(a, random);
    const bool expected = meet_exactly(a, b);
    ++(expected ? joined : apart);
    EXPECT_EQ(meet(a, b), expected) << i;
    EXPECT_EQ(meet(b, a), expected) << i;
    EXPECT_EQ(pieces_of({a, b}), expected ? 1 : 2) << i;
    EXPECT_EQ(betti_of({a, b}), (Betti{expected ? 1 : 2, 0, 0})) << i;
  }
  EXPECT_GT(joined, 50);
  EXPECT_GT(apart, 50);
}

// Trees of balls that touch, nearly: whatever the doubles make of each contact, both count the same pieces, and a ring
// closes only where all its contacts do.
TEST(Touching, PiecesAreTheComponents) {
  phantoms::Random random(2);
  for (int i = 0; i < 200; ++i) {
    std::vector<Sphere> balls{anywhere(random)};
    while (balls.size() < 3 + random.below(10)) balls.push_back(beside(balls[random.below(balls.size())], random));
    const Topology topology = union_topology(balls);
    EXPECT_EQ(topology.betti[0], pieces_of(balls)) << i;
    EXPECT_EQ(topology.euler_characteristic, topology.betti[0] - topology.betti[1] + topology.betti[2]);
    EXPECT_GE(topology.betti[1], 0) << i;
  }
}

TEST(Touching, FromWithinAndPoints) {
  EXPECT_EQ(betti_of({{{0, 0, 0}, 2}, {{1, 0, 0}, 1}}), (Betti{1, 0, 0})) << "touches from within";
  EXPECT_EQ(betti_of({{{0, 0, 0}, 1}, {{1, 0, 0}, 0}}), (Betti{1, 0, 0})) << "a point on a ball";
  EXPECT_EQ(betti_of({{{0, 0, 0}, 1}, {{std::nextafter(1, 2), 0, 0}, 0}}), (Betti{2, 0, 0}));
  EXPECT_EQ(betti_of({{{0, 0, 0}, 0}, {{0, 0, 0}, 0}, {{1, 0, 0}, 0}}), (Betti{2, 0, 0}));
  EXPECT_FALSE(meet({{0, 0, 0}, 1e-170}, {{3e-170, 0, 0}, 1e-170}));
  EXPECT_TRUE(meet({{0, 0, 0}, 1e-170}, {{2e-170, 0, 0}, 1e-170}));
}

// 125 balls that touch along a lattice's 300 edges.
TEST(Touching, OfALattice) {
  std::vector<Sphere> balls;
  for (int i = 0; i < 125; ++i) balls.push_back({{double(i % 5), double(i / 5 % 5), double(i / 25)}, 0.5});
  EXPECT_EQ(betti_of(balls), (Betti{1, 176, 0}));
  EXPECT_EQ(pieces_of(balls), 1);
  for (Sphere& ball : balls) ball.radius = std::nextafter(0.5, 0);
  EXPECT_EQ(betti_of(balls), (Betti{125, 0, 0}));
  EXPECT_EQ(pieces_of(balls), 125);
}

// Balls are closed: what meets in one point alone is whole there.
TEST(Touching, OfManyInOnePointClosesTunnelsAndVoids) {
  const auto corners = [](Vec3 size, double radius) {
    std::vector<Sphere> balls;
    for (int c = 0; c < (size.z > 0 ? 8 : 4); ++c)
      balls.push_back({{c & 1 ? size.x : 0, c & 2 ? size.y : 0, c & 4 ? size.z : 0}, radius});
    return balls;
  };
  // Half of the diagonal of 6 x 8 is 5, of 2 x 4 x 4 it is 3.
  EXPECT_EQ(betti_of(corners({6, 8, 0}, 5)), (Betti{1, 0, 0}));
  EXPECT_EQ(betti_of(corners({6, 8, 0}, std::nextafter(5, 0))), (Betti{1, 1, 0}));
  EXPECT_EQ(betti_of(corners({2, 4, 4}, 3)), (Betti{1, 0, 0}));
  EXPECT_EQ(betti_of(corners({2, 4, 4}, std::nextafter(3, 0))), (Betti{1, 0, 1}));
}

}  // namespace
}  // namespace spherule
