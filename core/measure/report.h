// SPDX-License-Identifier: GPL-3.0-or-later
//
// All measures of a model, of each representation that it has: what a user who asks for its measures gets.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/compare/marching_cubes.h"
#include "core/inside.h"
#include "core/measure/components.h"
#include "core/measure/mass.h"
#include "core/measure/solid.h"
#include "core/measure/thickness.h"
#include "core/measure/union.h"
#include "core/spheres.h"
#include "core/volume.h"

namespace spherule {

/// Beyond, the search would take longer than all other measures.
inline constexpr std::size_t largest_inscribed_limit = 100'000;

/// Of the union of a model's spheres.
struct SpheresMeasures {
  std::uint64_t count = 0;
  double radius_min_mm = 0, radius_max_mm = 0;
  MassProperties mass;
  double area_mm2 = 0;
  Box bounds;         ///< of the balls, LPS mm
  Topology topology;  ///< raw: of the inside tetrahedra (measure_tetrahedra); else union_topology, exact
};

struct ModelMeasures {
  SpheresMeasures spheres;
  std::optional<VoxelMeasures> voxels;  ///< these four: raw models only
  std::optional<TetrahedraMeasures> tetrahedra;
  std::optional<MarchingCubesMeasures> marching_cubes;
  std::optional<Observations> observations;
  /// The second one is largest_inscribed_sphere, of sets without a solid and of up to largest_inscribed_limit balls; of
  /// others largest_sphere (enclosing.h says what that is).
  Sphere smallest_enclosing, largest_inscribed;
  LocalThickness thickness;
  std::vector<Component> components;  ///< largest first
};

/// What a raw model was made from.
struct MeasuredObject {
  const Volume& volume;
  const ObjectRule& rule;
};

/// Everything but the union, which must be measure_union(model). `object` must be given for a raw model, and only for
/// one. Costs the sum of its parts; the stages reported are theirs.
ModelMeasures measure_model(const SphereModel& model, const UnionMeasures& whole,
                            const std::optional<MeasuredObject>& object, const Context& context = {});

}  // namespace spherule
