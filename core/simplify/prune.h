// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pruning: keeps some of the model's own spheres and drops the rest.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 3.4.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/base/context.h"
#include "core/simplify/result.h"
#include "core/spheres.h"

namespace spherule {

/// What to keep: exactly one of these.
struct PruneOptions {
  std::optional<double> least_radius_mm{};  ///< spheres of at least this radius; finite, >= 0
  std::vector<std::uint32_t> buckets{};     ///< spheres in these buckets of radius_histogram, counted from 0
  std::uint32_t bucket_count = 40;          ///< 1 … 65536: how many buckets there are
  std::optional<double> volume_share{};     ///< the largest shares of the volume, up to this part of it; (0, 1]
  std::optional<std::uint32_t> k{};         ///< the k largest shares of the volume; 1 … the model's count
};

/// Throws what prune_spheres throws for options out of their bounds for a model of so many spheres.
void check_options(const PruneOptions& options, std::size_t model_count);

/// Every sphere kept is its own and only member; level k shows the k first: by radius for the first two rules, else by
/// volume share (represent.h), largest first, ties by index. Throws invalid_argument for other than one rule or one out
/// of its bounds, and unusable when nothing would be left. O(n log n) and, by share, that of volume_shares;
/// 20 bytes a sphere. Reports stage "prune".
Simplification prune_spheres(const SphereModel& model, const PruneOptions& options, const Context& context = {});

}  // namespace spherule
