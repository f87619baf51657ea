// SPDX-License-Identifier: GPL-3.0-or-later
//
// Colours as light, as bytes, and as a scale for numbers.
//
// Source: B. Ottosson, A perceptual color space for image processing (2020): Oklab, in which equal distances look
// equally different.
#pragma once

#include <algorithm>
#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string_view>
#include <vector>

#include "core/base/geometry.h"

namespace spherule {

/// Linear light, red green blue of sRGB; 0 … 1 is what a screen shows.
using Colour = Vec3;

/// The product of each component: light that a material reflects.
constexpr Colour mixed(Colour a, Colour b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }

/// One component of linear light, clamped, as an 8-bit sRGB value.
std::uint8_t to_srgb(double linear);
/// sRGB's curve: from what is encoded to linear light, both 0 … 1.
double light_of_srgb(double encoded);
inline double from_srgb(std::uint8_t encoded) { return light_of_srgb(encoded / 255.0); }

/// Light → sRGB bytes, by looking up the least light that is shown as each byte. What is below 0 or no number is 0.
class ByteCurve {
 public:
  /// From the growing function that says which light is shown as a part, 0 … 1, of the screen's linear light.
  template <typename LightOf>
  explicit ByteCurve(LightOf light_of) {
    for (std::size_t i = 1; i < 256; ++i) least_[i] = light_of(light_of_srgb((static_cast<double>(i) - 0.5) / 255));
    scale_ = kCodes / least_[255];
    for (std::size_t k = 1; k < kCodes; ++k) {
      guess_[k] = guess_[k - 1];
      while (least_[guess_[k] + 1U] * scale_ <= static_cast<double>(k)) ++guess_[k];
    }
  }
  std::uint8_t operator()(double light) const {
    if (!(light > 0)) return 0;
    if (light >= least_[255]) return 255;
    std::uint8_t encoded = guess_[std::min(kCodes - 1, static_cast<std::size_t>(light * scale_))];
    while (light >= least_[encoded + 1U]) ++encoded;
    return encoded;
  }

 private:
  static constexpr std::size_t kCodes = 4096;
  std::array<double, 256> least_{};
  std::array<std::uint8_t, kCodes> guess_{};  // the byte, or one a little below it, of each part of the range
  double scale_ = 1;
};

/// Oklab: x lightness (0 black … 1 white), y green to red, z blue to yellow.
Colour from_oklab(Vec3 lab);
Vec3 to_oklab(Colour colour);

/// Colours for the numbers 0 … 1, evenly spaced to the eye: equal steps of the number are equal distances in Oklab.
class ColourMap {
 public:
  /// Runs through `path`, points in Oklab joined smoothly; colours that a screen cannot show are made paler.
  explicit ColourMap(std::span<const Vec3> path);
  /// Clamps t to 0 … 1. NaN gives the colour of 0.
  Colour at(double t) const;

 private:
  std::vector<Colour> colours_;
};

/// The map of this name, or nullptr. Made once and kept; thread safe.
///   ember   from near black over violet and red to pale yellow
///   lagoon  from dark blue over green to pale yellow
///   grey    from near black to white
///   tide    from blue over near white to red: for numbers around 0
const ColourMap* colour_map(std::string_view name);
/// The names that colour_map knows; the first is the default.
std::span<const std::string_view> colour_map_names();

/// Colours that are easy to tell apart, for things without an order: neighbouring indices differ much. Endless.
Colour category_colour(std::size_t index);

}  // namespace spherule
