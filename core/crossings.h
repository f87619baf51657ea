// SPDX-License-Identifier: GPL-3.0-or-later
//
// How rich a surface is, before memory is taken for it. (Beside boundary.h, so that whoever only counts reads no more.)
#pragma once

#include <cstddef>

#include "core/inside.h"

namespace spherule {

/// How many points extract_boundary() would make. O(samples / 64 + points); takes no memory.
std::size_t count_boundary_points(const InsideSamples& samples, Border border, const Context& context = {});

}  // namespace spherule
