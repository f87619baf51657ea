// SPDX-License-Identifier: GPL-3.0-or-later
//
// What registration looks at of a model: a few spheres with their masses, and its surface.
//
// Source of the normals: N. Amenta, M. Bern, Surface reconstruction by Voronoi filtering (1999): the largest inside
// ball at a boundary point, its pole, lies in the direction against the normal.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/spheres.h"
#include "core/trees/point_tree.h"

namespace spherule {

/// Points on a surface with their outer unit normals.
struct Surface {
  std::vector<Vec3> points, normals;
  detail::PointTree tree{{}};  ///< of the points
  double spacing_mm = 0;       ///< between neighbouring points, about

  std::size_t size() const { return points.size(); }
};

struct Shape {
  double volume_mm3 = 0;  ///< exact: of the tetrahedra of a raw model, of the union of any other
  Vec3 centroid;
  Mat3 covariance;              ///< of the solid about its centroid, mm²
  double radius_max_mm = 0;     ///< of all spheres
  std::vector<Sphere> spheres;  ///< at most k, for the model
  std::vector<double> masses;   ///< of each: the exact volume of what it stands for, mm³
  Surface surface;

  double size_mm() const;  ///< cube root of the volume
};

/// The model simplified to k spheres by average splitting (as it is where it has no more), and at most `most_points`
/// points of its surface: of a raw model the boundary points, of any other evenly spread points of the exposed spheres.
/// Throws unusable for a model without volume. O(cells log k).
Shape shape_of(const SphereModel& model, std::uint32_t k, std::size_t most_points = 40'000,
               const Context& context = {});

}  // namespace spherule
