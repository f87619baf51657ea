// SPDX-License-Identifier: GPL-3.0-or-later
//
// The smallest sphere around a set of balls.
//
// Source: K. Fischer, B. Gärtner, The smallest enclosing ball of balls (2003): the primitive of up to four balls, and
// farthest-first pivoting.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/geometry.h"

namespace spherule {

struct Enclosing {
  Sphere sphere;
  /// Up to four of the balls, which alone have this enclosing sphere: it stays the smallest for any subset with them.
  std::vector<std::uint32_t> support;
};

/// The smallest sphere that holds the balls `members` (indices into `balls`, at least one). Every member is inside
/// within rounding: |centre - c| + r <= radius in double arithmetic. The radius is at most a relative 1e-12 above the
/// least. Expected about ten passes over the members.
Enclosing smallest_enclosing(std::span<const Sphere> balls, std::span<const std::uint32_t> members);

}  // namespace spherule
