// SPDX-License-Identifier: GPL-3.0-or-later
//
// Sets of balls for tests of their unions.
#pragma once

#include <cstdint>
#include <vector>

#include "core/spheres.h"
#include "tests/phantoms.h"

namespace spherule {

/// With centres in a cube from the origin, `side` wide, and radii from `least` to `largest`, all equally likely.
inline std::vector<Sphere> random_balls(std::size_t count, double side, double least, double largest,
                                        std::uint64_t seed) {
  phantoms::Random random(seed);
  std::vector<Sphere> balls(count);
  for (Sphere& b : balls) {
    b.centre = {side * random.unit(), side * random.unit(), side * random.unit()};
    b.radius = least + (largest - least) * random.unit();
  }
  return balls;
}

}  // namespace spherule
