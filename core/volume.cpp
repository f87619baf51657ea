// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/volume.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/parallel.h"

namespace spherule {

namespace {

constexpr std::array<std::string_view, 10> kNames = {"uint8", "int8",   "uint16", "int16",   "uint32",
                                                     "int32", "uint64", "int64",  "float32", "float64"};
constexpr std::array<std::size_t, 10> kSizes = {1, 1, 2, 2, 4, 4, 8, 8, 4, 8};

bool finite(Vec3 v) { return std::isfinite(v.x) && std::isfinite(v.y) && std::isfinite(v.z); }

// The rotation (or reflection) nearest to a nearly orthogonal matrix: Newton's iteration for the polar decomposition
// (Higham 1986), quadratically convergent from a cosine error of 1e-3.
Mat3 nearest_orthogonal(Mat3 m) {
  for (int i = 0; i < 4; ++i) {
    const double d = determinant(m);
    // The inverse transposed has the cofactors, divided by the determinant, as rows.
    const Mat3 inverse_transposed{{(1 / d) * cross(m.rows[1], m.rows[2]), (1 / d) * cross(m.rows[2], m.rows[0]),
                                   (1 / d) * cross(m.rows[0], m.rows[1])}};
    for (std::size_t r = 0; r < 3; ++r) m.rows[r] = 0.5 * (m.rows[r] + inverse_transposed.rows[r]);
  }
  return m;
}

void require_usable_spacing(Vec3 spacing) {
  for (int a = 0; a < 3; ++a) {
    if (!std::isfinite(spacing[a]) || !(spacing[a] > 0)) {
      throw Error(ErrorCode::unusable,
                  "The volume's spacing must be finite and above zero along every axis; correct the header's spacing "
                  "or affine.");
    }
    if (spacing[a] < min_spacing_mm) {
      throw Error(ErrorCode::unusable,
                  "The volume's spacing is below 1e-9 mm, the least that is read; correct the header's spacing or unit "
                  "of length.");
    }
  }
}

}  // namespace

std::string_view name(VoxelType type) { return kNames[static_cast<std::size_t>(type)]; }

VoxelType voxel_type(std::string_view name) {
  const auto found = std::find(kNames.begin(), kNames.end(), name);
  if (found == kNames.end()) {
    throw Error(
        ErrorCode::invalid_argument,
        "The voxel type must be one of uint8, int8, uint16, int16, uint32, int32, uint64, int64, float32, float64.");
  }
  return static_cast<VoxelType>(found - kNames.begin());
}

std::size_t bytes_per_voxel(VoxelType type) { return kSizes[static_cast<std::size_t>(type)]; }

void require_bounded(const Grid& grid) {
  require_usable_spacing(grid.spacing);
  if (!finite(grid.origin)) {
    throw Error(ErrorCode::unusable, "The volume's origin must be finite; correct the header's origin or affine.");
  }
  // Coordinates are linear in the indices: the corners have the largest.
  double farthest = 0;
  for (int corner = 0; corner < 8; ++corner) {
    Vec3 mm;
    for (int a = 0; a < 3; ++a) {
      if ((corner >> a & 1) != 0) mm[a] = (grid.dims[static_cast<std::size_t>(a)] - 1.0) * grid.spacing[a];
    }
    const Vec3 at = grid.to_patient(mm);
    for (int a = 0; a < 3; ++a) farthest = std::max(farthest, std::isfinite(at[a]) ? std::abs(at[a]) : HUGE_VAL);
  }
  // One step beyond the samples too: a flat volume is as thick as its spacing.
  farthest = std::max({farthest, grid.spacing.x, grid.spacing.y, grid.spacing.z});
  if (farthest > max_coordinate_mm) {
    throw Error(ErrorCode::unusable,
                "The volume reaches farther than 1e9 mm from the origin; correct the header's spacing, origin or unit "
                "of length.");
  }
  if (farthest > max_steps_from_origin * std::min({grid.spacing.x, grid.spacing.y, grid.spacing.z})) {
    throw Error(ErrorCode::unusable,
                "The volume lies so far from the origin that its samples could not be told apart at their spacing; "
                "move its origin nearer or correct the spacing.");
  }
}

Grid grid_from_affine(std::array<std::int32_t, 3> dims, const Mat3& axes, Vec3 origin) {
  Grid grid{.dims = dims, .spacing = {}, .origin = origin, .direction = {}};
  if (std::ranges::any_of(dims, [](std::int32_t n) { return n < 1; })) {
    throw Error(ErrorCode::unusable, "Every size of the volume must be at least 1.");
  }
  const Mat3 steps = transposed(axes);
  for (int a = 0; a < 3; ++a) {
    grid.spacing[a] = norm(steps.rows[static_cast<std::size_t>(a)]);
  }
  require_usable_spacing(grid.spacing);
  Mat3 units;
  for (std::size_t a = 0; a < 3; ++a) units.rows[a] = (1 / grid.spacing[static_cast<int>(a)]) * steps.rows[a];
  for (std::size_t a = 0; a < 3; ++a) {
    if (std::abs(dot(units.rows[a], units.rows[(a + 1) % 3])) > 1e-3) {
      throw Error(ErrorCode::unusable,
                  "The volume's axes are not at right angles (a sheared or singular affine); resample it onto a "
                  "straight grid first.");
    }
  }
  grid.direction = transposed(nearest_orthogonal(units));
  require_bounded(grid);
  return grid;
}

namespace {
std::size_t index_of(const Grid& grid, std::int32_t i, std::int32_t j, std::int32_t k) {
  const auto nx = static_cast<std::size_t>(grid.dims[0]), ny = static_cast<std::size_t>(grid.dims[1]);
  return (static_cast<std::size_t>(k) * ny + static_cast<std::size_t>(j)) * nx + static_cast<std::size_t>(i);
}
}  // namespace

double value_at(const Volume& volume, std::int32_t i, std::int32_t j, std::int32_t k) {
  const std::size_t at = index_of(volume.grid, i, j, k);
  return visit_voxels(volume,
                      [&](auto samples) { return volume.slope * static_cast<double>(samples[at]) + volume.intercept; });
}

std::array<double, 8> corner_values(const Volume& volume, std::int32_t i, std::int32_t j, std::int32_t k) {
  const std::size_t at = index_of(volume.grid, i, j, k);
  const std::size_t row = static_cast<std::size_t>(volume.grid.dims[0]);
  const std::size_t slice = row * static_cast<std::size_t>(volume.grid.dims[1]);
  return visit_voxels(volume, [&](auto samples) {
    std::array<double, 8> values;
    for (std::size_t c = 0; c < 8; ++c) {
      const std::size_t corner = at + (c & 1) + ((c >> 1) & 1) * row + (c >> 2) * slice;
      values[c] = volume.slope * static_cast<double>(samples[corner]) + volume.intercept;
    }
    return values;
  });
}

ValueRange value_range(const Volume& volume, const Context& context) {
  constexpr std::size_t kGrain = 1 << 20;
  const std::size_t pieces = (volume.grid.sample_count() + kGrain - 1) / kGrain;
  std::vector<ValueRange> part(pieces, {HUGE_VAL, -HUGE_VAL, 0});
  visit_voxels(volume, [&](auto samples) {
    parallel_for(context, {}, samples.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      ValueRange& range = part[begin / kGrain];
      for (const auto stored : samples.subspan(begin, end - begin)) {
        const double value = volume.slope * static_cast<double>(stored) + volume.intercept;
        if (!std::isfinite(value)) {
          ++range.not_finite;
          continue;
        }
        range.min = std::min(range.min, value);
        range.max = std::max(range.max, value);
      }
    });
  });
  ValueRange all{HUGE_VAL, -HUGE_VAL, 0};
  for (const ValueRange& p : part) {
    all = {std::min(all.min, p.min), std::max(all.max, p.max), all.not_finite + p.not_finite};
  }
  return all.min > all.max ? ValueRange{0, 0, all.not_finite} : all;
}

std::vector<std::uint64_t> value_histogram(const Volume& volume, ValueRange range, std::size_t buckets,
                                           const Context& context) {
  if (buckets < 1 || buckets > 65536) {
    throw Error(ErrorCode::invalid_argument, "The number of buckets must be within 1 and 65536.");
  }
  std::vector<std::uint64_t> counts(buckets, 0);
  // In halves, which a range of all that float64 holds does not overflow.
  const double low = range.min / 2;
  const double scale = range.max > range.min ? static_cast<double>(buckets) / (range.max / 2 - low) : 0;
  constexpr std::size_t kGrain = 1 << 20;
  visit_voxels(volume, [&](auto samples) {
    for (std::size_t begin = 0; begin < samples.size(); begin += kGrain) {
      context.throw_if_cancelled();
      for (const auto stored : samples.subspan(begin, std::min(kGrain, samples.size() - begin))) {
        const double value = volume.slope * static_cast<double>(stored) + volume.intercept;
        if (!(value >= range.min && value <= range.max)) continue;
        const double bucket = (value / 2 - low) * scale;
        // Of a range without width that is 0 or not a number: the first one.
        const double last = static_cast<double>(buckets - 1);
        ++counts[bucket > 0 ? static_cast<std::size_t>(std::min(bucket, last)) : 0];
      }
    }
  });
  return counts;
}

}  // namespace spherule
