// SPDX-License-Identifier: GPL-3.0-or-later
//
// Sphericity clustering: the object as few round clusters of its spheres.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 3.4.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/base/context.h"
#include "core/simplify/represent.h"
#include "core/simplify/result.h"
#include "core/spheres.h"

namespace spherule {

struct SphericityOptions {
  double threshold = 0.7;     ///< T_S in (0, 1]: clusters at least this round are left alone
  std::uint32_t limit = 256;  ///< the most spheres wanted: 1 … the model's count
  Representative representative = Representative::enclosing;
};

/// Throws what cluster_by_sphericity throws for options out of their bounds for a model of so many spheres.
void check_options(const SphericityOptions& options, std::size_t model_count);

/// Of a cluster: the radius of its largest member over that of the smallest sphere around all members; in (0, 1], and 1
/// for a cluster of points in one place. Precondition: members not empty.
double sphericity(std::span<const Sphere> balls, std::span<const std::uint32_t> members);

/// The paper's clustering. It begins with all spheres in one cluster and, until there are `limit` or the least
/// sphericity reaches the threshold, takes the cluster of the least sphericity apart:
/// its largest member, of radius r, and all members within the sphere of radius r / threshold about the same centre
/// become one cluster (its sphericity passes), and every connected component of the union of the others becomes
/// another. Where the components would pass the limit the others stay one cluster, which from then on only gives up
/// round parts.
/// Every sphere of the model is a member. A function of the model alone, equivariant under similarities.
/// Throws invalid_argument for a threshold outside (0, 1] and a limit of 0 or above the model's count.
/// About O(limit · n) simple steps at worst, 120 bytes a sphere. Reports stage "sphericity".
Simplification cluster_by_sphericity(const SphereModel& model, const SphericityOptions& options = {},
                                     const Context& context = {});

}  // namespace spherule
