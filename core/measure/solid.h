// SPDX-License-Identifier: GPL-3.0-or-later
//
// Exact measures of a model: volume, area, moments and topology, each for the representation that its name says; the
// radii of its spheres; and the paper's bounds.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/inside.h"
#include "core/measure/mass.h"
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
  double area_mm2 = 0;    ///< of the facets between an inside cell and anything else; relative rounding below 1e-14
  Moments moments;        ///< tetrahedra_moments
  std::uint64_t boundary_facets = 0;
  Topology topology;
};

VoxelMeasures measure_voxels(const Grid& grid, const SampleBits& inside);  ///< O(samples / 64)

/// Of the union of the inside tetrahedra, about the frame's origin. Exact in lattice units about the lattice's origin
/// (128-bit sums), then moved: relative error below 1e-15 times the squared ratio of the solid's distance from the
/// frame's origin to its size. O(cells).
Moments tetrahedra_moments(const Solid& solid, const Context& context = {});

/// O(cells); about 60 bytes a cell and 28 a point while it runs. Reports stage "tetrahedra".
TetrahedraMeasures measure_tetrahedra(const Solid& solid, const Context& context = {});

enum class RadiusScale : std::uint8_t {
  linear,       ///< equal intervals, as in the paper
  logarithmic,  ///< equal ratios of radii
};

/// Buckets divide [min, max] evenly on their scale; the last one is closed.
struct RadiusHistogram {
  RadiusScale scale = RadiusScale::linear;
  double min_mm = 0, max_mm = 0;
  std::vector<std::uint64_t> counts;
  std::uint64_t zero_radius = 0;  ///< logarithmic only: spheres that no bucket can hold
};

/// Throws invalid_argument unless buckets is within 1 … 65536. All counts 0 for an empty set. O(n).
RadiusHistogram radius_histogram(std::span<const Sphere> spheres, std::size_t buckets = 40,
                                 RadiusScale scale = RadiusScale::linear);

/// Something that the paper bounds, on one model.
struct Observation {
  double value = 0, bound = 0;
  double slack() const { return bound - value; }
};

/// Of Ranjan and Fournier's observations about a raw model, those that its density δ decides.
struct Observations {
  /// Observation 3: the union of spheres is larger than the tetrahedra, but by less than N - 2 spheres of radius δ,
  /// with N boundary points. value: V_S - V_T in mm³.
  Observation excess_volume_mm3;
  /// Observation 5: δ is at most the diagonal of a voxel (plus one lattice unit for rounding). value: δ in mm.
  Observation density_mm;
};

/// From what has been measured already. Precondition: model.solid.
Observations observations(const SphereModel& model, double density_mm, double tetrahedra_volume_mm3,
                          double spheres_volume_mm3);

}  // namespace spherule
