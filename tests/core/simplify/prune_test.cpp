// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/prune.h"

#include <gtest/gtest.h>

#include <algorithm>

#include "core/measure/solid.h"
#include "core/simplify/represent.h"
#include "tests/core/simplify/sets.h"

namespace spherule {
namespace {

std::vector<std::uint32_t> kept(const SphereModel& model, const PruneOptions& options) {
  const Simplification s = prune_spheres(model, options);
  EXPECT_TRUE(is_valid(s, model.spheres.size()));
  std::vector<std::uint32_t> members;
  for (std::uint32_t i = 0; i < s.spheres.size(); ++i) {
    EXPECT_EQ(s.members_of(i).size(), 1U);
    members.push_back(s.members_of(i)[0]);
    EXPECT_EQ(s.spheres[i].sphere, model.spheres[members.back()]);
    EXPECT_EQ(s.spheres[i].from, i + 1);
  }
  return members;
}

std::vector<std::uint32_t> sorted(std::vector<std::uint32_t> v) {
  std::ranges::sort(v);
  return v;
}

TEST(Prune, KeepsTheLargestAtEveryLevel) {
  const SphereModel model = sets::random_balls(500, 10, 0, 1, 1);
  const auto members = kept(model, {.least_radius_mm = 0.4, .buckets = {}, .volume_share = {}, .k = {}});
  std::vector<std::uint32_t> expected;
  for (std::uint32_t i = 0; i < 500; ++i) {
    if (model.spheres[i].radius >= 0.4) expected.push_back(i);
  }
  EXPECT_EQ(sorted(members), expected);
  for (std::size_t i = 1; i < members.size(); ++i) {
    EXPECT_GE(model.spheres[members[i - 1]].radius, model.spheres[members[i]].radius);
  }
}

TEST(Prune, BucketsAreThoseOfTheHistogram) {
  const SphereModel model = sets::random_balls(500, 10, 0, 1, 2);
  const RadiusHistogram histogram = radius_histogram(model.spheres, 7);
  std::size_t total = 0;
  for (std::uint32_t b = 0; b < 7; ++b) {
    const auto members =
        kept(model, {.least_radius_mm = {}, .buckets = {b}, .bucket_count = 7, .volume_share = {}, .k = {}});
    EXPECT_EQ(members.size(), histogram.counts[b]);
    total += members.size();
  }
  EXPECT_EQ(total, 500U);
  EXPECT_EQ(
      kept(model, {.least_radius_mm = {}, .buckets = {0, 3, 6}, .bucket_count = 7, .volume_share = {}, .k = {}}).size(),
      histogram.counts[0] + histogram.counts[3] + histogram.counts[6]);
}

TEST(Prune, SharesOfARawModelAddToItsTetrahedra) {
  const SphereModel model = sets::raw_model(sets::dumbbell());
  const std::vector<double> shares = volume_shares(model);
  const double whole = measure_tetrahedra(*model.solid).volume_mm3;
  EXPECT_NEAR(std::accumulate(shares.begin(), shares.end(), 0.0), whole, 1e-12 * whole);
  const auto members = kept(model, {.least_radius_mm = {}, .buckets = {}, .volume_share = 0.5, .k = {}});
  double sum = 0;
  for (const std::uint32_t m : members) sum += shares[m];
  EXPECT_GE(sum, 0.5 * whole);
  EXPECT_LT(sum - shares[members.back()], 0.5 * whole) << "one less would not do";
  for (const double share : shares) EXPECT_LE(share < shares[members.back()] ? 0 : share, shares[members.front()]);
  EXPECT_EQ(kept(model, {.least_radius_mm = {}, .buckets = {}, .volume_share = 1, .k = {}}).size(),
            model.spheres.size());
  EXPECT_EQ(kept(model, {.least_radius_mm = {}, .buckets = {}, .volume_share = {}, .k = 10}).size(), 10U);
}

TEST(Prune, BadInputGetsASentence) {
  const SphereModel model = sets::random_balls(5, 10, 0.1, 1, 3);
  const auto code = [&](const PruneOptions& options) {
    try {
      prune_spheres(model, options);
    } catch (const Error& error) {
      EXPECT_TRUE(std::string(error.what()).ends_with("."));
      return error.code();
    }
    return ErrorCode::busy;
  };
  PruneOptions none;
  EXPECT_EQ(code(none), ErrorCode::invalid_argument);
  for (const double radius : {-1.0, std::numeric_limits<double>::infinity(), std::nan("")}) {
    PruneOptions o;
    o.least_radius_mm = radius;
    EXPECT_EQ(code(o), ErrorCode::invalid_argument);
  }
  for (const double share : {0.0, -0.5, 1.5, std::nan("")}) {
    PruneOptions o;
    o.volume_share = share;
    EXPECT_EQ(code(o), ErrorCode::invalid_argument);
  }
  PruneOptions bucket;
  bucket.buckets = {40};
  EXPECT_EQ(code(bucket), ErrorCode::invalid_argument);
  bucket.buckets = {0};
  bucket.bucket_count = 0;
  EXPECT_EQ(code(bucket), ErrorCode::invalid_argument);
  PruneOptions two;
  two.k = 2;
  two.volume_share = 0.5;
  EXPECT_EQ(code(two), ErrorCode::invalid_argument);
  for (const std::uint32_t k : {0U, 6U}) {
    PruneOptions o;
    o.k = k;
    EXPECT_EQ(code(o), ErrorCode::invalid_argument);
  }
  PruneOptions all_gone;
  all_gone.least_radius_mm = 2;
  EXPECT_EQ(code(all_gone), ErrorCode::unusable);
  EXPECT_THROW(prune_spheres({}, {.least_radius_mm = 1, .buckets = {}, .volume_share = {}, .k = {}}), Error);
}

}  // namespace
}  // namespace spherule
