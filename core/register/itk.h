// SPDX-License-Identifier: GPL-3.0-or-later
//
// A transform as a file for ITK, 3D Slicer, ANTs and elastix.
#pragma once

#include <string>

#include "core/register/transform.h"

namespace spherule {

/// "Insight Transform File V1.0" with one AffineTransform_double_3_3, whose frame is LPS mm like ours. ITK resamples an
/// image by asking where each point of the result comes from, so the file that lays a moving volume on a fixed one
/// holds the map of fixed points to moving points: pass fixed_to_moving. Shortest decimals that read back the same.
std::string itk_transform(const AffineMap& fixed_to_moving);

}  // namespace spherule
