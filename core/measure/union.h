// SPDX-License-Identifier: GPL-3.0-or-later
//
// Exact measures of unions of balls, by their power diagram: every ball's part of the union is the ball within its own
// power cell, and these parts do not overlap.
//
// Sources: F. Aurenhammer, Power diagrams (1987); H. Edelsbrunner, The union of balls and its dual shape (1995);
// F. Cazals, H. Kanhere, S. Loriot, Computing the volume of a union of balls (2011).
#pragma once

#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/measure/mass.h"
#include "core/spheres.h"

namespace spherule {

/// One ball's part of a union. Volumes and areas of all parts add to those of the union.
struct BallPart {
  double volume_mm3 = 0;  ///< of the ball within its power cell
  double area_mm2 = 0;    ///< of its sphere on the union's surface: the derivative of the union's volume by its radius
  Vec3 push_mm2;          ///< integral of the outer normal over that area: the derivative by its centre
};

struct UnionMeasures {
  Moments moments;  ///< of the union, about the frame's origin
  double area_mm2 = 0;
  std::vector<BallPart> parts;  ///< one a ball, in order
};

/// The union of any balls: hidden, identical (the first one counts), concentric, tangent and those of radius 0 are
/// ordinary. Each ball's cell is cut out of a cube by the planes of equal power with the balls that overlap it; volume,
/// area and moments then follow from its faces in closed form (divergence theorem, Gauss-Bonnet).
/// Relative error about 1e-14 a ball. Expected O(n log n): who bounds whom is looked for among the balls that overlap
/// one where these are few dozen on average, else it is told by their power diagram (power.h, whose too_large is thrown
/// where that is larger than it may be). A ball that f others bound takes O(f²). Memory: 300 bytes a ball; 1.2 kB where
/// many overlap. Reports stage "union". Precondition: centres and radii finite, radii >= 0.
UnionMeasures measure_union(std::span<const Sphere> balls, const Context& context = {});

/// Where three or more spheres meet on the surface of the union of any balls: each such point about once for each of
/// them, up to rounding. Cost, memory and preconditions as above.
std::vector<Vec3> union_corners(std::span<const Sphere> balls, const Context& context = {});

/// What of a ball's sphere would be on the surface of the union of all, mm²: its area in its power cell. Of identical
/// balls it counts as the first. O(n log n + f²) for f balls that bound it; 60 bytes a ball.
double exposed_area(const Sphere& ball, std::span<const Sphere> others, const Context& context = {});

/// The union of a raw model's balls. The power diagram of all circumspheres is the tetrahedralization itself, so the
/// union is the inside tetrahedra and what balls have beyond their boundary facets: only the cells of these balls are
/// computed, each from its tetrahedron and the other balls that reach beyond the solid near it. A part is its cell's
/// tetrahedron and what its ball has beyond; of cells that share a ball, the first one has that. Relative error of
/// volume and area below 1e-9: balls that differ by less than 2^-27 of their radius count as one. Expected O(cells);
/// memory about 140 bytes an inside cell. Precondition: model.solid. Reports stage "union".
UnionMeasures measure_raw_union(const SphereModel& model, const Context& context = {});

/// measure_raw_union for a model with a solid, measure_union for any other.
UnionMeasures measure_union(const SphereModel& model, const Context& context = {});

}  // namespace spherule
