// SPDX-License-Identifier: GPL-3.0-or-later
//
// The connected components of a model, each with its own measures.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/measure/union.h"
#include "core/spheres.h"

namespace spherule {

struct Component {
  std::uint64_t spheres = 0;
  std::uint32_t first_sphere = 0;  ///< the smallest index of its spheres
  double volume_mm3 = 0;           ///< of the union of its spheres
  double area_mm2 = 0;
  Box bounds;  ///< LPS mm, as of the model (bounds in spheres.h)
};

/// All components, the largest volume first, then by first sphere. Of a raw model: the inside tetrahedra's, joined
/// where they share a corner, so there are betti[0] of measure_tetrahedra; their balls may overlap balls of another
/// component by less than a voxel, and a part shared counts where the power diagram puts it. Of any other model: the
/// union's, joined where balls meet (power.h): exact, so there are betti[0] of union_topology. `parts` are those of
/// measure_union(model). O(cells), 20 bytes a point and 4 a cell; or expected O(n log n), 45 bytes a ball, however many
/// overlap.
std::vector<Component> components(const SphereModel& model, std::span<const BallPart> parts,
                                  const Context& context = {});

/// Of every sphere, the smallest index of a sphere of its component: who asks only what belongs together.
std::vector<std::uint32_t> first_of_component(const SphereModel& model, const Context& context = {});

}  // namespace spherule
