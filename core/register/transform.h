// SPDX-License-Identifier: GPL-3.0-or-later
//
// Transforms of space, and the ways to tell them to people and programs.
#pragma once

#include <array>

#include "core/base/geometry.h"

namespace spherule {

/// x -> linear · x + shift. Lengths in mm.
struct AffineMap {
  Mat3 linear;
  Vec3 shift;

  constexpr Vec3 operator()(Vec3 x) const { return linear * x + shift; }
  friend constexpr bool operator==(const AffineMap&, const AffineMap&) = default;
};

/// First b, then a.
constexpr AffineMap composed(const AffineMap& a, const AffineMap& b) { return {a.linear * b.linear, a(b.shift)}; }

Mat3 scaled(double factor, const Mat3& m);  ///< each entry times the factor
/// Precondition: determinant(m) != 0.
Mat3 inverse(const Mat3& m);
AffineMap inverse(const AffineMap& map);

/// Whether a map is finite, can be undone and keeps left and right apart: its determinant, whose size is left out of
/// account, is positive.
bool is_proper(const AffineMap& map);

/// The factor by which lengths grow: the cube root of that of volumes. Precondition: is_proper.
double scale_of(const AffineMap& map);

/// A unit quaternion: the rotation by 2 acos(w) about (x, y, z). q and -q are the same rotation.
struct Quaternion {
  double w = 1, x = 0, y = 0, z = 0;
};
Mat3 rotation(const Quaternion& unit);
/// The rotation by |v| radians about v.
Mat3 rotation(Vec3 v);
/// Of a rotation matrix; w >= 0.
Quaternion quaternion(const Mat3& rotation);
/// The angle of the rotation that leads from a to b, in degrees, 0 … 180.
double angle_between(const Mat3& a, const Mat3& b);
/// The rotation nearest to a matrix of positive determinant (of its polar decomposition).
Mat3 nearest_rotation(const Mat3& m);

/// x -> rotation · diag(scales) · shear · (x - centre) + centre + translation.
struct Decomposition {
  Mat3 rotation;
  Quaternion quaternion;  ///< of `rotation`
  Vec3 axis{0, 0, 1};     ///< of `rotation`; z where the angle is 0
  double angle_deg = 0;   ///< about `axis`, 0 … 180
  /// rotation = Rz(z) · Ry(y) · Rx(x): about the fixed x axis first, then y, then z. Degrees; y within ±90.
  Vec3 euler_xyz_deg;
  Vec3 scales{1, 1, 1};  ///< positive
  Vec3 shear;            ///< elements xy, xz, yz of the upper unit triangular `shear`; 0 unless affine
  Vec3 translation;      ///< mm
  Vec3 centre;           ///< mm
};

/// By the QR decomposition. For a similarity the scales are equal and the shear is 0, to rounding. Precondition:
/// is_proper.
Decomposition decompose(const AffineMap& map, Vec3 centre);
/// The inverse of decompose.
AffineMap composed(const Decomposition& parts);

}  // namespace spherule
