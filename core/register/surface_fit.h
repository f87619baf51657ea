// SPDX-License-Identifier: GPL-3.0-or-later
//
// The last step of registration: one surface moved onto the other.
//
// Sources: Y. Chen, G. Medioni, Object modelling by registration of multiple range images (1992), for distances to
// tangent planes; D. Chetverikov, D. Stepanov, P. Krsek, Robust Euclidean alignment of 3D point sets: the trimmed
// iterative closest point algorithm (2005), for leaving out what has no partner.
#pragma once

#include "core/base/context.h"
#include "core/register/shape.h"
#include "core/register/solve.h"

namespace spherule {

struct SurfaceFitOptions {
  TransformKind kind = TransformKind::similarity;
  std::size_t samples = 2000;  ///< points of each surface that are led to the other
  int iterations = 30;         ///< at most
  double reach_mm = 0;         ///< pairs farther apart than this do not count, at first
  Vec3 centre;                 ///< about which the fixed surface lies
  double size_mm = 1;          ///< its size, about
  double min_scale = 0, max_scale = 1e9;
};

/// Steps from `start`: every sample of either surface goes with the nearest point of the other, and a Gauss-Newton step
/// makes the distances from the tangent planes small. Pairs count by Tukey's biweight of their distance, whose reach
/// shrinks with the median of the distances down to twice the spacing of the coarser points, and by how well their
/// normals agree: so what only one surface has does not pull. Both directions count, which keeps the scale from
/// shrinking. Stops when a step moves nothing by more than a thousandth of the spacing. A function of its arguments
/// alone. O(iterations · samples · log points).
AffineMap fit_surfaces(const Surface& fixed, const Surface& moving, const AffineMap& start,
                       const SurfaceFitOptions& options);

/// How well two surfaces agree, of samples of both: distances from the tangent disks (of the points' spacing) at the
/// nearest points of the other.
struct SurfaceDistance {
  double agreement = 0;  ///< mean of Tukey's biweight of distance, times the cosine between normals where positive: 0 … 1
  double mean_mm = 0, p95_mm = 0;
  double within = 0;  ///< share of the samples closer than `reach`
};
SurfaceDistance surface_distance(const Surface& fixed, const Surface& moving, const AffineMap& map, std::size_t samples,
                                 double reach_mm, const Context& context = {});

}  // namespace spherule
