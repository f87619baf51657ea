// SPDX-License-Identifier: GPL-3.0-or-later
//
// The paper's registration: simplify both models to as many spheres, match these, derive the transform from the pairs.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 4; matching and transform are solved
// exactly here.
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/context.h"
#include "core/register/shape.h"
#include "core/register/solve.h"

namespace spherule {

/// What makes two spheres a bad pair. All >= 0.
struct MatchingWeights {
  double position = 1;  ///< of the distance between centres, in cube roots of the fixed model's volume
  double size = 0.2;    ///< of |log of the ratio of radii|
  double shape = 1;     ///< of the difference between what does not depend on the pose (match_features)
  double alone = 0.5;   ///< what it costs that a moving sphere has no partner
};

struct SpherePair {
  std::uint32_t moving = 0, fixed = 0;  ///< indices into the shapes' spheres
  friend bool operator==(const SpherePair&, const SpherePair&) = default;
};

/// Of every sphere, in units of the shape's size: how far it is from the centroid, the cube root of its share of the
/// volume, and how far its six nearest are on average. The same in every pose and scale.
std::vector<Vec3> match_features(const Shape& shape);

/// The pairs of the least cost in all when the moving shape is where `map` takes it. `position` 0: wherever it is.
/// O(k³). Throws cancelled.
std::vector<SpherePair> match_spheres(const Shape& fixed, const Shape& moving, const AffineMap& map,
                                      const MatchingWeights& weights, const Context& context = {});

/// Ends of pairs as points; each weighs the root of the product of its spheres' shares of the volumes.
std::vector<PointPair> point_pairs(const Shape& fixed, const Shape& moving, std::span<const SpherePair> pairs);

/// Matching and solving in turn, from `start` until the pairs stay the same, at most `rounds` times.
AffineMap match_from(const Shape& fixed, const Shape& moving, const AffineMap& start, TransformKind kind,
                     const MatchingWeights& weights, int rounds = 30, const Context& context = {});

/// The scale that the paper takes: the ratio of the largest radii, fixed over moving.
double radius_ratio(const Shape& fixed, const Shape& moving);

}  // namespace spherule
