// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the methods share in making their results, private to core/simplify.
#pragma once

#include <cstdint>
#include <span>
#include <string>
#include <utility>
#include <vector>

#include "core/base/error.h"
#include "core/simplify/result.h"

namespace spherule::detail {

/// Throws invalid_argument, naming `field`, unless 1 <= k <= count.
void require_k(std::uint64_t k, std::size_t count, const std::string& field = "k");

/// Spheres of the last level with their members, in any order.
using LeafMembers = std::vector<std::pair<std::uint32_t, std::span<std::uint32_t>>>;

/// Sorts each leaf's members and puts them into the result.
void set_members(Simplification& result, LeafMembers& leaves);

}  // namespace spherule::detail
