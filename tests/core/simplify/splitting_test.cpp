// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/splitting.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <numbers>

#include "core/measure/solid.h"
#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

using At = SplittingOptions::At;
using Lists = std::vector<std::vector<std::uint32_t>>;

Lists lists_at(const Simplification& s, std::uint32_t k) {
  const MemberLists members = members_at(s, k);
  Lists lists;
  for (std::size_t i = 0; i < members.count(); ++i) lists.emplace_back(members.of(i).begin(), members.of(i).end());
  std::ranges::sort(lists);
  return lists;
}

// The longest axis by power iteration and everything by sorting: the method as one would explain it.
struct Spread {
  Vec3 mean, axis;
  double variance = -1;
};
Spread spread(const SphereModel& model, const std::vector<std::uint32_t>& members) {
  Spread s;
  if (members.size() < 2) return s;
  for (const std::uint32_t m : members)
    s.mean = s.mean + (1.0 / static_cast<double>(members.size())) * model.spheres[m].centre;
  s.axis = {0.3, 0.5, 0.8};
  for (int i = 0; i < 3000; ++i) {
    Vec3 next;
    for (const std::uint32_t m : members) {
      const Vec3 d = model.spheres[m].centre - s.mean;
      next = next + dot(d, s.axis) * d;
    }
    if (norm(next) == 0) return {s.mean, s.axis, 0};
    s.axis = normalised(next);
  }
  s.variance = 0;
  for (const std::uint32_t m : members) {
    const double along = dot(model.spheres[m].centre - s.mean, s.axis);
    s.variance += along * along / static_cast<double>(members.size());
  }
  return s;
}

Lists slow_split(const SphereModel& model, At at, std::uint32_t k) {
  Lists clusters{sets::all_of(model)};
  while (clusters.size() < k) {
    std::size_t widest = 0;
    for (std::size_t c = 1; c < clusters.size(); ++c) {
      if (spread(model, clusters[c]).variance > spread(model, clusters[widest]).variance) widest = c;
    }
    const Spread s = spread(model, clusters[widest]);
    auto& members = clusters[widest];
    const auto along = [&](std::uint32_t m) { return dot(model.spheres[m].centre - s.mean, s.axis); };
    std::ranges::sort(members, {}, along);
    auto cut = members.begin() + static_cast<std::ptrdiff_t>(members.size() / 2);
    if (at == At::average) cut = std::ranges::find_if(members, [&](std::uint32_t m) { return along(m) >= 0; });
    std::vector<std::uint32_t> upper(cut, members.end());
    members.erase(cut, members.end());
    clusters.push_back(std::move(upper));
  }
  for (auto& c : clusters) std::ranges::sort(c);
  std::ranges::sort(clusters);
  return clusters;
}

class Splitting : public testing::TestWithParam<At> {};
INSTANTIATE_TEST_SUITE_P(Both, Splitting, testing::Values(At::median, At::average));

TEST_P(Splitting, AgreesWithTheSlowModel) {
  for (std::uint64_t seed = 1; seed <= 20; ++seed) {
    // Halves of 64 have even counts down to the last: which half an odd median goes to depends on the axis's sign.
    const SphereModel model = sets::random_balls(64, 10, 0.1, 1, seed);
    const Simplification s = split_spheres(model, {.at = GetParam(), .k = 12});
    ASSERT_TRUE(is_valid(s, 64));
    EXPECT_EQ(lists_at(s, 12), slow_split(model, GetParam(), 12)) << seed;
  }
}

TEST_P(Splitting, IsExactlyKAtEveryLevelAndHoldsEveryMember) {
  const SphereModel model = sets::raw_model(sets::dumbbell());
  const Simplification s = split_spheres(model, {.at = GetParam(), .k = 100});
  ASSERT_TRUE(is_valid(s, model.spheres.size()));
  for (std::uint32_t k = 1; k <= 100; ++k) EXPECT_EQ(shown_at(s, k).size(), k);
  EXPECT_EQ(s.members.size(), model.spheres.size());
  // A smaller k is the same order, cut short.
  const Simplification few = split_spheres(model, {.at = GetParam(), .k = 30});
  EXPECT_EQ(spheres_at(few, 30), spheres_at(s, 30));
  EXPECT_EQ(lists_at(few, 30), lists_at(s, 30));
}

TEST_P(Splitting, EqualCentresSplitToo) {
  SphereModel model;
  for (int i = 0; i < 9; ++i) model.spheres.push_back({{1, 2, 3}, 1.0 + i});
  const Simplification s = split_spheres(model, {.at = GetParam(), .k = 9});
  ASSERT_TRUE(is_valid(s, 9));
  EXPECT_EQ(shown_at(s, 9).size(), 9U);
}

TEST(SplittingRepresentative, KeepsWhatItsNameSays) {
  const SphereModel model = sets::raw_model(sets::dumbbell());
  const std::vector<double> shares = volume_shares(model);
  const auto at = [&](Representative r) { return split_spheres(model, {.k = 12, .representative = r}); };
  double volume = 0;
  for (const Sphere& s : spheres_at(at(Representative::volume), 12)) {
    volume += 4 * std::numbers::pi / 3 * s.radius * s.radius * s.radius;
  }
  EXPECT_NEAR(volume, measure_tetrahedra(*model.solid).volume_mm3, 1e-12 * volume);
  const Simplification enclosing = at(Representative::enclosing), largest = at(Representative::largest),
                       mean = at(Representative::mean);
  const MemberLists members = members_at(enclosing, 12);
  const auto enclosed = spheres_at(enclosing, 12), chosen = spheres_at(largest, 12), means = spheres_at(mean, 12);
  for (std::size_t i = 0; i < 12; ++i) {
    double most = 0, weighted = 0, weight = 0;
    for (const std::uint32_t m : members.of(i)) {
      const Sphere& s = model.spheres[m];
      EXPECT_LE(norm(s.centre - enclosed[i].centre) + s.radius, enclosed[i].radius * (1 + 1e-12));
      most = std::max(most, s.radius);
      weighted += shares[m] * s.radius;
      weight += shares[m];
    }
    EXPECT_EQ(chosen[i].radius, most);
    EXPECT_NEAR(means[i].radius, std::max(weighted / weight, std::cbrt(3 * weight / (4 * std::numbers::pi))), 1e-12);
  }
}

TEST(SplittingErrors, KIsWithinTheModel) {
  const SphereModel model = sets::random_balls(5, 10, 0.1, 1, 3);
  const std::vector<std::pair<std::uint32_t, std::string>> cases{{0, "of at least 1"}, {6, "within 1 and 5"}};
  for (const auto& [k, said] : cases) {
    try {
      split_spheres(model, {.k = k});
      FAIL();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
      EXPECT_NE(std::string(error.what()).find(said), std::string::npos);
    }
  }
  EXPECT_THROW(split_spheres({}, {.k = 1}), Error);
}

}  // namespace
}  // namespace spherule
