// SPDX-License-Identifier: GPL-3.0-or-later
//
// One slice of a volume, and the method in two dimensions: boundary points, Delaunay triangles, and circles in place
// of spheres.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), figures 3 and 4.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <vector>

#include "core/base/context.h"
#include "core/inside.h"
#include "core/lattice.h"
#include "core/slice/plane_delaunay.h"
#include "core/volume.h"

namespace spherule {

/// The samples with index `index` along grid axis `axis` (0, 1, 2 for i, j, k) as a volume one sample thick: its first
/// two axes are the grid's other two in their order, its third is `axis`, and it lies where the samples lie. O(samples
/// of the slice). Throws not_found for an index that the volume does not have.
Volume slice_of(const Volume& volume, int axis, std::int32_t index);

/// An object on a slice. Its points are those boundary points of the object in space that lie in the slice's plane, but
/// for the lattice, which is the slice's own.
struct PlaneModel {
  Lattice lattice;                   ///< to_patient() gives LPS mm
  std::vector<LatticePoint> points;  ///< all different, with the z of the slice's plane
  /// The object's outline, from point to point, with the object on the left where x is right and y is up. In a cell
  /// whose crossings can be joined in two ways the saddle of the bilinear interpolation decides, as in
  /// marching_cubes.h. Closed if the border is; each point is then the end of one edge and the start of one.
  std::vector<std::array<std::uint32_t, 2>> contour;
  std::vector<PlaneTriangle> triangles;  ///< Delaunay; [0, inside_count) are inside, each part ascends
  std::size_t inside_count = 0;
  std::vector<Sphere> circles;       ///< in the plane, LPS mm; circles[i] is the circumcircle of triangles[i], inside
  std::uint64_t inside_samples = 0;  ///< samples of the slice that are in the object
  double area_mm2 = 0;               ///< of the inside triangles: exact in lattice units, rounded once
};

/// What the stages of pipeline.h do for a volume, in a slice from slice_of. What holds in space holds here: no point
/// lies inside any circle, every inside sample is in some inside circle and no outside one is, by the same proof. A
/// slice without a boundary gives an empty model. O(n log n) for n points; 350 bytes a point. Throws what
/// classify_samples and extract_boundary throw: `max_points` counts the crossings towards the slice's two sides too.
PlaneModel build_plane_model(const Volume& slice, const ObjectRule& rule, std::size_t max_points = std::size_t{1} << 31,
                             const Context& context = {});

}  // namespace spherule
