// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls laid over an object's samples, and how much better each could lie. Private to core/simplify.
#pragma once

#include <cstdint>
#include <vector>

#include "core/base/geometry.h"
#include "core/sampled/object.h"
#include "core/simplify/frame.h"

namespace spherule::detail {

/// How many balls hold each sample in and around the object. Balls are in mm along the grid's axes. The score of a set
/// of balls is the covered inside samples less the covered outside ones: the object's samples less those in which it
/// and the balls differ. At most 65,535 balls. 4 bytes a sample; not thread safe while it changes.
class Fit {
 public:
  explicit Fit(const SampledObject& object, const Context& context = {});

  double voxel() const { return frame_.voxel; }

  void add(const Sphere& ball) { change(ball, 1); }
  void remove(const Sphere& ball) { change(ball, -1); }
  /// What adding the ball would add to the score. O(samples in the ball).
  std::int64_t gain(const Sphere& ball) const;

 private:
  void change(const Sphere& ball, int by);

  Frame frame_;
  std::vector<std::uint16_t> count_;  // balls that hold the sample
  std::vector<std::uint8_t> open_;    // 1 more than its value while no ball holds it, else 1; and a word more
};

}  // namespace spherule::detail
