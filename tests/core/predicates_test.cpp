// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/predicates.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <boost/multiprecision/cpp_int.hpp>
#include <optional>
#include <set>
#include <vector>

#include "tests/phantoms.h"

namespace spherule {
namespace {

using Big = boost::multiprecision::cpp_int;
using Row = std::vector<Big>;

constexpr std::int32_t kLast = (1 << Lattice::coordinate_bits) - 1;

// By Laplace's expansion: slow, and shares no formula with the code under test.
Big determinant(const std::vector<Row>& m) {
  if (m.size() == 1) return m[0][0];
  Big sum = 0;
  for (std::size_t r = 0; r < m.size(); ++r) {
    std::vector<Row> minor;
    for (std::size_t i = 0; i < m.size(); ++i) {
      if (i != r) minor.emplace_back(m[i].begin() + 1, m[i].end());
    }
    const Big term = m[r][0] * determinant(minor);
    sum += r % 2 == 0 ? term : -term;
  }
  return sum;
}

int orientation_model(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  std::vector<Row> m;
  for (const LatticePoint p : {b, c, d}) m.push_back({Big(p.x) - a.x, Big(p.y) - a.y, Big(p.z) - a.z});
  return determinant(m).sign();
}

// Points lifted to the paraboloid, the n-th largest in lexicographic order by another epsilon^n when perturbed: e is
// inside when it lies below the hyperplane through the others. Cofactors are whole numbers below 2^75, so with an
// epsilon of 2^-80 no term can undo an earlier one.
int in_sphere_model(const std::array<LatticePoint, 5>& points, bool perturb) {
  auto order = points;
  std::ranges::sort(order, std::greater{});
  const auto lift = [&](LatticePoint p) {
    Big value = (Big(p.x) * p.x + Big(p.y) * p.y + Big(p.z) * p.z) << 400;
    if (perturb) value += Big(1) << (400 - 80 * (std::ranges::find(order, p) - order.begin() + 1));
    return value;
  };
  std::vector<Row> m;
  for (const LatticePoint p : points) m.push_back({Big(p.x), Big(p.y), Big(p.z), lift(p), Big(1)});
  return determinant(m).sign();
}

TEST(PredicateModel, IsRightAboutOneClearCase) {
  const LatticePoint a{0, 0, 0}, b{2, 0, 0}, c{0, 2, 0}, d{0, 0, 2};
  EXPECT_EQ(orientation_model(a, b, c, d), 1);
  EXPECT_NE(in_sphere_model({a, b, c, d, {1, 1, 1}}, false), 0);
  EXPECT_EQ(in_sphere_model({a, b, c, d, {9, 9, 9}}, false), -in_sphere_model({a, b, c, d, {1, 1, 1}}, false));
  EXPECT_EQ(in_sphere_model({a, b, c, d, {2, 2, 2}}, false), 0);
}

using Generator = LatticePoint (*)(phantoms::Random&);

std::int32_t below(phantoms::Random& random, std::int64_t n) {
  return static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(n)));
}
LatticePoint anywhere(phantoms::Random& r) { return {below(r, kLast + 1), below(r, kLast + 1), below(r, kLast + 1)}; }
LatticePoint corner(phantoms::Random& r) { return {kLast * below(r, 2), kLast * below(r, 2), kLast * below(r, 2)}; }
LatticePoint near_corner(phantoms::Random& r) {
  const auto c = [&] { return std::abs(kLast * below(r, 2) - below(r, 3)); };
  return {c(), c(), c()};
}
LatticePoint small_grid(phantoms::Random& r) { return {below(r, 3), below(r, 3), below(r, 3)}; }
LatticePoint far_grid(phantoms::Random& r) {
  return {kLast - 4096 * below(r, 3), kLast - 4096 * below(r, 3), 4096 * below(r, 3)};
}
LatticePoint at_the_switch(phantoms::Random& r) {
  const auto c = [&] { return (1 << 20) * below(r, 2) + below(r, 3); };
  return {c(), c(), c()};
}
// Whole points on one sphere of squared radius 3 · 5^2 · 7^2 · 2^10 …: permutations and signs of (3, 4, 12) around
// 2^23.
LatticePoint on_a_sphere(phantoms::Random& r) {
  std::array<std::int32_t, 3> v{3 << 18, 4 << 18, 12 << 18};
  r.shuffle(v);
  for (auto& x : v) x = (1 << 23) + (below(r, 2) ? x : -x);
  return {v[0], v[1], v[2]};
}

constexpr std::array<std::pair<const char*, Generator>, 7> kGenerators{{{"anywhere", anywhere},
                                                                        {"corners", corner},
                                                                        {"near corners", near_corner},
                                                                        {"small grid", small_grid},
                                                                        {"far grid", far_grid},
                                                                        {"at 2^20", at_the_switch},
                                                                        {"on a sphere", on_a_sphere}}};

// Five different points, the first four positively oriented; or nothing after a number of attempts.
std::optional<std::array<LatticePoint, 5>> five_points(phantoms::Random& random, Generator next) {
  for (int attempt = 0; attempt < 1000; ++attempt) {
    std::array<LatticePoint, 5> p;
    for (auto& q : p) q = next(random);
    if (std::set<LatticePoint>(p.begin(), p.end()).size() < 5) continue;
    const int o = orientation_model(p[0], p[1], p[2], p[3]);
    if (o == 0) continue;
    if (o < 0) std::swap(p[0], p[1]);
    return p;
  }
  return std::nullopt;
}

TEST(Orientation, AgreesWithBigIntegers) {
  for (const auto& [label, next] : kGenerators) {
    phantoms::Random random(11);
    std::array<int, 3> seen{};
    for (int n = 0; n < 2000; ++n) {
      const LatticePoint a = next(random), b = next(random), c = next(random), d = next(random);
      const int expected = orientation_model(a, b, c, d);
      ASSERT_EQ(exact::orientation(a, b, c, d), expected) << label;
      ASSERT_EQ(exact::orientation(b, a, c, d), -expected) << label;
      ASSERT_EQ(exact::orientation(b, c, a, d), expected) << label;
      ++seen[static_cast<std::size_t>(expected + 1)];
    }
    EXPECT_GT(seen[0], 100) << label;
    EXPECT_GT(seen[2], 100) << label;
  }
}

TEST(InSphere, AgreesWithBigIntegersOnBothPaths) {
  // The model's sign for a point inside, from one clear case.
  const int inside = in_sphere_model({{{0, 0, 0}, {2, 0, 0}, {0, 2, 0}, {0, 0, 2}, {1, 1, 1}}}, false);
  for (const auto& [label, next] : kGenerators) {
    phantoms::Random random(12);
    int ties = 0;
    for (int n = 0; n < 1500; ++n) {
      const auto points = five_points(random, next);
      ASSERT_TRUE(points.has_value()) << label;
      const auto& [a, b, c, d, e] = *points;
      const int expected = inside * in_sphere_model(*points, false), decided = inside * in_sphere_model(*points, true);
      ties += expected == 0;
      ASSERT_EQ(exact::in_sphere(a, b, c, d, e), expected) << label;
      ASSERT_EQ(exact::perturbed_in_sphere(a, b, c, d, e), decided) << label;
      // Even permutations of the corners are the same tetrahedron.
      ASSERT_EQ(exact::perturbed_in_sphere(b, c, a, d, e), decided) << label;
      ASSERT_EQ(exact::perturbed_in_sphere(d, c, b, a, e), decided) << label;

      using exact::operator-;
      const auto wide = exact::in_sphere_of<exact::Wide>(a - e, b - e, c - e, d - e);
      ASSERT_EQ(exact::sign(wide.value), expected) << label;
      ASSERT_EQ(exact::perturbed(wide, {a, b, c, d}, e), decided) << label;
      if (exact::small(a - e, b - e, c - e, d - e)) {
        const auto narrow = exact::in_sphere_of<std::int64_t>(a - e, b - e, c - e, d - e);
        ASSERT_TRUE(narrow.value == wide.value) << label;
        for (std::size_t i = 0; i < 4; ++i) ASSERT_TRUE(narrow.cofactors[i] == wide.cofactors[i]) << label;
      }
      // An odd permutation flips the orientation, and with it every sign.
      const auto flipped = exact::in_sphere_of<exact::Wide>(b - e, a - e, c - e, d - e);
      ASSERT_TRUE(flipped.value == -wide.value) << label;
    }
    if (next == small_grid || next == far_grid || next == corner || next == on_a_sphere) {
      EXPECT_GT(ties, 50) << label;
    }
  }
}

TEST(InSphere, OfTwoTetrahedraOnOneFacetBothSeeTheOtherAlike) {
  phantoms::Random random(13);
  for (int n = 0; n < 3000; ++n) {
    const auto points = five_points(random, small_grid);
    ASSERT_TRUE(points.has_value());
    const auto& [a, b, c, d, e] = *points;
    // (a, b, c, e) is on the other side of the facet a, b, c.
    if (exact::orientation(a, b, c, e) >= 0) continue;
    EXPECT_EQ(exact::perturbed_in_sphere(a, b, c, d, e), exact::perturbed_in_sphere(b, a, c, e, d));
  }
}

TEST(InSphere, TheLargestPossibleSumDoesNotOverflow) {
  const LatticePoint a{0, 0, 0}, b{kLast, kLast, 0}, c{kLast, 0, kLast}, d{0, kLast, kLast};
  const int o = exact::orientation(a, b, c, d);
  ASSERT_NE(o, 0);
  const LatticePoint p = o > 0 ? a : b, q = o > 0 ? b : a;
  EXPECT_EQ(exact::in_sphere(p, q, c, d, {kLast, kLast, kLast}), 0);
  EXPECT_EQ(exact::in_sphere(p, q, c, d, {kLast - 1, kLast, kLast}), 1);
  EXPECT_EQ(exact::in_sphere(p, q, c, d, {kLast / 2, kLast / 2, kLast / 2}), 1);
}

}  // namespace
}  // namespace spherule
