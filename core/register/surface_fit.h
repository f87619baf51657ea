// SPDX-License-Identifier: GPL-3.0-or-later
//
// The last step of registration: one surface moved onto the other.
//
// Sources: S. Rusinkiewicz, A symmetric objective function for ICP (2019): distances along the mean of both normals,
// which vanish for any two points of one sphere, so curved surfaces met at points do not seem larger than they are; D.
// Chetverikov, D. Stepanov, P. Krsek, Robust Euclidean alignment of 3D point sets: the trimmed iterative closest point
// algorithm (2005), for leaving out what has no partner.
#pragma once

#include "core/base/context.h"
#include "core/register/shape.h"
#include "core/register/solve.h"

namespace spherule {

struct SurfaceFitOptions {
  TransformKind kind = TransformKind::similarity;
  std::size_t samples = 2000;  ///< points of each surface that are led to the other
  int iterations = 30;         ///< at most
  double settled = 0.003;      ///< stops when no point moves by more than this part of the spacing
  double reach_mm = 0;         ///< pairs farther apart than this do not count, at first
  Vec3 centre;                 ///< about which the fixed surface lies
  double size_mm = 1;          ///< its size, about
  double min_scale = 0, max_scale = 1e9;
};

/// Steps from `start`: every sample of either surface goes with the nearest point of the other, and a Gauss-Newton step
/// makes their distances along the mean of both normals small. Pairs count by Tukey's biweight of their distance, whose
/// reach shrinks with the median of the distances down to twice the spacing of the coarser points, and by how well
/// their normals agree: so what only one surface has does not pull. Both directions count, which keeps the scale from
/// shrinking. A function of surfaces, start and options alone. O(iterations · samples · log points).
AffineMap fit_surfaces(const Surface& fixed, const Surface& moving, const AffineMap& start,
                       const SurfaceFitOptions& options, const Context& context = {});

/// How well two surfaces agree, of samples of both: distances from the nearest points of the other, but for what lies
/// along the surface within the points' spacing.
struct SurfaceDistance {
  double agreement = 0;  ///< surface_agreement
  double mean_mm = 0, p95_mm = 0;
  double fixed_within = 0, moving_within = 0;  ///< share of either surface's samples closer to the other than `reach`
};
SurfaceDistance surface_distance(const Surface& fixed, const Surface& moving, const AffineMap& map, std::size_t samples,
                                 double reach_mm, const Context& context = {});

/// Mean of Tukey's biweight of that distance, times the cosine between the normals where positive: 0 … 1. Looks no
/// farther than `reach_mm`, so it is quick for bad maps, too.
double surface_agreement(const Surface& fixed, const Surface& moving, const AffineMap& map, std::size_t samples,
                         double reach_mm);

}  // namespace spherule
