// SPDX-License-Identifier: GPL-3.0-or-later
//
// Volumes whose truth is known: analytic shapes sampled on any grid in any voxel type, and seeded noise.
#pragma once

#include <array>
#include <cstdint>
#include <functional>
#include <numbers>
#include <random>

#include "core/inside.h"
#include "core/volume.h"

namespace spherule::phantoms {

/// A scalar field over LPS mm. Of the shapes below: the signed distance to the surface in mm, positive inside,
/// so the object is `value >= 0`.
using Field = std::function<double(Vec3)>;

Field ball(Vec3 centre, double radius);
/// Around an axis parallel to z; `tube` is the radius of the tube.
Field torus(Vec3 centre, double radius, double tube);
/// Around an axis parallel to z, without ends.
Field cylinder(Vec3 axis, double radius);
/// Around an axis parallel to z, with flat ends at centre.z ± half_height.
Field capped_cylinder(Vec3 centre, double radius, double half_height);
Field cube(Vec3 centre, double half_edge);
/// Between the planes z = centre ± half_thickness.
Field slab(double centre_z, double half_thickness);
/// A ball with a concentric void.
Field shell(Vec3 centre, double outer, double inner);
/// The points that are in one of two shapes (exact distance outside, a bound of it inside).
Field either(Field a, Field b);

/// The density of Ranjan and Fournier's synthetic volumes: 255 at `centre`, falling linearly to 0 at a distance of
/// 11.5 (mm, so use spacing 1), from the centre or from the axis through it.
Field paper_ball(Vec3 centre);
Field paper_cylinder(Vec3 centre);

/// Samples a field. The stored values are (value - intercept) / slope; integer types round to the nearest and saturate.
Volume sample(const Field& field, const Grid& grid, VoxelType type = VoxelType::float64, double slope = 1,
              double intercept = 0);

/// Whole numbers 0 … levels - 1, all equally likely: few levels make many ties. A function of its arguments alone.
Volume noise(const Grid& grid, std::uint32_t levels, std::uint64_t seed, VoxelType type = VoxelType::uint8);

/// The same as float64, with one sample in eight NaN or infinite.
Volume noise_with_gaps(const Grid& grid, std::uint32_t levels, std::uint64_t seed);

/// n samples along each axis of a cube of this edge about the origin.
Grid cubic_grid(std::int32_t n, double edge);

/// Overwrites one sample's stored value, rounded and saturated as in `sample`.
void set_stored(Volume& volume, std::array<std::int32_t, 3> at, double stored);

ObjectRule threshold(double lo, Border border = Border::closed, Side side = Side::above);
ObjectRule range(double lo, double hi, Border border = Border::closed, Side side = Side::above);
ObjectRule labels(std::vector<Label> values, Border border = Border::closed, Side side = Side::above);

/// The generator behind every seeded test: the same numbers on every platform (standard distributions are not).
class Random {
 public:
  explicit Random(std::uint64_t seed) : engine_(seed) {}
  std::uint64_t bits() { return engine_(); }
  /// 0 … n - 1.
  std::uint64_t below(std::uint64_t n) { return engine_() % n; }
  /// In [0, 1).
  double unit() { return static_cast<double>(engine_() >> 11) * 0x1p-53; }
  template <typename Range>
  void shuffle(Range& range) {
    for (std::size_t i = range.size(); i > 1; --i) std::swap(range[i - 1], range[below(i)]);
  }

 private:
  std::mt19937_64 engine_;
};

}  // namespace spherule::phantoms
