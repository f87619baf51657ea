// SPDX-License-Identifier: GPL-3.0-or-later
//
// The transform that takes points to their partners best: closed forms.
// Source: S. Umeyama, Least-squares estimation of transformation parameters between two point patterns (1991).
#pragma once

#include <cstdint>
#include <span>

#include "core/register/transform.h"

namespace spherule {

enum class TransformKind : std::uint8_t {
  rigid,       ///< rotation and shift
  similarity,  ///< and one scale
  affine,      ///< any linear map that keeps the handedness
};

/// A moving point and where it belongs.
struct PointPair {
  Vec3 moving, fixed;
  double weight = 1;  ///< >= 0
};

/// The map T of that kind with the least sum of weight · |fixed - T(moving)|². Never a reflection: where that would be
/// better the best proper map is found (for affine: the best similarity). Points that leave the answer open (all in a
/// line; for affine in a plane) give one of the best similarities. The identity for no weight at all. O(pairs).
AffineMap solve(TransformKind kind, std::span<const PointPair> pairs);

/// sqrt(sum weight · |fixed - T(moving)|² / sum weight); 0 for no weight.
double rms_residual(const AffineMap& map, std::span<const PointPair> pairs);

}  // namespace spherule
