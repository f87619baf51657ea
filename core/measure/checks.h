// SPDX-License-Identifier: GPL-3.0-or-later
//
// The representation's own guarantees, checked on one model. Of the paper's four criteria (section 3.2) the first three
// are theorems here (core/README.md), so a violation is a defect of this program, not of the scan. The fourth can fail
// at single points where voxels are much flatter than wide. The bounds are the paper's observations 1, 3 and 5.
#pragma once

#include <cstdint>

#include "core/base/context.h"
#include "core/inside.h"
#include "core/spheres.h"

namespace spherule {

struct CriteriaReport {
  std::uint64_t inside_samples_not_covered =
      0;  ///< inside samples in no inside ball (open border: of those within the hull)
  std::uint64_t outside_samples_covered = 0;  ///< outside samples strictly in an inside ball
  std::uint64_t boundary_points_inside_balls =
      0;                                         ///< facets that are not Delaunay: 0 means no point is inside any ball
  std::uint64_t boundary_points_on_no_ball = 0;  ///< boundary points on no inside ball

  std::uint64_t violations() const {
    return inside_samples_not_covered + outside_samples_covered + boundary_points_inside_balls +
           boundary_points_on_no_ball;
  }
};

struct BoundsReport {
  double density_mm = 0;                ///< the boundary point density
  double density_bound_mm = 0;          ///< the diagonal of one voxel, plus one lattice unit for rounding
  double cells_per_point = 0;           ///< inside cells per boundary point; about 4 in practice
  double tetrahedra_volume_mm3 = 0;     ///< V_T
  double spheres_volume_bound_mm3 = 0;  ///< V_T + (N - 2)·V_density, an upper bound of the union's volume
};

struct ModelChecks {
  CriteriaReport criteria;  ///< violations of the guarantees
  BoundsReport bounds;      ///< the paper's, beside what they bound
};

/// Checks a raw model against the samples that it was made from. O(cells + rows of samples inside balls).
/// Memory: 60 bytes a cell, 28 a point and 2 bits a sample. Polls for cancellation between rows.
/// Precondition: model.solid. Balls are compared with samples in exact integer arithmetic.
ModelChecks check_model(const SphereModel& model, const SampleBits& inside, Border border, const Context& context = {});

}  // namespace spherule
