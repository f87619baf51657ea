// SPDX-License-Identifier: GPL-3.0-or-later
//
// Small files that ask for much work: sets of balls and volumes as an attacker, or an unlucky user, would make them.
#pragma once

#include <cmath>
#include <cstdint>
#include <numbers>
#include <string>
#include <vector>

#include "core/spheres.h"
#include "core/volume.h"
#include "tests/phantoms.h"

namespace spherule::hostile {

struct Balls {
  std::string name;
  std::vector<Sphere> balls;
};

/// About n balls each: identical, nested, jittered about one place, in a row, under a huge one …
inline std::vector<Balls> ball_sets(std::size_t n, std::uint64_t seed = 1) {
  phantoms::Random random(seed);
  const auto point = [&](double size) {
    return Vec3{size * random.unit(), size * random.unit(), size * random.unit()};
  };
  const auto many = [&](auto ball) {
    std::vector<Sphere> balls;
    for (std::size_t i = 0; i < n; ++i) balls.push_back(ball(static_cast<double>(i)));
    return balls;
  };
  const auto count = static_cast<double>(n);
  std::vector<Balls> sets;
  sets.push_back({"identical", many([](double) { return Sphere{{1, 2, 3}, 4}; })});
  sets.push_back({"concentric", many([](double i) { return Sphere{{1, 2, 3}, 1 + 0.001 * i}; })});
  sets.push_back({"nested", many([](double i) { return Sphere{{0.4 * i, 0, 0}, 1 + 0.5 * i}; })});
  sets.push_back({"jittered", many([&](double) { return Sphere{point(1), 100}; })});
  sets.push_back({"jittered radii", many([&](double) { return Sphere{point(1), 20 + 0.1 * random.unit()}; })});
  sets.push_back({"two clusters", many([&](double i) {
                    return Sphere{point(1) + Vec3{std::fmod(i, 2) * 100, 0, 0}, 20};
                  })});
  sets.push_back({"row", many([](double i) { return Sphere{{i, 0, 0}, 0.75}; })});
  sets.push_back({"touching row", many([](double i) { return Sphere{{2 * i, 0, 0}, 1}; })});
  sets.push_back({"row of wide balls", many([&](double i) { return Sphere{{i, 0, 0}, count / 2}; })});
  sets.push_back({"under a huge one", many([&](double i) {
                    return i == 0 ? Sphere{{0, 0, 0}, 1000} : Sphere{1000 * normalised(point(2) - Vec3{1, 1, 1}), 2};
                  })});
  sets.push_back({"points in a huge one", many([&](double i) {
                    return i == 0 ? Sphere{{0, 0, 0}, 1000} : Sphere{point(100), 0};
                  })});
  sets.push_back({"cospherical centres", many([&](double i) {
                    const double z = 1 - (2 * i + 1) / count, a = i * std::numbers::pi * (3 - std::sqrt(5.0));
                    const double r = std::sqrt(1 - z * z);
                    return Sphere{{10 * r * std::cos(a), 10 * r * std::sin(a), 10 * z}, 9};
                  })});
  const double side = std::ceil(std::cbrt(count));
  sets.push_back(
      {"wide balls on a grid", many([&](double i) {
         return Sphere{{std::fmod(i, side), std::fmod(std::floor(i / side), side), std::floor(i / side / side)}, side};
       })});
  return sets;
}

/// Balls on two lines that do not meet: nearly all pairs bound each other.
inline std::vector<Sphere> skew_lines(std::size_t n) {
  std::vector<Sphere> balls;
  for (std::size_t i = 0; i < n; ++i) {
    const double at = static_cast<double>(i) / static_cast<double>(n) - 0.5;
    balls.push_back(i % 2 == 0 ? Sphere{{at, 0, 0}, 3} : Sphere{{0, at, 2}, 3});
  }
  return balls;
}

struct Thin {
  std::string name;
  Volume volume;
};

/// About n voxels each, that pack to nearly nothing.
inline std::vector<Thin> volumes(std::int32_t n) {
  const auto side = static_cast<std::int32_t>(std::sqrt(static_cast<double>(n)));
  const auto cube = static_cast<std::int32_t>(std::cbrt(static_cast<double>(n)));
  const auto grid = [](std::int32_t x, std::int32_t y, std::int32_t z) {
    return Grid{.dims = {x, y, z}, .spacing = {1, 1, 1}, .origin = {0, 0, 0}, .direction = {}};
  };
  const auto all = [](const Grid& g) { return phantoms::sample([](Vec3) { return 1.0; }, g, VoxelType::uint8); };
  const auto odd = [](Vec3 p) { return std::fmod(p.x + p.y + p.z, 2) == 0 ? 1.0 : 0.0; };
  std::vector<Thin> thin;
  thin.push_back({"1 x 1 x n", all(grid(1, 1, n))});
  thin.push_back({"n x 1 x 1", all(grid(n, 1, 1))});
  thin.push_back({"1 x n x n", all(grid(1, side, side))});
  thin.push_back({"n x n x 1", all(grid(side, side, 1))});
  thin.push_back({"checkerboard", phantoms::sample(odd, grid(cube, cube, cube), VoxelType::uint8)});
  thin.push_back({"noise", phantoms::noise(grid(cube, cube, cube), 2, 1)});
  return thin;
}

}  // namespace spherule::hostile
