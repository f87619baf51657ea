// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a registration found, applied: the moving volume or model on the grid of the fixed one.
#pragma once

#include "core/base/context.h"
#include "core/register/transform.h"
#include "core/spheres.h"
#include "core/volume.h"

namespace spherule {

/// float32 samples on `grid`: at each the moving volume's value where it comes from, by trilinear interpolation; the
/// least finite value of the volume beyond its outermost samples and next to NaN. O(samples of the grid).
Volume resampled(const Volume& moving, const AffineMap& moving_to_fixed, const Grid& grid, const Context& context = {});

/// uint8 samples on `grid`: 1 where the moving model's union of balls lies, else 0. O(samples · log balls) within the
/// model's box.
Volume sampled(const SphereModel& moving, const AffineMap& moving_to_fixed, const Grid& grid,
               const Context& context = {});

}  // namespace spherule
