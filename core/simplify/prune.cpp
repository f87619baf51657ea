// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/prune.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/poll.h"
#include "core/base/progress.h"
#include "core/base/ranges.h"
#include "core/simplify/levels.h"
#include "core/simplify/represent.h"

namespace spherule {

namespace {

void require_one_rule(const PruneOptions& options) {
  const int rules = options.least_radius_mm.has_value() + !options.buckets.empty() + options.volume_share.has_value() +
                    options.k.has_value();
  const auto refuse = [](const char* field, const char* sentence) {
    throw Error(ErrorCode::invalid_argument, sentence, {{field, sentence}});
  };
  if (rules != 1) refuse("", "Give exactly one of least_radius_mm, buckets, volume_share and k to prune by.");
  if (options.least_radius_mm && !ranges::length_mm.holds(*options.least_radius_mm)) {
    refuse("/least_radius_mm", "Give least_radius_mm as a length within 0 and 1e9 mm.");
  }
  if (options.volume_share && !(*options.volume_share > 0 && *options.volume_share <= 1)) {
    refuse("/volume_share", "Give volume_share as a number above 0 and at most 1.");
  }
  if (options.bucket_count < 1 || options.bucket_count > 65536) {
    refuse("/bucket_count", "Give bucket_count as a whole number within 1 and 65536.");
  }
  if (std::ranges::any_of(options.buckets, [&](std::uint32_t b) { return b >= options.bucket_count; })) {
    refuse("/buckets", "Give buckets as numbers from 0 up to the count of buckets less 1.");
  }
}

// Indices of all spheres, the largest key first, then by index.
std::vector<std::uint32_t> descending(std::span<const double> keys, const Context& context) {
  std::vector<std::uint32_t> order(keys.size());
  std::iota(order.begin(), order.end(), 0U);
  Poll poll(context);
  std::sort(order.begin(), order.end(), Polled(poll, [&](std::uint32_t a, std::uint32_t b) {
              return keys[a] != keys[b] ? keys[a] > keys[b] : a < b;
            }));
  return order;
}

std::vector<double> radii(const SphereModel& model) {
  std::vector<double> result;
  for (const Sphere& s : model.spheres) result.push_back(s.radius);
  return result;
}

std::vector<std::uint32_t> kept(const SphereModel& model, const PruneOptions& options, const Context& context) {
  if (options.volume_share || options.k) {
    const std::vector<double> shares = volume_shares(model, quiet(context));
    std::vector<std::uint32_t> order = descending(shares, context);
    std::size_t count = options.k.value_or(0);
    if (options.volume_share) {
      const double wanted = *options.volume_share * std::accumulate(shares.begin(), shares.end(), 0.0);
      for (double sum = 0; count < order.size() && sum < wanted; ++count) sum += shares[order[count]];
    }
    order.resize(count);
    return order;
  }
  std::vector<std::uint32_t> order = descending(radii(model), context);
  if (options.least_radius_mm) {
    std::erase_if(order, [&](std::uint32_t i) { return model.spheres[i].radius < *options.least_radius_mm; });
    return order;
  }
  const double least = model.spheres[order.back()].radius, most = model.spheres[order.front()].radius;
  const double width = (most - least) / options.bucket_count;
  std::vector<std::uint8_t> wanted(options.bucket_count, 0);
  for (const std::uint32_t b : options.buckets) wanted[b] = 1;
  std::erase_if(order, [&](std::uint32_t i) {
    const double bucket = width > 0 ? (model.spheres[i].radius - least) / width : 0;  // as radius_histogram counts
    return !wanted[std::min(static_cast<std::uint32_t>(bucket), options.bucket_count - 1)];
  });
  return order;
}

}  // namespace

void check_options(const PruneOptions& options, std::size_t model_count) {
  require_one_rule(options);
  detail::require_k(options.k.value_or(1), model_count);
}

Simplification prune_spheres(const SphereModel& model, const PruneOptions& options, const Context& context) {
  check_options(options, model.spheres.size());
  context.report("prune", 0);
  Simplification result;
  result.members = kept(model, options, context);
  context.throw_if_cancelled();
  const auto count = static_cast<std::uint32_t>(result.members.size());
  if (count == 0) {
    throw Error(ErrorCode::unusable, "Nothing would be left of the model; prune less of it.");
  }
  for (std::uint32_t i = 0; i < count; ++i) {
    result.spheres.push_back({.sphere = model.spheres[result.members[i]], .from = i + 1, .to = count});
    result.member_begin.push_back(i + 1);
  }
  context.report("prune", 1);
  return result;
}

}  // namespace spherule
