// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls laid over an object's samples, and how much better each could lie. Private to core/simplify.
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/geometry.h"
#include "core/simplify/object.h"
#include "core/simplify/rows.h"

namespace spherule::detail {

/// How many balls hold each sample in and around the object. Balls are in mm along the grid's axes. The score of a set
/// of balls is the covered inside samples less the covered outside ones: the object's samples less those in which it
/// and the balls differ. At most 65,535 balls. 4 bytes a sample; not thread safe while it changes.
class Fit {
 public:
  explicit Fit(const SampledObject& object);

  double voxel() const { return voxel_; }

  void add(const Sphere& ball) { change(ball, 1); }
  void remove(const Sphere& ball) { change(ball, -1); }
  /// What adding the ball would add to the score. O(samples in the ball).
  std::int64_t gain(const Sphere& ball) const;

  /// A ball near `ball` (which is not laid) whose surface is closer to where the object ends among the other balls: one
  /// Gauss-Newton step on the volume in which they differ, its gradient (dV/dr and dV/dx over the exposed surface) by
  /// quadrature over directions. Not sure to score better. O(1) steps a direction.
  Sphere fitted(const Sphere& ball) const;

 private:
  static constexpr std::int32_t kMargin = 12;  // samples around the object's own box
  static constexpr int kOutside = -1, kInside = 1;

  void change(const Sphere& ball, int by);
  std::size_t at(std::int32_t i, std::int32_t j, std::int32_t k) const {
    return (static_cast<std::size_t>(k - window_.begin[2]) * static_cast<std::size_t>(window_.size(1)) +
            static_cast<std::size_t>(j - window_.begin[1])) *
               static_cast<std::size_t>(window_.size(0)) +
           static_cast<std::size_t>(i - window_.begin[0]);
  }
  int open_near(Vec3 p) const;

  Vec3 spacing_;
  double voxel_ = 1;  // edge of a cube of a sample's volume, mm
  Window window_;
  bool border_open_;
  std::vector<std::uint16_t> count_;  // balls that hold the sample
  std::vector<std::uint8_t> value_;   // 1 more than kInside or kOutside
  std::vector<std::uint8_t> open_;    // 1 more than its value while no ball holds it, else 1; and a word more
};

}  // namespace spherule::detail
