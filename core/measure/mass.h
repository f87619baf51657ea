// SPDX-License-Identifier: GPL-3.0-or-later
//
// Mass properties of a solid of density 1: what every representation's volume integrals come down to.
#pragma once

#include <array>

#include "core/base/geometry.h"

namespace spherule {

/// The integrals of 1, x and x·xᵀ over a solid, about an origin that the maker states. Solids that do not overlap add.
struct Moments {
  double volume = 0;                      ///< mm³
  Vec3 first;                             ///< mm⁴
  Mat3 second{{Vec3{}, Vec3{}, Vec3{}}};  ///< mm⁵, symmetric

  Moments& operator+=(const Moments& other);
};

/// Adds weight · a · bᵀ, what second moments are made of.
inline void add_outer(Mat3& sum, double weight, Vec3 a, Vec3 b) {
  for (std::size_t i = 0; i < 3; ++i) sum.rows[i] = sum.rows[i] + weight * a[static_cast<int>(i)] * b;
}

/// The same solid's integrals about an origin that lies at -shift as seen from the old one: every point moves by
/// `shift`.
Moments translated(const Moments& moments, Vec3 shift);

/// The same solid seen in other units and axes: every point x becomes scale · axes · x; `axes` orthonormal.
Moments transformed(const Moments& moments, const Mat3& axes, double scale);

/// For density 1 per mm³, so that mass is volume. Zeros, with the axes of the frame, for a solid without volume.
struct MassProperties {
  double volume_mm3 = 0;
  Vec3 centroid_mm;
  Mat3 inertia_mm5{{Vec3{}, Vec3{}, Vec3{}}};     ///< about the centroid, along the axes of the frame
  std::array<double, 3> principal_moments_mm5{};  ///< ascending
  Mat3 principal_axes;  ///< row i belongs to moment i; right-handed, the largest component of rows 0 and 1 is positive
};

/// `moments` about the frame's origin.
MassProperties mass_properties(const Moments& moments);

}  // namespace spherule
