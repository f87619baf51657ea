// SPDX-License-Identifier: GPL-3.0-or-later
//
// How much of the lamp and of the sky the places in a picture see, from few rays each. Private to core/render.
#pragma once

#include <array>
#include <cstddef>
#include <vector>

#include "core/base/geometry.h"

namespace spherule {

/// Parts that are not hidden, 0 … 1.
struct Openness {
  double lamp = 1, sky = 1;
};

/// A ray or a few a pixel give a coarse answer; the mean over the neighbours that lie on the same smooth surface gives
/// a fine one. Lengths are in pixels.
class OpennessMap {
 public:
  static constexpr int reach = 3;  ///< pixels to each side that count

  /// Forgets everything; pixels are [0, width) × [0, height) from now on.
  void reset(int width, int height);
  /// What pixel (x, y) shows.
  void place(int x, int y, Vec3 point, Vec3 normal);
  /// What is known of that place.
  void set_lamp(int x, int y, double open);
  void set_sky(int x, int y, double open);
  /// For a point with this normal that is seen in or near pixel (x, y); 1 where nothing near it is known. O(1).
  Openness at(int x, int y, Vec3 point, Vec3 normal) const;

 private:
  std::size_t offset(int x, int y) const {
    return static_cast<std::size_t>(y + reach) * static_cast<std::size_t>(stride_) +
           static_cast<std::size_t>(x + reach);
  }
  int stride_ = 0;
  // One number a pixel, with a border. The last two: 1 where it is known, else 0.
  std::vector<float> px_, py_, pz_, nx_, ny_, nz_, lamp_, sky_, lamp_known_, sky_known_;
};

}  // namespace spherule
