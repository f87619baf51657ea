// SPDX-License-Identifier: GPL-3.0-or-later
//
// A scalar volume: samples on a straight rectangular grid, and where that grid lies in the patient.
// This is the only place that knows voxel types; `visit_voxels` lends the typed samples to kernels.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/base/error.h"
#include "core/base/geometry.h"

namespace spherule {

enum class VoxelType : std::uint8_t { uint8, int8, uint16, int16, uint32, int32, uint64, int64, float32, float64 };

/// NumPy's name of the type ("uint8", …, "float64").
std::string_view name(VoxelType type);
/// The inverse of `name`. Throws invalid_argument for any other word.
VoxelType voxel_type(std::string_view name);
/// 1, 2, 4 or 8.
std::size_t bytes_per_voxel(VoxelType type);

/// What a grid may measure, in mm, so that every figure made of it stays an ordinary number. The fourth powers of both
/// bounds (1e36 and 1e-36) are normal numbers even of float32, in which pictures and exports compute, and the fifth
/// (second moments of a solid) times 2^31 samples is far inside float64: sums over |x| <= 1e9 end below 1e60, and those
/// over voxels of 1e-9 above 1e-60.
inline constexpr double max_coordinate_mm = 1e9;
inline constexpr double min_spacing_mm = 1e-9;
/// A sample's coordinates are at most this many times the smallest spacing: float64 then still tells 2^16 places apart
/// within one step (2^52 / 2^36), which is finer than the lattice on which models are made (2^14 places a voxel).
inline constexpr double max_steps_from_origin = 0x1p36;

/// Where samples lie: sample (i, j, k) is at origin + direction · (i·spacing.x, j·spacing.y, k·spacing.z), in LPS mm.
/// Columns of `direction` are the unit vectors of the grid's axes: orthogonal, either handedness.
struct Grid {
  std::array<std::int32_t, 3> dims{0, 0, 0};  ///< samples along x (fastest in memory), y, z; each at least 1
  Vec3 spacing{1, 1, 1};                      ///< mm between samples, within the bounds above
  Vec3 origin;                                ///< of sample (0, 0, 0)
  Mat3 direction;

  std::size_t sample_count() const {
    return static_cast<std::size_t>(dims[0]) * static_cast<std::size_t>(dims[1]) * static_cast<std::size_t>(dims[2]);
  }
  /// From mm along the grid's own axes, measured from sample (0, 0, 0), to LPS mm.
  Vec3 to_patient(Vec3 grid_mm) const { return origin + direction * grid_mm; }
};

/// Throws unusable when the grid is outside the bounds above: a spacing that is not finite, zero, negative or too
/// small, a corner sample too far from the origin, in mm or in steps. Every reader calls it before it takes memory.
void require_bounded(const Grid& grid);

/// Makes a Grid from the affine that maps sample indices to LPS mm (columns of `axes` = one index step each).
/// Throws unusable when a step is zero or not finite, or when two axes are farther from a right angle than
/// 1e-3 in the cosine: spheres would not stay spheres on a sheared grid. Smaller deviations (what 32-bit headers
/// leave of a rotation) are rounded to the nearest rotation. The result is bounded (`require_bounded`).
Grid grid_from_affine(std::array<std::int32_t, 3> dims, const Mat3& axes, Vec3 origin);

/// On which side of the iso-value an object is.
enum class Side : std::uint8_t { above, below };

/// A volume as read: immutable by convention once a reader has returned it.
/// The value of a sample is slope · stored + intercept, evaluated in double; slope is never 0.
struct Volume {
  Grid grid;
  VoxelType type = VoxelType::uint8;
  double slope = 1, intercept = 0;
  std::vector<std::byte> voxels;      ///< sample_count() · bytes_per_voxel(type) bytes, native byte order, x fastest
  Side natural_side = Side::above;    ///< below for OpenVDB level sets, above for everything else
  std::string format;                 ///< "nifti", "nrrd", "metaimage", "openvdb", "raw", or a phantom's name
  std::vector<std::string> warnings;  ///< sentences for the user; no patient data
};

/// Calls f(std::span<const T>) with the samples in their stored type.
template <typename F>
decltype(auto) visit_voxels(const Volume& volume, F&& f) {
  const auto as = [&]<typename T>(T*) {
    return f(std::span(reinterpret_cast<const T*>(volume.voxels.data()), volume.voxels.size() / sizeof(T)));
  };
  switch (volume.type) {
    case VoxelType::uint8: return as(static_cast<std::uint8_t*>(nullptr));
    case VoxelType::int8: return as(static_cast<std::int8_t*>(nullptr));
    case VoxelType::uint16: return as(static_cast<std::uint16_t*>(nullptr));
    case VoxelType::int16: return as(static_cast<std::int16_t*>(nullptr));
    case VoxelType::uint32: return as(static_cast<std::uint32_t*>(nullptr));
    case VoxelType::int32: return as(static_cast<std::int32_t*>(nullptr));
    case VoxelType::uint64: return as(static_cast<std::uint64_t*>(nullptr));
    case VoxelType::int64: return as(static_cast<std::int64_t*>(nullptr));
    case VoxelType::float32: return as(static_cast<float*>(nullptr));
    case VoxelType::float64: break;
  }
  return as(static_cast<double*>(nullptr));
}

/// The value of one sample. Unchecked: the indices must be within dims. O(1).
double value_at(const Volume& volume, std::int32_t i, std::int32_t j, std::int32_t k);

/// The values of the grid cell whose lowest corner is sample (i, j, k): element c has i + 1 where bit 0 of c is set, j
/// + 1 for bit 1, k + 1 for bit 2. Unchecked: all eight must be within dims. O(1).
std::array<double, 8> corner_values(const Volume& volume, std::int32_t i, std::int32_t j, std::int32_t k);

struct ValueRange {
  double min = 0, max = 0;     ///< over the finite values; both 0 when there are none
  std::size_t not_finite = 0;  ///< values that are NaN or infinite, also by slope and intercept
};
/// O(n) over the samples.
ValueRange value_range(const Volume& volume, const Context& context = {});

/// Counts of values in `buckets` equal intervals of [range.min, range.max]; the last one is closed. O(n).
/// buckets must be within 1 … 65536 (invalid_argument).
std::vector<std::uint64_t> value_histogram(const Volume& volume, ValueRange range, std::size_t buckets,
                                           const Context& context = {});

}  // namespace spherule
