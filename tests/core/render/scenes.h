// SPDX-License-Identifier: GPL-3.0-or-later
//
// Models to draw.
#pragma once

#include <cstring>
#include <random>

#include "core/pipeline.h"

namespace spherule {

struct Scan {
  Volume volume;
  ObjectRule rule;
};

/// A lumpy solid with a void, on an oblique grid of uneven spacing: 8-bit samples, so that many are equal and many
/// cells share their sphere.
inline Scan lumpy_scan() {
  Volume volume;
  volume.grid.dims = {24, 20, 18};
  volume.grid.spacing = {1, 1.25, 1.5};
  volume.grid.origin = {-7, 30, 11};
  const double c = std::cos(0.3), s = std::sin(0.3);
  volume.grid.direction = {{Vec3{c, -s, 0}, Vec3{s, c, 0}, Vec3{0, 0, 1}}};
  volume.voxels.resize(volume.grid.sample_count());
  std::size_t index = 0;
  for (int k = 0; k < 18; ++k)
    for (int j = 0; j < 20; ++j)
      for (int i = 0; i < 24; ++i) {
        const double x = i - 11.5, y = 1.25 * (j - 9.5), z = 1.5 * (k - 8.5);
        const double lumpy = 9 + 1.5 * std::sin(x) * std::cos(0.7 * y) - std::sqrt(x * x + y * y + z * z);
        const double hollow = 4 - std::sqrt((x - 2) * (x - 2) + y * y + z * z);
        const double value = 100 + 20 * std::min(lumpy, -hollow);
        volume.voxels[index++] = static_cast<std::byte>(std::clamp(value, 0.0, 255.0));
      }
  ObjectRule rule;
  rule.lo = 100.5;
  return {volume, rule};
}

inline SphereModel raw_model() {
  const Scan scan = lumpy_scan();
  return build_model(scan.volume, scan.rule).model;
}

/// Balls without a solid: `n` with centres in a cube of 20 mm, many of them overlapping, nested or repeated.
inline SphereModel random_balls(std::size_t n, double largest_radius) {
  std::mt19937_64 random(n);
  std::uniform_real_distribution<double> coordinate(-10, 10), radius(0, largest_radius);
  SphereModel model;
  for (std::size_t i = 0; i < n; ++i)
    model.spheres.push_back({{coordinate(random), coordinate(random), coordinate(random)}, radius(random)});
  model.spheres.push_back(model.spheres.front());
  model.spheres.push_back({model.spheres.front().centre, model.spheres.front().radius / 2});
  model.spheres.push_back({{0, 0, 0}, 0});
  return model;
}

}  // namespace spherule
