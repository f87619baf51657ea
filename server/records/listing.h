// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rows of spheres with what each is worth: what listings and exports show.
#pragma once

#include <cstddef>
#include <cstdint>
#include <vector>

#include "api/service.h"
#include "core/measure/ranking.h"
#include "core/measure/union.h"
#include "core/simplify/result.h"
#include "core/spheres.h"

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

/// What listings are of. What a listing does not need may be null.
struct Listed {
  const SphereModel& model;  ///< or its level
  const Contributions* contributions = nullptr;
  const Simplification* levels = nullptr;
  std::uint32_t level = 0;              ///< as in api::DerivedRequest
  const SphereModel* source = nullptr;  ///< that the model was simplified from
};

/// Rows [first, first + count) of a listing, with the members of each sphere where wanted.
api::SpherePage rows(const Listed& of, const api::SphereListing& listing, bool members, std::uint64_t first,
                     std::uint64_t count);

}  // namespace spherule::server
