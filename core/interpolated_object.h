// SPDX-License-Identifier: GPL-3.0-or-later
//
// The one decision behind the classification of spheres and circles. Private to core.
// Source: Ranjan and Fournier (1994), section 3.2; that one sample decides is explained in README.md.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>

#include "core/base/geometry.h"
#include "core/inside.h"
#include "core/lattice.h"
#include "core/volume.h"

namespace spherule {

/// A volume as the classification of empty balls sees it: sample bits at lattice planes, and values in between.
class InterpolatedObject {
 public:
  InterpolatedObject(const Volume& volume, const ObjectRule& rule, const SampleBits& inside, const Lattice& lattice)
      : volume_(volume), rule_(rule), inside_(inside), lattice_(lattice) {
    for (int a = 0; a < 3; ++a) {
      const auto n = volume.grid.dims[static_cast<std::size_t>(a)];
      first_[static_cast<std::size_t>(a)] = rule.border == Border::closed ? -1 : 0;
      // One sample alone still has a plane beside it to interpolate to, with no weight.
      last_[static_cast<std::size_t>(a)] = rule.border == Border::closed ? n : std::max(n - 1, 1);
      steps_per_unit_[static_cast<std::size_t>(a)] =
          static_cast<double>(n + 1) / static_cast<double>(lattice.plane(a, n) - lattice.plane(a, -1));
    }
  }

  /// Whether a ball (or, in a slice of one sample, a disc) that has no boundary point inside belongs to the object.
  /// `centre` is in lattice units, off by at most `error` along each axis; strictly_holds(sample) says exactly whether
  /// the ball has that lattice point strictly inside. O(1).
  template <typename Holds>
  bool has_ball(Vec3 centre, double error, Holds strictly_holds) const {
    // The sample nearest to the true centre is among those whose planes are nearest to the computed one, with both
    // planes tried where that lies in the middle but for its error.
    std::array<std::array<std::int32_t, 2>, 3> near;
    for (int axis = 0; axis < 3; ++axis)
      near[static_cast<std::size_t>(axis)] = nearest_planes(axis, centre[axis], 2 * error);
    for (std::size_t choice = 0; choice < 8; ++choice) {
      const std::array<std::size_t, 3> side{choice & 1, (choice >> 1) & 1, choice >> 2};
      std::array<std::int32_t, 3> s;
      bool repeated = false;
      for (std::size_t axis = 0; axis < 3; ++axis) {
        s[axis] = near[axis][side[axis]];
        repeated |= side[axis] == 1 && near[axis][0] == near[axis][1];
      }
      if (repeated) continue;
      if (strictly_holds(LatticePoint{lattice_.plane(0, s[0]), lattice_.plane(1, s[1]), lattice_.plane(2, s[2])}))
        return inside_.test_or_outside(s[0], s[1], s[2]);
    }
    return interpolated_inside({snapped(centre.x), snapped(centre.y), snapped(centre.z)});
  }

 private:
  // Cells that share a sphere must be decided alike, but their centres differ in the last bits, and on a grid the value
  // there often equals the iso-value exactly. Whole 2^-6 units are far apart beside the errors of centres and hold the
  // halves and quarters at which spheres of a grid are centred.
  static double snapped(double coordinate) { return std::round(coordinate * 0x1p6) * 0x1p-6; }

  // The sample planes nearest to a coordinate: twice the same one unless the coordinate is `ambiguous` close to the
  // middle.
  std::array<std::int32_t, 2> nearest_planes(int axis, double coordinate, double ambiguous) const {
    const std::int32_t below = plane_below(axis, coordinate);
    const double middle = 0.5 * (lattice_.plane(axis, below) + lattice_.plane(axis, below + 1));
    if (coordinate < middle - ambiguous) return {below, below};
    if (coordinate > middle + ambiguous) return {below + 1, below + 1};
    return {below, below + 1};
  }
  // The last plane i with plane(i) <= coordinate, kept within [first, last - 1].
  std::int32_t plane_below(int axis, double coordinate) const {
    const auto a = static_cast<std::size_t>(axis);
    // Planes are rounded by half a unit of at least 64 a step: the estimate is at most one plane off.
    const double steps = (coordinate - lattice_.plane(axis, -1)) * steps_per_unit_[a];
    auto i = static_cast<std::int32_t>(std::clamp(steps, first_[a] + 1.0, static_cast<double>(last_[a]))) - 1;
    if (i > first_[a] && coordinate < lattice_.plane(axis, i)) --i;
    if (i + 1 < last_[a] && coordinate >= lattice_.plane(axis, i + 1)) ++i;
    return i;
  }

  bool interpolated_inside(Vec3 centre) const {
    std::array<std::int32_t, 3> low;
    std::array<double, 3> t;
    bool beyond_samples = false;
    for (int axis = 0; axis < 3; ++axis) {
      const auto a = static_cast<std::size_t>(axis);
      if (centre[axis] < lattice_.plane(axis, first_[a]) || centre[axis] > lattice_.plane(axis, last_[a])) return false;
      low[a] = plane_below(axis, centre[axis]);
      const double lo = lattice_.plane(axis, low[a]), hi = lattice_.plane(axis, low[a] + 1);
      t[a] = (centre[axis] - lo) / (hi - lo);
      beyond_samples |= low[a] < 0 || low[a] + 1 >= volume_.grid.dims[a];
    }
    const bool valued = rule_.kind != ObjectRule::Kind::labels;
    if (valued && !beyond_samples) {
      const double value = trilinear(t, corner_values(volume_, low[0], low[1], low[2]));
      if (std::isfinite(value)) return holds(value);
    }
    const auto margins_by = [&](auto margin) {
      std::array<double, 8> margins;
      for (std::int32_t c = 0; c < 8; ++c) {
        margins[static_cast<std::size_t>(c)] = margin({low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2)});
      }
      return trilinear(t, margins);
    };
    if (valued && beyond_samples) {
      const double margin = margins_by([&](std::array<std::int32_t, 3> s) { return value_margin(s); });
      if (std::isfinite(margin)) return margin >= 0;
    }
    // Labels, and where a value is not finite: each sample is only inside or outside, and the surface half way.
    return margins_by([&](std::array<std::int32_t, 3> s) {
             return inside_.test_or_outside(s[0], s[1], s[2]) ? 1.0 : -1.0;
           }) >= 0;
  }

  // `corners` as corner_values orders them. A corner of no weight does not count, even if it is NaN.
  static double trilinear(const std::array<double, 3>& t, const std::array<double, 8>& corners) {
    double sum = 0;
    for (std::size_t c = 0; c < 8; ++c) {
      double weight = 1;
      for (std::size_t a = 0; a < 3; ++a) weight *= (c >> a) & 1 ? t[a] : 1 - t[a];
      if (weight > 0) sum += weight * corners[c];
    }
    return sum;
  }

  bool holds(double value) const {
    const bool within =
        rule_.kind == ObjectRule::Kind::threshold ? value >= rule_.lo : value >= rule_.lo && value <= rule_.hi;
    return within == (rule_.side == Side::above);
  }

  // How far a sample's value is inside (> 0) or outside. A sample beyond a closed border mirrors the one at the border,
  // as outside: the interpolation then vanishes half a voxel beyond, where the boundary points are.
  double value_margin(std::array<std::int32_t, 3> s) const {
    auto in = s;
    for (std::size_t a = 0; a < 3; ++a) in[a] = std::clamp(in[a], 0, volume_.grid.dims[a] - 1);
    const double value = value_at(volume_, in[0], in[1], in[2]);
    double m = value - rule_.lo;
    if (rule_.kind == ObjectRule::Kind::range) m = std::min(m, rule_.hi - value);
    if (rule_.side == Side::below) m = -m;
    return in == s ? m : -std::abs(m);
  }

  const Volume& volume_;
  const ObjectRule& rule_;
  const SampleBits& inside_;
  const Lattice& lattice_;
  std::array<std::int32_t, 3> first_, last_;
  std::array<double, 3> steps_per_unit_;
};

}  // namespace spherule
