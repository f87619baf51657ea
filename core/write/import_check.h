// SPDX-License-Identifier: GPL-3.0-or-later
//
// What every reader of spheres demands of one row, private to core/write.
#pragma once

#include <cmath>
#include <string>

#include "core/base/error.h"
#include "core/write/export.h"

namespace spherule::detail {

/// Throws unusable unless the sphere of row `row` (from 1) is one that every later stage can compute with.
inline void require_usable(const Sphere& s, std::size_t row) {
  const auto refuse = [row](const char* what) {
    throw Error(ErrorCode::unusable, "Sphere " + std::to_string(row) + " " + what);
  };
  for (const double value : {s.centre.x, s.centre.y, s.centre.z, s.radius}) {
    if (!std::isfinite(value)) refuse("has a coordinate or radius that is not finite: remove it or give it a number.");
    if (std::abs(value) > max_import_coordinate)
      refuse("has a coordinate or radius beyond 1e9 mm: send lengths in millimetres.");
  }
  if (s.radius < 0) refuse("has a negative radius: radii are lengths in millimetres, 0 or more.");
  if (s.radius > 0 && s.radius < min_import_radius)
    refuse("has a radius below 1e-18 mm: send lengths in millimetres, or 0.");
}

/// Throws too_large when a set of `count` spheres is over the limit.
inline void require_within(std::size_t count, const ImportLimits& limits) {
  if (count > limits.max_spheres)
    throw Error(ErrorCode::too_large, "The set has more than " + std::to_string(limits.max_spheres) +
                                          " spheres, the most that are accepted: send fewer.");
}

/// Throws unusable for a set without spheres.
inline void require_some(std::size_t count) {
  if (count == 0) throw Error(ErrorCode::unusable, "The set has no spheres: send at least one row of x, y, z, r.");
}

}  // namespace spherule::detail
