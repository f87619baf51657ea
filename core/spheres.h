// SPDX-License-Identifier: GPL-3.0-or-later
//
// Tetrahedralization + Volume -> SphereModel: every circumsphere classified as inside or outside the object.
// Source: Ranjan and Fournier (1994), section 3.2, with the decision made exact: a ball that holds any sample holds
// the sample nearest to its centre, and all samples in an empty ball agree.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/boundary.h"
#include "core/delaunay.h"

namespace spherule {

/// The solid behind a raw model. Cells [0, inside_count) are inside, the rest outside; each part ascends.
struct Solid {
  BoundaryPoints boundary;
  Tetrahedralization cells;
  std::size_t inside_count = 0;
};

/// An object as a union of balls, in LPS mm. A raw model also has its solid: then spheres[i] is the circumsphere
/// of solid->cells[i], its radius the least distance from the computed centre to the four corners.
/// Immutable by convention once made; safe to share between threads.
struct SphereModel {
  std::vector<Sphere> spheres;
  std::optional<Solid> solid;  ///< absent for imported and simplified sets
};

/// Classifies every cell of `cells` and keeps both representations. `samples` and `boundary` must belong to `volume`
/// and `rule`. A cell is decided by the grid sample nearest to the centre of its circumsphere when that sample is
/// strictly inside the sphere (an exact test), else by trilinear interpolation at the centre (of the values; of the 0/1
/// indicator for labels). Centres outside the grid (closed: the padded grid) that no sample decides are outside.
/// O(cells); beside its arguments 32 bytes an inside cell, and 17 an outside one for a while.
SphereModel classify_spheres(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                             BoundaryPoints boundary, Tetrahedralization cells, const Context& context = {});

/// The circumsphere of four points that are not in one plane, in lattice units; the radius is the least distance from
/// the computed centre to a corner. The relative error of each component of the centre's offset from the first corner
/// is below 2^-50.
Sphere circumsphere(const std::array<LatticePoint, 4>& corners);

/// Circumspheres in LPS mm of cells [0, count), from exact integer determinants: relative error of the centre's offset
/// from the first corner below 2^-50 for any sliver. O(count).
std::vector<Sphere> circumspheres(const Lattice& lattice, std::span<const LatticePoint> points,
                                  std::span<const Tetrahedron> cells, std::size_t count, const Context& context = {});

/// Boundary point density of the paper: the largest distance from a boundary point to its nearest other one, mm
/// (nearest neighbours are joined by Delaunay edges). 0 without cells. O(cells); 8 bytes a point.
double boundary_point_density(const Solid& solid, const Context& context = {});

/// Box of the model in LPS mm: of the boundary points of a raw model, of the balls of any other. Empty for an empty
/// model.
Box bounds(const SphereModel& model);

}  // namespace spherule
