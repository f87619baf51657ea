// SPDX-License-Identifier: GPL-3.0-or-later
//
// All balls moved at once, so that their union overlaps more with the object. Private to core/simplify.
//
// Sources: D. Kingma, J. Ba, Adam: a method for stochastic optimization (2015).
#pragma once

#include <vector>

#include "core/base/context.h"
#include "core/sampled/object.h"

namespace spherule::detail {

/// Balls (mm along the grid's axes) after so many steps up the gradient of Fit's score with softened balls: a sample
/// within `soft` of a ball's surface counts in part, linearly; the union holds what not all balls leave out,
/// 1 - Π (1 - part). `soft` shrinks from 1 to 0.4 voxels, and steps from 0.5 to 0.1. Not sure to score better, least of
/// all where balls hold few samples. The same for any number of threads. A step takes O(samples in the balls and the
/// object's box); 5 bytes a sample of that and of a margin around.
std::vector<Sphere> moved_together(std::vector<Sphere> balls, const SampledObject& object, int steps,
                                   const Context& context);

}  // namespace spherule::detail
