// SPDX-License-Identifier: GPL-3.0-or-later
//
// Exact geometric predicates on lattice points (core internal).
//
// Coordinates are in [0, 2^24), so differences d have |d| < 2^24. Bounds, with the largest determinant of an n x n
// matrix of entries in [-1, 1] being 1, 2, 4 for n = 1, 2, 3 (Hadamard's maximal determinant problem):
//   2x2 minors     < 2 · 2^48          = 2^49      64-bit
//   3x3 minors     < 4 · 2^72          = 2^74      128-bit
//   squared length < 3 · 2^48          < 2^49.6    64-bit
//   in-sphere sum  < 4 · 2^49.6 · 2^74 < 2^125.6   128-bit
// When all |d| < 2^20, which is nearly always so for the neighbours of a Delaunay cell, 3x3 minors are below 2^62 and
// fit 64 bits: the same code then runs on machine words, at the cost of an approximate test and the same for ties.
#pragma once

#include <algorithm>
#include <array>
#include <cstdint>

#include "core/base/int128.h"
#include "core/lattice.h"

namespace spherule::exact {

using Wide = Int128;

struct Difference {
  std::int64_t x, y, z;
};

constexpr Difference operator-(LatticePoint a, LatticePoint b) {
  return {std::int64_t{a.x} - b.x, std::int64_t{a.y} - b.y, std::int64_t{a.z} - b.z};
}
constexpr std::int64_t squared_length(Difference d) { return d.x * d.x + d.y * d.y + d.z * d.z; }
constexpr int sign(Wide v) { return (v > 0) - (v < 0); }

/// Whether 3x3 minors of these differences fit 64 bits: every |component| < 2^20 (or one component -2^20, which fits
/// too).
template <typename... D>
constexpr bool small(const D&... d) {
  constexpr std::int64_t kBias = std::int64_t{1} << 20;
  return static_cast<std::uint64_t>((((d.x + kBias) | (d.y + kBias) | (d.z + kBias)) | ...)) < 2 * kBias;
}

/// The cross product; its components are below 2^49.
constexpr Difference cross(Difference a, Difference b) {
  return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x};
}
/// A scalar product with a cross product, in `Int` arithmetic.
template <typename Int>
constexpr Int dot(Difference a, Difference crossed) {
  return static_cast<Int>(a.x) * crossed.x + static_cast<Int>(a.y) * crossed.y + static_cast<Int>(a.z) * crossed.z;
}
constexpr Wide determinant(Difference a, Difference b, Difference c) {
  return small(a, b, c) ? Wide{dot<std::int64_t>(a, cross(b, c))} : dot<Wide>(a, cross(b, c));
}

/// Six times the signed volume of a tetrahedron, det(b - a, c - a, d - a).
constexpr Wide six_volumes(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  return determinant(b - a, c - a, d - a);
}
constexpr int orientation(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  return sign(six_volumes(a, b, c, d));
}

/// The in-sphere determinant and its cofactors of the squared lengths: value = Σ |corner - e|² · cofactor.
template <typename Int>
struct InSphere {
  Wide value;
  std::array<Int, 4> cofactors;
};
template <typename Int>
constexpr InSphere<Int> in_sphere_of(Difference a, Difference b, Difference c, Difference d) {
  const Difference ab = cross(a, b), cd = cross(c, d);
  const std::array<Int, 4> cofactors{dot<Int>(b, cd), -dot<Int>(a, cd), dot<Int>(d, ab), -dot<Int>(c, ab)};
  return {Wide{squared_length(a)} * cofactors[0] + Wide{squared_length(b)} * cofactors[1] +
              Wide{squared_length(c)} * cofactors[2] + Wide{squared_length(d)} * cofactors[3],
          cofactors};
}

/// For a positively oriented tetrahedron (a, b, c, d): 1 when e is strictly inside its circumsphere, 0 on it, -1
/// outside.
constexpr int in_sphere(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d, LatticePoint e) {
  const Difference ae = a - e, be = b - e, ce = c - e, de = d - e;
  return sign(small(ae, be, ce, de) ? in_sphere_of<std::int64_t>(ae, be, ce, de).value
                                    : in_sphere_of<Wide>(ae, be, ce, de).value);
}

/// in_sphere, but never 0: ties are broken as if each point were lifted by an infinitely small amount, the larger the
/// later the point is in lexicographic order (Devillers and Teillaud, SODA 2003). The five points must differ.
template <typename Int>
constexpr int perturbed(const InSphere<Int>& exact, const std::array<LatticePoint, 4>& corners, LatticePoint e) {
  if (exact.value != 0) return sign(exact.value);
  // Lifting e makes it leave the sphere; lifting a corner moves the sphere by its cofactor, and where that is 0 the
  // decision is left to the next smaller lift.
  LatticePoint last = e;
  int decision = -1;
  for (std::size_t i = 0; i < 4; ++i) {
    if (exact.cofactors[i] != 0 && corners[i] > last) {
      last = corners[i];
      decision = sign(exact.cofactors[i]);
    }
  }
  return decision;
}
constexpr int perturbed_in_sphere(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d, LatticePoint e) {
  const Difference ae = a - e, be = b - e, ce = c - e, de = d - e;
  return small(ae, be, ce, de) ? perturbed(in_sphere_of<std::int64_t>(ae, be, ce, de), {a, b, c, d}, e)
                               : perturbed(in_sphere_of<Wide>(ae, be, ce, de), {a, b, c, d}, e);
}

// In the plane of the first two axes; z is not looked at. Areas are below 2^49, squared lengths too, the sum of three
// products below 2^100.

/// Twice the signed area of a triangle: positive when it runs from x to y.
constexpr std::int64_t two_areas(LatticePoint a, LatticePoint b, LatticePoint c) {
  const Difference ab = b - a, ac = c - a;
  return ab.x * ac.y - ab.y * ac.x;
}
/// For a triangle of positive area: 1 when d is strictly inside its circumcircle, 0 on it, -1 outside.
constexpr int in_circle(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  const auto lift = [&](LatticePoint p) {
    const Difference v = p - d;
    return Wide{v.x * v.x + v.y * v.y};
  };
  return sign(lift(a) * two_areas(d, b, c) + lift(b) * two_areas(d, c, a) + lift(c) * two_areas(d, a, b));
}

}  // namespace spherule::exact
