// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where the surface of a union of balls is, and which ball makes it there.
//
// A ray tracer that is given raw balls must try hundreds of them a ray: they overlap heavily, yet each shows only a
// small patch. So the tracer gets the patches: small boxes, each with the ball that it belongs to. The boxes together
// hold the union's whole surface; what they hold besides does no harm, since a point where a ray enters a ball is a
// point of the union, and thus never before the point where the ray enters the union.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/spheres.h"

namespace spherule {

struct Patch {
  Box box;                 ///< LPS mm
  std::uint32_t ball = 0;  ///< index into model.spheres
};

/// Every point of the union's surface that lies on ball b (and on no other, but for rounding) is in a patch of b.
/// Raw models: one patch a facet between an inside cell and anything else, the box of the cap that the cell's ball
/// raises over it (no other part of a ball can be seen, see patches.cpp); O(cells).
/// Other models: an octree over the balls, each leaf with the few balls that may reach the surface in it;
/// O(balls · levels) in practice; at most 2^19 + 16 · balls patches, 2^26 + 128 · balls looks at a ball in each level.
/// Balls of radius 0 have no patch.
std::vector<Patch> visible_patches(const SphereModel& model, const Context& context = {});

}  // namespace spherule
