// SPDX-License-Identifier: GPL-3.0-or-later
//
// Distances from samples to the nearest of a set. Private to core/simplify.
//
// Source: P. Felzenszwalb, D. Huttenlocher, Distance transforms of sampled functions (2012).
#pragma once

#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/inside.h"

namespace spherule::detail {

/// Squared distance in mm² from every sample (x fastest) to the nearest one whose bit is set; infinite where none is.
/// Exact but for rounding to float. O(samples).
std::vector<float> squared_distances(const SampleBits& set, Vec3 spacing, const Context& context);

}  // namespace spherule::detail
