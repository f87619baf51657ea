// SPDX-License-Identifier: GPL-3.0-or-later
//
// How far a simplified model is from its object.
#pragma once

#include <cstdint>
#include <optional>
#include <span>

#include "core/base/context.h"
#include "core/measure/solid.h"
#include "core/sampled/object.h"
#include "core/spheres.h"

namespace spherule {

/// What of the model is compared with: of its tetrahedra when it is raw, of the union of its balls else.
struct Reference {
  double area_mm2 = 0;
  Topology topology;
};
/// O(cells), or what measure_union and union_topology take.
Reference reference_of(const SphereModel& model, const Context& context = {});

/// Relative errors are value / truth - 1.
struct Achieved {
  std::uint64_t spheres = 0;
  double iou = 0;             ///< samples in both object and balls / samples in either
  double object_mm3 = 0;      ///< inside samples times the volume of one
  double covered_mm3 = 0;     ///< of the object, in balls
  double spilled_mm3 = 0;     ///< in balls, outside the object
  bool never_spills = false;  ///< proven, see object.h: no ball touches an outside sample
  bool covers_all = false;    ///< likewise: every inside sample is in a ball
  double volume_mm3 = 0;      ///< of the union, exact
  double volume_error = 0;
  double area_mm2 = 0;  ///< of the union, exact
  double area_error = 0;
  /// Hausdorff distance between the samples in the object and those in balls: exact for samples, so known of the solids
  /// to a diagonal of a voxel. Absent when no sample is in any ball.
  struct Hausdorff {
    double mm = 0;           ///< the larger of the next two
    double to_spheres = 0;   ///< the farthest sample of the object from the nearest one in a ball, mm
    double to_object = 0;    ///< the farthest sample in a ball from the nearest one of the object, mm
    double of_diagonal = 0;  ///< mm over the diagonal of the box of the object's samples
  };
  std::optional<Hausdorff> hausdorff;
  Topology before, after;
};

/// Precondition: the object has samples. O(samples of the box around object and balls), 5 bytes each: coarser samples
/// stand in for the Hausdorff distance where the box has more than 2^27. Reports stage "evaluate".
Achieved evaluate(std::span<const Sphere> balls, const SampledObject& object, const Reference& reference,
                  const Context& context = {});

}  // namespace spherule
