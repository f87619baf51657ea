// SPDX-License-Identifier: GPL-3.0-or-later
//
// The samples in and around an object, as balls are laid over them. Private to core/simplify.
#pragma once

#include <cstdint>
#include <vector>

#include "core/sampled/object.h"
#include "core/sampled/rows.h"

namespace spherule::detail {

/// The smallest window with all inside samples; of no size for none. O(samples / 64).
Window window_of(const SampleBits& inside);

/// Everything in mm along the grid's axes. A byte a sample.
struct Frame {
  explicit Frame(const SampledObject& object, const Context& context = {});

  std::size_t at(std::int32_t i, std::int32_t j, std::int32_t k) const {
    return (static_cast<std::size_t>(k - window.begin[2]) * static_cast<std::size_t>(window.size(1)) +
            static_cast<std::size_t>(j - window.begin[1])) *
               static_cast<std::size_t>(window.size(0)) +
           static_cast<std::size_t>(i - window.begin[0]);
  }

  Vec3 spacing;
  double voxel = 1;  ///< edge of a cube of a sample's volume
  Window window;     ///< the object's own box and a margin; of no size for an object without samples
  bool border_open = false;
  std::vector<std::int8_t> value;  ///< 1 for inside samples, -1 for outside ones, x fastest
};

}  // namespace spherule::detail
