// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/result.h"

#include <gtest/gtest.h>

namespace spherule {
namespace {

using Indices = std::vector<std::uint32_t>;

Sphere ball(double x) { return {{x, 0, 0}, 1}; }

// 0 becomes 1 and 2; 2 becomes 3, 4 and 5 at once, so that level 3 is level 2.
Simplification sample() {
  Simplification s;
  s.spheres = {{ball(0), no_parent, 1, 1}, {ball(1), 0, 2, 4}, {ball(2), 0, 2, 3},
               {ball(3), 2, 4, 4},         {ball(4), 2, 4, 4}, {ball(5), 2, 4, 4}};
  s.member_begin = {0, 0, 2, 2, 4, 5, 6};
  s.members = {1, 6, 0, 5, 3, 2};
  return s;
}

TEST(Simplification, ShowsTheFinestLevelOfAtMostKSpheres) {
  const Simplification s = sample();
  ASSERT_TRUE(is_valid(s, 7));
  EXPECT_EQ(s.last_level(), 4U);
  EXPECT_EQ(shown_at(s, 1), (Indices{0}));
  EXPECT_EQ(shown_at(s, 2), (Indices{1, 2}));
  EXPECT_EQ(shown_at(s, 3), (Indices{1, 2}));
  EXPECT_EQ(shown_at(s, 4), (Indices{1, 3, 4, 5}));
  EXPECT_EQ(shown_at(s, 1000), (Indices{1, 3, 4, 5}));
  EXPECT_EQ(spheres_at(s, 2)[1], ball(2));
}

TEST(Simplification, MembersOfACoarserLevelAreThoseOfItsDescendants) {
  const Simplification s = sample();
  EXPECT_EQ(members_at(s, 1).begin, (Indices{0, 6}));
  EXPECT_EQ(members_at(s, 1).items, (Indices{0, 1, 2, 3, 5, 6}));
  EXPECT_EQ(members_at(s, 3).begin, (Indices{0, 2, 6}));
  EXPECT_EQ(members_at(s, 3).items, (Indices{1, 6, 0, 2, 3, 5}));
  EXPECT_EQ(members_at(s, 4).begin, (Indices{0, 2, 4, 5, 6}));
  EXPECT_EQ(members_at(s, 9).items, (Indices{1, 6, 0, 5, 3, 2}));
}

TEST(Simplification, TreeOfChosenLevels) {
  const Simplification s = sample();
  const std::vector<TreeLevel> tree = tree_of(s, Indices{1, 2, 4});
  ASSERT_EQ(tree.size(), 3U);
  EXPECT_EQ(tree[0].parents, (Indices{no_parent}));
  EXPECT_EQ(tree[1].parents, (Indices{0, 0}));
  EXPECT_EQ(tree[2].parents, (Indices{0, 1, 1, 1}));
  EXPECT_EQ(tree[2].spheres, spheres_at(s, 4));
  EXPECT_EQ(tree_of(s, Indices{1, 4})[1].parents, (Indices{0, 0, 0, 0}));
}

TEST(Simplification, EveryBrokenInvariantIsSeen) {
  const auto broken = [](auto&& change) {
    Simplification s = sample();
    change(s);
    return !is_valid(s, 7);
  };
  EXPECT_TRUE(broken([](auto& s) { s.spheres[3].parent = 4; })) << "a parent after its child";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[3].parent = 0; })) << "a parent that ended before";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[2].to = 4; })) << "five spheres at level 4";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[2].to = 2; })) << "fewer is fine, a gap for the parent is not";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[1].from = 3; })) << "levels out of order";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[5].to = 5; })) << "a level of one sphere at the end";
  EXPECT_TRUE(broken([](auto& s) { s.spheres[0].sphere.radius = -1; })) << "a negative radius";
  EXPECT_TRUE(broken([](auto& s) { s.members[0] = 7; })) << "no such member";
  EXPECT_TRUE(broken([](auto& s) { s.members[0] = 5; })) << "a member twice";
  EXPECT_TRUE(broken([](auto& s) { std::swap(s.members[0], s.members[1]); })) << "members out of order";
  EXPECT_TRUE(broken([](auto& s) { s.member_begin[1] = 1; })) << "a member of a coarser sphere";
  EXPECT_TRUE(broken([](auto& s) { s.member_begin.pop_back(); })) << "no end of the members";
}

}  // namespace
}  // namespace spherule
