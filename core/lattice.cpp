// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/lattice.h"

#include <cmath>

namespace spherule {

namespace {
constexpr std::int64_t kLargest = (std::int64_t{1} << Lattice::coordinate_bits) - 1;
constexpr double kLeastUnitsPerStep = 64;
}  // namespace

Lattice make_lattice(const Grid& grid) {
  // The longest axis fills the lattice with an even number of units a step, so that half a voxel is a lattice point
  // too.
  int longest = 0;
  for (int a = 1; a < 3; ++a) {
    if ((grid.dims[static_cast<std::size_t>(a)] + 1.0) * grid.spacing[a] >
        (grid.dims[static_cast<std::size_t>(longest)] + 1.0) * grid.spacing[longest])
      longest = a;
  }
  const std::int64_t units = kLargest / (std::int64_t{grid.dims[static_cast<std::size_t>(longest)]} + 1) / 2 * 2;
  Lattice lattice{.grid = grid, .unit_mm = grid.spacing[longest] / static_cast<double>(units), .planes = {}};
  for (int a = 0; a < 3; ++a) {
    const double units_per_step = grid.spacing[a] * (static_cast<double>(units) / grid.spacing[longest]);
    if (!(units_per_step >= kLeastUnitsPerStep)) {
      throw Error(ErrorCode::unusable,
                  "The volume has too many samples along an axis, or spacings that differ too much, for an exact "
                  "model; resample it closer "
                  "to cubic voxels or crop it.");
    }
    auto& planes = lattice.planes[static_cast<std::size_t>(a)];
    planes.resize(static_cast<std::size_t>(grid.dims[static_cast<std::size_t>(a)]) + 2);
    for (std::size_t p = 0; p < planes.size(); ++p) {
      planes[p] = static_cast<std::int32_t>(
          std::min<std::int64_t>(std::llround(static_cast<double>(p) * units_per_step), kLargest));
    }
  }
  return lattice;
}

}  // namespace spherule
