// SPDX-License-Identifier: GPL-3.0-or-later
//
// Volume -> triangles: the surface that marching cubes draw through the boundary points. The standard that spheres and
// tetrahedra are compared with.
//
// Sources: W. Lorensen, H. Cline, Marching Cubes (1987); G. Nielson, B. Hamann, The Asymptotic Decider (1991).
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/boundary.h"
#include "core/inside.h"
#include "core/volume.h"

namespace spherule {

/// Triangles by their corners, counter-clockwise as seen from outside the object. LPS mm.
struct Mesh {
  std::vector<Vec3> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

/// Of the surface through the boundary points, and of the solid that it bounds.
struct MarchingCubesMeasures {
  double volume_mm3 = 0;  ///< exact in lattice units (128-bit sum), rounded once; open border: of the part in the grid
  double area_mm2 = 0;    ///< open border: without the cut; relative rounding below 1e-14
  std::uint64_t triangles = 0;  ///< as in `area_mm2`
  std::int64_t euler_characteristic =
      0;  ///< of the solid, with the cut of an open border: half of its closed surface's
};

// How cells are cut. Every cell's surface crosses its edges at the boundary points and nowhere else. On a face whose
// crossings can be joined in two ways, the saddle of the bilinear interpolation of its values decides (labels: inside
// is joined), so the cells on both sides agree and the surface has no holes. Inside a cell every loop of crossings
// spans a disc: tunnels that the trilinear interpolation may have within one cell are not drawn. The surface of a
// range is that of both of its values, also where the range is jumped over between two samples; where they are closer
// than the discs are flat they may cross, and the little volume between is then counted as negative.
//
// `samples` and `boundary` must belong to `volume` and `rule`; neither is changed. Both functions throw nothing
// but cancelled, take O(samples / 64 + points), report stage "marching cubes", and give the same for any thread count.

/// The surface. Vertex i is boundary point i. With a closed border each edge of a triangle is met by as many triangles
/// in one direction as in the other; with an open one that fails only on the grid's border.
Mesh marching_cubes(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                    const BoundaryPoints& boundary, const Context& context = {});

/// Measures of that surface without keeping it; memory: a few planes of the grid a thread.
MarchingCubesMeasures measure_marching_cubes(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                                             const BoundaryPoints& boundary, const Context& context = {});

}  // namespace spherule
