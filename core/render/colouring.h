// SPDX-License-Identifier: GPL-3.0-or-later
//
// Numbers of balls as colours. Private to core/render.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/spheres.h"

namespace spherule {

/// Numbers of connected pieces: 0 for the one with the most members, and so on (the first member decides among
/// equals). Of a model's spheres, as components.h says; of triangles' vertices, O(triangles). Throws
/// cancelled.
std::vector<std::uint32_t> pieces(const SphereModel& model, const Context& context);
std::vector<std::uint32_t> pieces(std::size_t vertices, std::span<const std::array<std::uint32_t, 3>> triangles,
                                  const Context& context);

/// The numbers below which a 100th and above which a 100th of `values` lie, made a little different when equal;
/// {0, 1} for none. Reorders a copy.
std::array<double, 2> middle_range(std::vector<double> values);

}  // namespace spherule
