// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/resample.h"

#include <algorithm>
#include <cmath>

#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/trees/ball_tree.h"

namespace spherule {

namespace {

template <typename T>
Volume empty_volume(const Grid& grid, VoxelType type, const char* format) {
  Volume volume;
  volume.grid = grid;
  volume.type = type;
  volume.format = format;
  volume.voxels.resize(grid.sample_count() * sizeof(T));
  return volume;
}

// Calls f(number of the sample, its place in LPS mm) for every sample, slice by slice.
template <typename F>
void for_each_sample(const Grid& grid, const Context& context, F&& f) {
  const auto nx = static_cast<std::size_t>(grid.dims[0]), ny = static_cast<std::size_t>(grid.dims[1]);
  parallel_for(context, "resample", static_cast<std::size_t>(grid.dims[2]), 1, [&](std::size_t k, std::size_t) {
    Poll poll(context);
    for (std::size_t j = 0; j < ny; ++j) {
      poll(32 * nx);
      for (std::size_t i = 0; i < nx; ++i) {
        f((k * ny + j) * nx + i,
          grid.to_patient({static_cast<double>(i) * grid.spacing.x, static_cast<double>(j) * grid.spacing.y,
                           static_cast<double>(k) * grid.spacing.z}));
      }
    }
  });
}

// Trilinear; `beyond` outside the grid.
double value_at(const Volume& volume, Vec3 index, double beyond) {
  std::array<std::int32_t, 3> low{};
  Vec3 part;
  for (int a = 0; a < 3; ++a) {
    const auto n = volume.grid.dims[static_cast<std::size_t>(a)];
    // A hair of rounding must not throw the outermost samples out.
    if (!(index[a] >= -1e-6 && index[a] <= n - 1 + 1e-6)) return beyond;
    const double clamped = std::clamp(index[a], 0.0, n - 1.0);
    low[static_cast<std::size_t>(a)] = std::min(static_cast<std::int32_t>(clamped), std::max(n - 2, 0));
    part[a] = clamped - low[static_cast<std::size_t>(a)];
  }
  double sum = 0;
  for (int c = 0; c < 8; ++c) {
    double weight = 1;
    for (int a = 0; a < 3; ++a) weight *= (c >> a & 1) != 0 ? part[a] : 1 - part[a];
    if (weight > 0) sum += weight * value_at(volume, low[0] + (c & 1), low[1] + (c >> 1 & 1), low[2] + (c >> 2 & 1));
  }
  return std::isfinite(sum) ? sum : beyond;
}

}  // namespace

Volume resampled(const Volume& moving, const AffineMap& moving_to_fixed, const Grid& grid, const Context& context) {
  Volume result = empty_volume<float>(grid, VoxelType::float32, "resampled");
  auto* values = reinterpret_cast<float*>(result.voxels.data());
  const double beyond = value_range(moving, context).min;
  const AffineMap back = inverse(moving_to_fixed);
  const Mat3 to_axes = transposed(moving.grid.direction);
  const Vec3 spacing = moving.grid.spacing;
  for_each_sample(grid, context, [&](std::size_t n, Vec3 at) {
    const Vec3 there = to_axes * (back(at) - moving.grid.origin);
    values[n] =
        static_cast<float>(value_at(moving, {there.x / spacing.x, there.y / spacing.y, there.z / spacing.z}, beyond));
  });
  return result;
}

Volume sampled(const SphereModel& moving, const AffineMap& moving_to_fixed, const Grid& grid, const Context& context) {
  Volume result = empty_volume<std::uint8_t>(grid, VoxelType::uint8, "resampled");
  const detail::BallTree tree(moving.spheres, context);
  Box box;
  for (const Sphere& ball : moving.spheres) box.include(ball);
  const AffineMap back = inverse(moving_to_fixed);
  for_each_sample(grid, context, [&](std::size_t n, Vec3 at) {
    const Vec3 there = back(at);
    for (int a = 0; a < 3; ++a)
      if (there[a] < box.min[a] || there[a] > box.max[a]) return;
    result.voxels[n] = std::byte{
        tree.any_overlapping({there, 0}, [](std::uint32_t) { return true; }) ? std::uint8_t{1} : std::uint8_t{0}};
  });
  return result;
}

}  // namespace spherule
