// SPDX-License-Identifier: GPL-3.0-or-later
//
// The stages from a volume to its sphere model, in order, timed.
#pragma once

#include <cstddef>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/inside.h"
#include "core/spheres.h"
#include "core/volume.h"

namespace spherule {

/// Changes whenever the same input would give a different model.
inline constexpr int algorithm_version = 1;

struct ModelLimits {
  std::size_t max_points =
      100'000'000;  ///< boundary points; a model takes up to 1 KiB of memory for each while it is made
};

struct StageTime {
  std::string stage;   ///< "samples", "boundary", "delaunay", "spheres"
  double seconds = 0;  ///< wall time
};

struct BuiltModel {
  SphereModel model;
  double boundary_point_density_mm = 0;
  std::vector<StageTime> timings;
  std::vector<std::string> warnings;  ///< sentences for the user
};

/// Runs classify_samples, extract_boundary, tetrahedralize and classify_spheres. A volume in which the rule finds no
/// boundary, or too few points for a tetrahedron, is unusable; otherwise throws what the stages throw. The model is a
/// function of volume and rule alone.
BuiltModel build_model(const Volume& volume, const ObjectRule& rule, const ModelLimits& limits = {},
                       const Context& context = {});

/// The same of samples that classify_samples has given: without the stage "samples".
BuiltModel build_model(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                       const ModelLimits& limits, const Context& context = {});

}  // namespace spherule
