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

/// Whether 3x3 minors of these differences fit 64 bits.
template <typename... D>
constexpr bool small(const D&... d) {
  const auto magnitude = [](std::int64_t v) { return static_cast<std::uint64_t>(v ^ (v >> 63)); };
  return ((magnitude(d.x) | magnitude(d.y) | magnitude(d.z)) | ...) < (std::uint64_t{1} << 20);
}

/// det(a, b, c), in `Int` arithmetic.
template <typename Int>
constexpr Int determinant(Difference a, Difference b, Difference c) {
  return static_cast<Int>(a.x) * (b.y * c.z - b.z * c.y) + static_cast<Int>(a.y) * (b.z * c.x - b.x * c.z) +
         static_cast<Int>(a.z) * (b.x * c.y - b.y * c.x);
}
constexpr Wide determinant(Difference a, Difference b, Difference c) {
  return small(a, b, c) ? Wide{determinant<std::int64_t>(a, b, c)} : determinant<Wide>(a, b, c);
}

/// Six times the signed volume of a tetrahedron, det(b - a, c - a, d - a).
constexpr Wide six_volumes(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  return determinant(b - a, c - a, d - a);
}
constexpr int orientation(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d) {
  return sign(six_volumes(a, b, c, d));
}

/// The in-sphere determinant of a positively oriented tetrahedron (a, b, c, d) and a point e, with its four cofactors.
struct InSphere {
  Wide value;                   ///< > 0: e strictly inside the circumsphere; 0: on it; < 0: outside
  std::array<int, 4> cofactor;  ///< signs: what lifting a, b, c or d a little would do to `value`
};

template <typename Int>
constexpr InSphere in_sphere_of(Difference a, Difference b, Difference c, Difference d) {
  const Int bcd = determinant<Int>(b, c, d), acd = determinant<Int>(a, c, d);
  const Int abd = determinant<Int>(a, b, d), abc = determinant<Int>(a, b, c);
  const Wide value = Wide{squared_length(a)} * bcd - Wide{squared_length(b)} * acd + Wide{squared_length(c)} * abd -
                     Wide{squared_length(d)} * abc;
  return {value, {sign(bcd), -sign(acd), sign(abd), -sign(abc)}};
}
constexpr InSphere in_sphere(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d, LatticePoint e) {
  const Difference ae = a - e, be = b - e, ce = c - e, de = d - e;
  return small(ae, be, ce, de) ? in_sphere_of<std::int64_t>(ae, be, ce, de) : in_sphere_of<Wide>(ae, be, ce, de);
}

/// The sign of in_sphere, never 0: ties are broken as if each point were lifted by an infinitely small amount, the
/// larger the later the point is in lexicographic order (Devillers and Teillaud, SODA 2003). The five points must
/// differ and (a, b, c, d) must be positively oriented.
constexpr int perturbed_in_sphere(LatticePoint a, LatticePoint b, LatticePoint c, LatticePoint d, LatticePoint e) {
  const InSphere exact = in_sphere(a, b, c, d, e);
  if (exact.value != 0) return sign(exact.value);
  // Lifting e makes it leave the sphere; lifting a corner moves the sphere by the sign of its cofactor, and a cofactor
  // of 0 leaves the decision to the next smaller lift.
  const std::array<LatticePoint, 4> corners{a, b, c, d};
  LatticePoint last = e;
  int decision = -1;
  for (std::size_t i = 0; i < 4; ++i) {
    if (exact.cofactor[i] != 0 && corners[i] > last) {
      last = corners[i];
      decision = exact.cofactor[i];
    }
  }
  return decision;
}

}  // namespace spherule::exact
