// SPDX-License-Identifier: GPL-3.0-or-later
//
// The smallest ball around a set of balls, and the largest within their union.
#pragma once

#include <span>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// The smallest ball that holds all balls, by CGAL's Min_sphere_of_spheres_d (K. Fischer, B. Gärtner, The smallest
/// enclosing ball of balls, 2003) in double arithmetic; the radius is then set to the distance from the centre to the
/// farthest point of any ball, so it is never too small by more than one rounding, and seldom larger than the least by
/// more than a relative 1e-12. A ball of radius 0 at the origin for no balls. Expected O(n), about 30 ns a ball, during
/// which the library cannot be cancelled; 8 bytes a ball.
Sphere smallest_enclosing_sphere(std::span<const Sphere> balls);

/// The largest of the balls, the first of equal ones; a ball of radius 0 at the origin for none. Of a raw model: no
/// ball that holds no boundary point and whose centre is inside is larger, for the circumspheres of a Delaunay
/// tetrahedralization are the largest empty balls. Of any other set: the union may hold a larger one that no member is.
Sphere largest_sphere(std::span<const Sphere> balls);

/// The largest ball within the union of any balls, to a relative 1e-9. A ball that touches the union's surface within a
/// patch or a crease is not larger than a member; any other largest one touches it at corners alone, so that its centre
/// is a Voronoi vertex of them (N. Amenta, R. Kolluri, The medial axis of a union of balls, 2001). Those are tried,
/// larger ones first: one is within the union when adding it adds no surface. Expected O(n log n): on random balls
/// about eight times as long as measure_union, and 2 kB a ball. Reports stage "inscribed". Throws cancelled, and
/// too_large where the diagrams behind it have more than most_cells (most_cells.h).
Sphere largest_inscribed_sphere(std::span<const Sphere> balls, const Context& context = {});

}  // namespace spherule
