// SPDX-License-Identifier: GPL-3.0-or-later
//
// Colours as light, as bytes, and as a scale for numbers.
//
// Source: B. Ottosson, A perceptual color space for image processing (2020): Oklab, in which equal distances look
// equally different.
#pragma once

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
double from_srgb(std::uint8_t encoded);

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
