// SPDX-License-Identifier: GPL-3.0-or-later
//
// The nearest of many points: a k-d tree.
// Source: J. Friedman, J. Bentley, R. Finkel, An algorithm for finding best matches in logarithmic expected time
// (1977).
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "core/base/geometry.h"

namespace spherule::detail {

/// Points split at the median of their widest axis down to a few. Immutable, so safe to share. O(n log n) to build, 32
/// bytes a point.
class PointTree {
 public:
  explicit PointTree(std::span<const Vec3> points);

  struct Near {
    std::uint32_t index = none;                                ///< of the points given; `none` when nothing is near
    double squared = std::numeric_limits<double>::infinity();  ///< distance
  };
  static constexpr std::uint32_t none = 0xffffffffU;

  /// The nearest point closer than sqrt(within_squared). Expected O(log n).
  Near nearest(Vec3 p, double within_squared = std::numeric_limits<double>::infinity()) const;

 private:
  static constexpr std::size_t kLeaf = 8;

  void build(std::size_t begin, std::size_t end);
  void search(std::size_t begin, std::size_t end, Vec3 p, Near& best) const;

  std::vector<Vec3> points_;
  std::vector<std::uint32_t> order_;
  std::vector<std::uint8_t> axis_;  // at the middle of each range: where it is split
};

}  // namespace spherule::detail
