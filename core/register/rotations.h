// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rotations spread evenly over all of them.
// Source: M. Alexa, Super-Fibonacci spirals: fast, low-discrepancy sampling of SO(3), CVPR 2022.
#pragma once

#include <cstdint>
#include <vector>

#include "core/register/transform.h"

namespace spherule {

/// `count` rotations. Of 4,608, none is farther than about 14 degrees from the nearest (of n: 14 · (4608 / n)^(1/3)).
/// Seed 0 gives the source's own; any other turns them all by one rotation that the seed picks.
std::vector<Mat3> even_rotations(std::size_t count, std::uint64_t seed = 0);

}  // namespace spherule
