// SPDX-License-Identifier: GPL-3.0-or-later
//
// One sphere in place of many: what the clustering methods show for a cluster.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/spheres.h"

namespace spherule {

enum class Representative : std::uint8_t {
  enclosing,  ///< the smallest sphere around all members: covers them
  largest,    ///< the largest member (the first of equal ones): never beyond them
  mean,    ///< mean centre and mean radius, weighted by the members' shares of the volume; where the ball of `volume`
           ///< is larger (small spheres of a wide cluster), that one
  volume,  ///< mean centre, and the members' shares as volume: keeps the volume but for overlaps of clusters
};

/// Every sphere's own part of the object's volume, mm³: the volume of its tetrahedron in a raw model, of its ball
/// within its power cell in any other, so that parts never overlap and add to the whole. All equal where they
/// would all be 0. O(spheres).
std::vector<double> volume_shares(const SphereModel& model, const Context& context = {});

/// The sphere that stands for `members` (indices, at least one). Weights all 0 count as equal. O(members).
Sphere represent(Representative by, std::span<const Sphere> balls, std::span<const double> shares,
                 std::span<const std::uint32_t> members);

}  // namespace spherule
