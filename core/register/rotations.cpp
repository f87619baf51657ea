// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/rotations.h"

#include <cmath>
#include <numbers>

#include "core/base/elementary.h"

namespace spherule {

namespace {

// Number i of n: on both circles of the Hopf torus whose radii follow i, at angles whose steps are incommensurable.
Quaternion spiral(double i, double n) {
  constexpr double phi = std::numbers::sqrt2, psi = 1.533751168755204288118041;
  const double s = i + 0.5;
  const double r = std::sqrt(s / n), R = std::sqrt(1 - s / n);
  const double alpha = 2 * std::numbers::pi * s / phi, beta = 2 * std::numbers::pi * s / psi;
  return {R * elementary::cos(beta), r * elementary::sin(alpha), r * elementary::cos(alpha), R * elementary::sin(beta)};
}

}  // namespace

std::vector<Mat3> even_rotations(std::size_t count, std::uint64_t seed) {
  Mat3 turn;
  if (seed != 0) {
    constexpr double many = 0x1p20;
    turn = rotation(spiral(static_cast<double>((seed * 0x9e3779b97f4a7c15U) >> 44), many));
  }
  std::vector<Mat3> rotations;
  rotations.reserve(count);
  for (std::size_t i = 0; i < count; ++i) {
    rotations.push_back(turn * rotation(spiral(static_cast<double>(i), static_cast<double>(count))));
  }
  return rotations;
}

}  // namespace spherule
