// SPDX-License-Identifier: GPL-3.0-or-later
//
// Exact measures of a model: volume, area and topology, each for the representation that its name says.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/inside.h"
#include "core/spheres.h"

namespace spherule {

/// Of the inside samples: the standard that the paper compares with.
struct VoxelMeasures {
  std::uint64_t count = 0;
  double volume_mm3 = 0;  ///< count times the volume of one voxel
};

/// Betti numbers of a closed solid: pieces, tunnels, voids.
struct Topology {
  std::array<std::int64_t, 3> betti{0, 0, 0};
  std::int64_t euler_characteristic = 0;  ///< betti[0] - betti[1] + betti[2]
};

/// Of the union of the inside tetrahedra, as a closed simplicial complex (pieces that share a corner are one piece).
struct TetrahedraMeasures {
  double volume_mm3 = 0;  ///< exact in lattice units (128-bit sum), rounded once
  double area_mm2 = 0;    ///< of the facets between an inside cell and anything else
  std::uint64_t boundary_facets = 0;
  Topology topology;
};

/// Buckets are equal intervals of [min, max]; the last one is closed.
struct RadiusHistogram {
  double min_mm = 0, max_mm = 0;
  std::vector<std::uint64_t> counts;
};

VoxelMeasures measure_voxels(const Grid& grid, const SampleBits& inside);

/// O(cells); about 60 bytes a cell while it runs.
TetrahedraMeasures measure_tetrahedra(const Solid& solid, const Context& context = {});

/// Throws invalid_argument unless buckets is within 1 … 65536. All counts 0 for an empty set. O(n).
RadiusHistogram radius_histogram(std::span<const Sphere> spheres, std::size_t buckets = 40);

}  // namespace spherule
