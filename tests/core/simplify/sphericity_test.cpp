// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/sphericity.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "core/simplify/ball_components.h"
#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

using Indices = std::vector<std::uint32_t>;
using Lists = std::vector<Indices>;

Lists sorted(Lists lists) {
  for (auto& list : lists) std::ranges::sort(list);
  std::ranges::sort(lists);
  return lists;
}

Lists slow_components(const SphereModel& model, Indices members) {
  Lists components;
  while (!members.empty()) {
    Indices component{members.back()};
    members.pop_back();
    for (std::size_t i = 0; i < component.size(); ++i) {
      std::erase_if(members, [&](std::uint32_t m) {
        const bool joined = detail::overlap(model.spheres[component[i]], model.spheres[m]);
        if (joined) component.push_back(m);
        return joined;
      });
    }
    components.push_back(component);
  }
  return sorted(components);
}

// The paper's steps, one after the other, with nothing clever.
Lists slow_clusters(const SphereModel& model, double threshold, std::size_t limit) {
  Lists open{sets::all_of(model)}, shattered;
  for (;;) {
    double least = threshold * (1 - 1e-9);
    Lists* where = nullptr;
    std::size_t which = 0;
    for (Lists* lists : {&open, &shattered}) {
      for (std::size_t c = 0; c < lists->size(); ++c) {
        const double s = sphericity(model.spheres, (*lists)[c]);
        if (s < least) least = s, where = lists, which = c;
      }
    }
    if (where == nullptr || open.size() + shattered.size() >= limit) break;
    const Indices members = (*where)[which];
    where->erase(where->begin() + static_cast<std::ptrdiff_t>(which));
    const std::uint32_t seed = *std::ranges::max_element(
        members, {}, [&](std::uint32_t m) { return std::pair(model.spheres[m].radius, -double(m)); });
    Indices round, rest;
    for (const std::uint32_t m : members) {
      const double far = norm(model.spheres[m].centre - model.spheres[seed].centre) + model.spheres[m].radius;
      (far <= model.spheres[seed].radius / threshold ? round : rest).push_back(m);
    }
    open.push_back(round);
    const Lists components = slow_components(model, rest);
    if (where == &shattered || open.size() + shattered.size() + components.size() > limit) {
      shattered.push_back(rest);
    } else {
      open.insert(open.end(), components.begin(), components.end());
    }
  }
  open.insert(open.end(), shattered.begin(), shattered.end());
  return sorted(open);
}

Lists clusters_of(const Simplification& s) {
  Lists lists;
  for (const std::uint32_t i : shown_at(s, s.last_level())) {
    lists.emplace_back(s.members_of(i).begin(), s.members_of(i).end());
  }
  return sorted(lists);
}

TEST(BallComponents, AgreeWithTheSlowModelWhileBallsLeave) {
  for (std::uint64_t seed = 1; seed <= 60; ++seed) {
    const SphereModel model = seed % 4 == 0 ? sets::raw_model(sets::dumbbell(), 9)
                                            : sets::random_balls(150, 10, 0.05, 0.4 + 0.02 * double(seed), seed);
    detail::BallComponents components(model, {});
    Indices members = sets::all_of(model);
    Indices left;
    phantoms::Random random(seed);
    for (std::uint32_t group = 1; members.size() > 1; ++group) {
      // All parts but the main one; what is in none of these is the main one.
      Lists parts = components.parts_beside_main(0, members, left);
      Indices main = members;
      for (const Indices& part : parts) {
        std::erase_if(main, [&](std::uint32_t m) { return std::ranges::find(part, m) != part.end(); });
      }
      parts.push_back(main);
      ASSERT_EQ(sorted(parts), slow_components(model, members)) << seed;
      // The main one goes on, without a ball of its balls.
      const Sphere hole{model.spheres[main[random.below(main.size())]].centre, 1.5 * random.unit()};
      left.clear();
      Indices rest;
      for (const std::uint32_t m : members) {
        const bool of_main = std::ranges::find(main, m) != main.end();
        const bool leaves = norm(model.spheres[m].centre - hole.centre) <= hole.radius;
        if (of_main && !leaves) rest.push_back(m);
        if (of_main && leaves) left.push_back(m);
        if (!of_main || leaves) components.move(m, group);
      }
      members = rest;
    }
  }
}

TEST(SphericityClusters, AgreeWithTheSlowModel) {
  for (std::uint64_t seed = 1; seed <= 30; ++seed) {
    const SphereModel model =
        seed % 5 == 0 ? sets::raw_model(sets::dumbbell(), 8) : sets::random_balls(40, 10, 0.2, 2.5, seed);
    for (const double threshold : {0.3, 0.6, 0.9}) {
      for (const std::uint32_t limit : {1U, 2U, 7U, 20U}) {
        const Simplification s = cluster_by_sphericity(model, {.threshold = threshold, .limit = limit});
        ASSERT_TRUE(is_valid(s, model.spheres.size()));
        EXPECT_EQ(clusters_of(s), slow_clusters(model, threshold, limit)) << seed << " " << threshold << " " << limit;
      }
    }
  }
}

TEST(SphericityClusters, KeepTheirPromisesOnARawModel) {
  const SphereModel model = sets::raw_model(sets::dumbbell());
  for (const std::uint32_t limit : {1U, 5U, 40U, 400U}) {
    const Simplification s = cluster_by_sphericity(model, {.threshold = 0.6, .limit = limit});
    ASSERT_TRUE(is_valid(s, model.spheres.size()));
    EXPECT_EQ(s.members.size(), model.spheres.size()) << "every sphere is a member";
    EXPECT_LE(s.last_level(), limit);
    for (const std::uint32_t k : {1U, 3U, limit}) {
      const MemberLists members = members_at(s, k);
      const std::vector<Sphere> shown = spheres_at(s, k);
      for (std::size_t i = 0; i < shown.size(); ++i) {
        for (const std::uint32_t m : members.of(i)) {
          EXPECT_LE(norm(model.spheres[m].centre - shown[i].centre) + model.spheres[m].radius,
                    shown[i].radius * (1 + 1e-12));
        }
      }
    }
    double least = 1;
    for (const std::uint32_t i : shown_at(s, limit))
      least = std::min(least, sphericity(model.spheres, s.members_of(i)));
    EXPECT_TRUE(least >= 0.6 * (1 - 1e-9) || s.last_level() == limit) << least;
  }
}

TEST(SphericityClusters, TwoBallsApartComeApart) {
  // Two clumps far from each other: the seed's clump passes at once, the other is one component.
  SphereModel model{.spheres = {{{0, 0, 0}, 2}, {{1, 0, 0}, 1.5}, {{20, 0, 0}, 1}, {{20.5, 0, 0}, 0.8}}, .solid = {}};
  const Simplification s = cluster_by_sphericity(model, {.threshold = 0.7, .limit = 4});
  EXPECT_EQ(clusters_of(s), (Lists{{0, 1}, {2, 3}}));
  EXPECT_EQ(s.last_level(), 2U);
  const Simplification largest =
      cluster_by_sphericity(model, {.threshold = 0.7, .limit = 4, .representative = Representative::largest});
  EXPECT_EQ(spheres_at(largest, 2), (std::vector<Sphere>{model.spheres[0], model.spheres[2]}));
}

TEST(SphericityClusters, AThresholdOfOneTakesOnlyWhatIsWithinTheLargest) {
  const SphereModel model{.spheres = {{{0, 0, 0}, 2}, {{1, 0, 0}, 1}, {{1.1, 0, 0}, 1}, {{0, 0, 0}, 0}}, .solid = {}};
  EXPECT_EQ(clusters_of(cluster_by_sphericity(model, {.threshold = 1, .limit = 4})), (Lists{{0, 1, 3}, {2}}));
}

TEST(SphericityClusters, PointsInOnePlaceAreOneRoundCluster) {
  const SphereModel model{.spheres = {{{1, 1, 1}, 0}, {{1, 1, 1}, 0}, {{1, 1, 1}, 0}}, .solid = {}};
  EXPECT_EQ(cluster_by_sphericity(model, {.threshold = 1, .limit = 3}).last_level(), 1U);
}

TEST(SphericityClusters, BadInputGetsASentence) {
  const SphereModel model = sets::random_balls(5, 10, 0.1, 1, 3);
  for (const double threshold : {0.0, -0.1, 1.01, std::nan("")}) {
    EXPECT_THROW(cluster_by_sphericity(model, {.threshold = threshold, .limit = 3}), Error);
  }
  for (const std::uint32_t limit : {0U, 6U}) {
    EXPECT_THROW(cluster_by_sphericity(model, {.threshold = 0.5, .limit = limit}), Error);
  }
  EXPECT_THROW(cluster_by_sphericity({}, {.threshold = 0.5, .limit = 1}), Error);
}

}  // namespace
}  // namespace spherule
