// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls laid over an object's samples, and how much better each could lie. Private to core/simplify.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/geometry.h"
#include "core/simplify/object.h"
#include "core/simplify/rows.h"

namespace spherule::detail {

/// How many balls hold each sample in and around the object. Everything is in mm along the grid's axes. The score of a
/// set of balls is covered inside samples less covered outside ones: |object| less the samples that balls and object
/// do not share. Not thread safe while it changes; const members are.
class Fit {
 public:
  /// `margin`: samples kept around the object's own box; balls that spill beyond are charged for every sample there.
  explicit Fit(const SampledObject& object, std::int32_t margin = 12);

  Vec3 spacing() const { return spacing_; }
  double smallest_spacing() const { return std::min({spacing_.x, spacing_.y, spacing_.z}); }

  void add(const Sphere& ball) { change(ball, 1); }
  void remove(const Sphere& ball) { change(ball, -1); }
  /// What adding the ball would add to the score. O(samples in the ball), a few a nanosecond.
  std::int64_t gain(const Sphere& ball) const;

  /// A ball near `ball`, which must not be laid out now, whose surface is closer to where the object ends among the
  /// other balls: the least squares fit of its exposed surface (Gauss-Newton on the gradient of the score, by
  /// quadrature over directions). Not sure to score better.
  Sphere fitted(const Sphere& ball, bool laid = false, double ridge = 0.01) const;

 private:
  enum Sample : std::int8_t { outside = -1, taken = 0, inside = 1 };

  void change(const Sphere& ball, int by);
  std::size_t offset(std::int32_t j, std::int32_t k) const {
    return (static_cast<std::size_t>(k - window_.begin[2]) * static_cast<std::size_t>(window_.size(1)) +
            static_cast<std::size_t>(j - window_.begin[1])) *
           static_cast<std::size_t>(window_.size(0));
  }
  int value_near(Vec3 p, const Sphere* own, bool all_out) const;

  Vec3 spacing_;
  Window window_;
  bool open_;
  Window grid_;
  std::vector<std::int8_t> value_;    // inside or outside
  std::vector<std::uint16_t> count_;  // balls that hold the sample
};

}  // namespace spherule::detail
