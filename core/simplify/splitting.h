// SPDX-License-Identifier: GPL-3.0-or-later
//
// Median and average splitting: exactly k clusters of spheres by halving the widest one again and again.
// Source: Ranjan and Fournier, Volume Models for Volumetric Data (1994), section 3.4; P. Heckbert, Color image
// quantization for frame buffer display (1982), for median cut.
#pragma once

#include <cstddef>
#include <cstdint>

#include "core/base/context.h"
#include "core/simplify/represent.h"
#include "core/simplify/result.h"
#include "core/spheres.h"

namespace spherule {

struct SplittingOptions {
  enum class At : std::uint8_t {
    median,   ///< halves of equal count
    average,  ///< halves on either side of the mean
  };
  At at = At::median;
  std::uint32_t k = 256;  ///< spheres wanted: 1 … the model's count
  /// Overlaps best with the object but where clusters are few and round.
  Representative representative = Representative::mean;
};

/// Throws what split_spheres throws for options out of their bounds for a model of so many spheres.
void check_options(const SplittingOptions& options, std::size_t model_count);

/// Splits the cluster whose centres spread most (the largest variance along any direction) across that direction, its
/// longest axis, at the median or the mean of its centres, until there are k. Ties go by index, so equal centres split
/// too. Every sphere of the model is a member. The axes turn with the object. Throws invalid_argument for a k of 0 or
/// above the model's count. O(n log k) for balanced clusters; about 40 bytes a sphere. Reports stage "splitting".
Simplification split_spheres(const SphereModel& model, const SplittingOptions& options = {},
                             const Context& context = {});

}  // namespace spherule
