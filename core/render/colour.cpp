// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/colour.h"

#include <algorithm>
#include <cmath>
#include <numbers>

#include "core/base/elementary.h"

namespace spherule {
namespace {

constexpr std::size_t kSteps = 512;

Vec3 polar(double lightness, double chroma, double hue_degrees) {
  const double hue = hue_degrees * std::numbers::pi / 180;
  return {lightness, chroma * elementary::cos(hue), chroma * elementary::sin(hue)};
}

bool showable(Colour c) {
  constexpr double kSlack = 1e-9;
  return std::min({c.x, c.y, c.z}) >= -kSlack && std::max({c.x, c.y, c.z}) <= 1 + kSlack;
}

// The same lightness and hue with as much chroma as a screen can show.
Vec3 paler(Vec3 lab) {
  if (showable(from_oklab(lab))) return lab;
  double good = 0, bad = 1;
  for (int i = 0; i < 50; ++i) {
    const double half = 0.5 * (good + bad);
    (showable(from_oklab({lab.x, half * lab.y, half * lab.z})) ? good : bad) = half;
  }
  return {lab.x, good * lab.y, good * lab.z};
}

// Through all points; between the second and the third of four consecutive ones (Catmull and Rom 1974).
Vec3 spline(Vec3 a, Vec3 b, Vec3 c, Vec3 d, double t) {
  return 0.5 * (2 * b + t * (c - a) + t * t * (2 * a - 5 * b + 4 * c - d) + t * t * t * (3 * (b - c) + d - a));
}

}  // namespace

double light_of_srgb(double encoded) {
  return encoded <= 0.04045 ? encoded / 12.92 : elementary::pow((encoded + 0.055) / 1.055, 2.4);
}

std::uint8_t to_srgb(double linear) {
  static const ByteCurve curve([](double shown) { return shown; });
  return curve(linear);
}

Colour from_oklab(Vec3 lab) {
  const Mat3 to_roots{{Vec3{1, 0.3963377774, 0.2158037573}, Vec3{1, -0.1055613458, -0.0638541728},
                       Vec3{1, -0.0894841775, -1.2914855480}}};
  const Mat3 to_rgb{{Vec3{4.0767416621, -3.3077115913, 0.2309699292}, Vec3{-1.2684380046, 2.6097574011, -0.3413193965},
                     Vec3{-0.0041960863, -0.7034186147, 1.7076147010}}};
  const Vec3 root = to_roots * lab;
  return to_rgb * Vec3{root.x * root.x * root.x, root.y * root.y * root.y, root.z * root.z * root.z};
}

Vec3 to_oklab(Colour colour) {
  const Mat3 to_cones{{Vec3{0.4122214708, 0.5363325363, 0.0514459929}, Vec3{0.2119034982, 0.6806995451, 0.1073969566},
                       Vec3{0.0883024619, 0.2817188376, 0.6299787005}}};
  const Mat3 to_lab{{Vec3{0.2104542553, 0.7936177850, -0.0040720468}, Vec3{1.9779984951, -2.4285922050, 0.4505937099},
                     Vec3{0.0259040371, 0.7827717662, -0.8086757660}}};
  const Vec3 cones = to_cones * colour;
  return to_lab * Vec3{elementary::cbrt(cones.x), elementary::cbrt(cones.y), elementary::cbrt(cones.z)};
}

ColourMap::ColourMap(std::span<const Vec3> path) {
  // A fine walk along the path, then places on it at even distances.
  std::vector<Vec3> walk;
  std::vector<double> length;
  const std::size_t last = path.size() - 1;
  constexpr std::size_t kFine = 2048;
  for (std::size_t i = 0; i <= last * kFine; ++i) {
    const std::size_t from = std::min(i / kFine, last - 1);
    const double t = static_cast<double>(i - from * kFine) / kFine;
    const Vec3 b = path[from], c = path[from + 1];
    const Vec3 a = from > 0 ? path[from - 1] : 2 * b - c, d = from + 2 <= last ? path[from + 2] : 2 * c - b;
    walk.push_back(paler(spline(a, b, c, d, t)));
    length.push_back(i > 0 ? length.back() + norm(walk[i] - walk[i - 1]) : 0);
  }
  for (std::size_t step = 0; step <= kSteps; ++step) {
    const double wanted = length.back() * static_cast<double>(step) / kSteps;
    const auto after = std::ranges::upper_bound(length, wanted);
    const auto i = std::clamp<std::size_t>(static_cast<std::size_t>(after - length.begin()), 1, walk.size() - 1);
    const double t = std::clamp((wanted - length[i - 1]) / (length[i] - length[i - 1]), 0.0, 1.0);
    const Colour c = from_oklab(walk[i - 1] + t * (walk[i] - walk[i - 1]));
    colours_.push_back({std::clamp(c.x, 0.0, 1.0), std::clamp(c.y, 0.0, 1.0), std::clamp(c.z, 0.0, 1.0)});
  }
}

Colour ColourMap::at(double t) const {
  const double place = kSteps * (t > 0 ? std::min(t, 1.0) : 0.0);
  const auto i = std::min(static_cast<std::size_t>(place), kSteps - 1);
  return colours_[i] + (place - static_cast<double>(i)) * (colours_[i + 1] - colours_[i]);
}

namespace {
constexpr std::array<std::string_view, 4> kNames{"ember", "lagoon", "grey", "tide"};
}

std::span<const std::string_view> colour_map_names() { return kNames; }

const ColourMap* colour_map(std::string_view name) {
  static const std::array<ColourMap, kNames.size()> maps{
      ColourMap(std::array{polar(0.20, 0.09, 285), polar(0.35, 0.16, 310), polar(0.52, 0.19, 5), polar(0.68, 0.17, 40),
                           polar(0.82, 0.14, 75), polar(0.95, 0.08, 103)}),
      ColourMap(std::array{polar(0.22, 0.10, 275), polar(0.38, 0.11, 258), polar(0.54, 0.10, 218),
                           polar(0.69, 0.13, 165), polar(0.83, 0.15, 128), polar(0.95, 0.10, 106)}),
      ColourMap(std::array{polar(0.15, 0, 0), polar(1, 0, 0)}),
      ColourMap(std::array{polar(0.40, 0.15, 262), polar(0.68, 0.11, 248), polar(0.96, 0, 0), polar(0.68, 0.12, 35),
                           polar(0.42, 0.16, 25)})};
  const auto found = std::ranges::find(kNames, name);
  return found == kNames.end() ? nullptr : &maps[static_cast<std::size_t>(found - kNames.begin())];
}

Colour category_colour(std::size_t index) {
  // Hues a golden angle apart; lightness in three steps, so that similar hues differ by it.
  const double hue = 40 + 137.50776405 * static_cast<double>(index % 360);
  constexpr std::array<double, 3> kLightness{0.72, 0.60, 0.82};
  const Colour c = from_oklab(paler(polar(kLightness[index % 3], 0.13, hue)));
  return {std::clamp(c.x, 0.0, 1.0), std::clamp(c.y, 0.0, 1.0), std::clamp(c.z, 0.0, 1.0)};
}

}  // namespace spherule
