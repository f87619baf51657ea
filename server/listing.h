// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rows of spheres with what each is worth: what listings and exports show.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "api/service.h"
#include "core/ranking.h"
#include "core/spheres.h"
#include "core/union.h"

namespace spherule::server {

/// Each sphere's part of a model's union, ranked.
struct Contributions {
  explicit Contributions(UnionMeasures whole);

  double value(api::SphereFigure figure, std::uint32_t sphere) const;
  std::size_t bytes() const { return parts.size() * (sizeof(BallPart) + 16); }

  double volume;  ///< of the union, mm3
  std::vector<BallPart> parts;
  Ranking ranking;
};

/// Rows [first, first + count) of a listing. `contributions` may be null when the listing does not need them.
api::SpherePage rows(const SphereModel& model, const Contributions* contributions, const api::SphereListing& listing,
                     std::uint64_t first, std::uint64_t count);

}  // namespace spherule::server
