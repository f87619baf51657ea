// SPDX-License-Identifier: GPL-3.0-or-later
//
// The integer lattice on which boundary points live and every geometric decision is exact.
//
// Coordinates are whole numbers in [0, 2^24). Sample planes are lattice planes too, so the grid becomes a rectilinear
// integer grid and a boundary point lies exactly on its grid edge; one lattice unit is the same length on the three
// axes, so balls are balls. Differences then have 25 bits with sign, and orientation and in-sphere determinants
// fit 128-bit integers (see predicates.h for the bound).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/geometry.h"
#include "core/volume.h"

namespace spherule {

struct LatticePoint {
  std::int32_t x = 0, y = 0, z = 0;
  std::int32_t operator[](int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
  friend constexpr auto operator<=>(const LatticePoint&, const LatticePoint&) = default;
};

/// A grid with its sample planes rounded to lattice coordinates.
struct Lattice {
  static constexpr int coordinate_bits = 24;

  Grid grid;
  double unit_mm = 1;  ///< length of one lattice unit
  /// planes[a][i + 1] is the coordinate of sample plane i along axis a, for i = -1 … dims[a]: one plane
  /// beyond each end, where a closed border's outside samples are. Strictly ascending. Each is within half a unit
  /// of its true place; with equal spacings all are exact.
  std::array<std::vector<std::int32_t>, 3> planes;

  std::int32_t plane(int axis, std::int32_t i) const {
    return planes[static_cast<std::size_t>(axis)][static_cast<std::size_t>(i + 1)];
  }
  /// Lattice coordinates (whole or not) to LPS mm.
  Vec3 to_patient(Vec3 p) const {
    return grid.to_patient(unit_mm * (p - Vec3{double(plane(0, 0)), double(plane(1, 0)), double(plane(2, 0))}));
  }
  Vec3 to_patient(LatticePoint p) const { return to_patient(Vec3{double(p.x), double(p.y), double(p.z)}); }
};

/// The finest lattice that holds the grid and one plane around it. Throws unusable when the grid's smallest spacing
/// would get fewer than 64 units (more than about 2^18 samples along an axis, or spacings that differ that much).
Lattice make_lattice(const Grid& grid);

}  // namespace spherule
