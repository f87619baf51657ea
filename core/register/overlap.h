// SPDX-License-Identifier: GPL-3.0-or-later
//
// How well two sets of soft balls overlap, over all poses: the smooth function that global registration climbs.
//
// Sources: B. Jian, B. Vemuri, Robust point set registration using Gaussian mixture models (2011), for the overlap of
// mixtures; its maximiser is the minoriser's, as in A. Myronenko, X. Song, Point set registration: coherent point
// drift (2010).
#pragma once

#include <array>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/register/transform.h"

namespace spherule {

/// Mass spread about a centre like a Gaussian with this standard deviation. Instead of exp(-u) the kernel is
/// (1 - u/16)^16 for u < 16 and 0 beyond: within 0.018 of it, as smooth as any search needs, and nothing but
/// multiplications, so that vectors of it are fast and the same everywhere.
struct SoftBall {
  Vec3 centre;
  double sigma = 1;
  double mass = 1;
};
using SoftBalls = std::vector<SoftBall>;

/// x -> scale · rotation · x + shift.
struct Pose {
  Mat3 rotation;
  double scale = 1;
  Vec3 shift;

  Vec3 operator()(Vec3 x) const { return scale * (rotation * x) + shift; }
  AffineMap map() const { return {scaled(scale, rotation), shift}; }
};

/// The overlap and how it changes with a small step of the posed moving set: turns about x, y, z through the origin
/// (radians), shifts, and growth (relative), in this order.
struct OverlapValue {
  double value = 0;
  std::array<double, 7> gradient{};
  /// Of the quadratic that lies below value (for turns and shifts; the kernel is convex in the squared distance) and
  /// touches it here: positive semidefinite, so value falls by at most half of step · curvature · step.
  std::array<std::array<double, 7>, 7> curvature{};
};

/// The integral of the product of fixed and posed moving set, over the root of the product of both sets' integrals with
/// themselves: 1 where they are the same, near 0 where they are apart. Moving sigmas grow with the scale, and masses
/// with its cube. `own` must be self_overlap(fixed) · self_overlap(moving). O(fixed · moving).
OverlapValue overlap(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& pose, double own);
double self_overlap(std::span<const SoftBall> balls);

/// The same value, in single precision, at every one of these rotations (scale 1, no shift). O(rotations · fixed ·
/// moving), on vectors.
std::vector<float> overlaps(std::span<const SoftBall> fixed, std::span<const SoftBall> moving,
                            std::span<const Mat3> rotations, const Context& context = {});

/// A local maximum.
struct Climbed {
  Pose pose;
  double value = 0;
};
/// Damped Newton steps uphill from `start` on the curvature above, with or without the scale, until one gains little or
/// after `steps`. Never below where it began.
Climbed climb(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& start, bool scale_too,
              int steps, const Context& context = {});

}  // namespace spherule
