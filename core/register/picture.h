// SPDX-License-Identifier: GPL-3.0-or-later
//
// A registration to look at.
#pragma once

#include "core/register/transform.h"
#include "core/render/render.h"

namespace spherule {

/// Two pictures side by side, each of both models overlaid: on the left where they were, on the right with the moving
/// one where the map takes it. Each fits its own pair. Balls under an affine map are drawn as balls of equal volume.
/// Throws what render does; unusable for styles that only raw models have.
Image before_and_after(const SphereModel& fixed, const SphereModel& moving, const AffineMap& moving_to_fixed,
                       const RenderOptions& options = {}, const Context& context = {});

}  // namespace spherule
