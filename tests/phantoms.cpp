// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/phantoms.h"

#include <cmath>
#include <cstring>
#include <limits>
#include <type_traits>
#include <utility>

namespace spherule::phantoms {

namespace {

template <typename T>
T stored_as(double value) {
  if constexpr (std::is_integral_v<T>) {
    // The largest 64-bit integers round up to a power of two in double, so >= and not >.
    if (value >= static_cast<double>(std::numeric_limits<T>::max())) return std::numeric_limits<T>::max();
    if (value <= static_cast<double>(std::numeric_limits<T>::min())) return std::numeric_limits<T>::min();
    return static_cast<T>(std::round(value));
  } else {
    return static_cast<T>(value);
  }
}

Volume empty_volume(const Grid& grid, VoxelType type, double slope, double intercept) {
  Volume volume;
  volume.grid = grid;
  volume.type = type;
  volume.slope = slope;
  volume.intercept = intercept;
  volume.voxels.resize(grid.sample_count() * bytes_per_voxel(type));
  volume.format = "phantom";
  return volume;
}

void store(Volume& volume, std::size_t index, double stored) {
  visit_voxels(volume, [&]<typename T>(std::span<const T>) {
    const T value = stored_as<T>(stored);
    std::memcpy(volume.voxels.data() + index * sizeof(T), &value, sizeof(T));
  });
}

// The distance to a shape of revolution or a product, from its distances in two perpendicular directions.
double corner_distance(double u, double v) {
  return u < 0 || v < 0 ? -std::hypot(std::min(u, 0.0), std::min(v, 0.0)) : std::min(u, v);
}

}  // namespace

Field ball(Vec3 centre, double radius) {
  return [=](Vec3 p) { return radius - norm(p - centre); };
}

Field torus(Vec3 centre, double radius, double tube) {
  return [=](Vec3 p) {
    const Vec3 q = p - centre;
    return tube - std::hypot(std::hypot(q.x, q.y) - radius, q.z);
  };
}

Field cylinder(Vec3 axis, double radius) {
  return [=](Vec3 p) { return radius - std::hypot(p.x - axis.x, p.y - axis.y); };
}

Field capped_cylinder(Vec3 centre, double radius, double half_height) {
  return [=](Vec3 p) {
    const Vec3 q = p - centre;
    return corner_distance(radius - std::hypot(q.x, q.y), half_height - std::abs(q.z));
  };
}

Field cube(Vec3 centre, double half_edge) {
  return [=](Vec3 p) {
    const Vec3 q = p - centre;
    const double x = half_edge - std::abs(q.x), y = half_edge - std::abs(q.y), z = half_edge - std::abs(q.z);
    return corner_distance(corner_distance(x, y), z);
  };
}

Field slab(double centre_z, double half_thickness) {
  return [=](Vec3 p) { return half_thickness - std::abs(p.z - centre_z); };
}

Field shell(Vec3 centre, double outer, double inner) {
  return [=](Vec3 p) { return std::min(outer - norm(p - centre), norm(p - centre) - inner); };
}

Field either(Field a, Field b) {
  return [a = std::move(a), b = std::move(b)](Vec3 p) { return std::max(a(p), b(p)); };
}

Field paper_ball(Vec3 centre) {
  return [=](Vec3 p) { return std::max(0.0, 255 * (1 - norm(p - centre) / 11.5)); };
}

Field paper_cylinder(Vec3 centre) {
  return [=](Vec3 p) { return std::max(0.0, 255 * (1 - std::hypot(p.x - centre.x, p.y - centre.y) / 11.5)); };
}

Volume sample(const Field& field, const Grid& grid, VoxelType type, double slope, double intercept) {
  Volume volume = empty_volume(grid, type, slope, intercept);
  std::size_t index = 0;
  for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
        const Vec3 at = grid.to_patient({i * grid.spacing.x, j * grid.spacing.y, k * grid.spacing.z});
        store(volume, index++, (field(at) - intercept) / slope);
      }
    }
  }
  return volume;
}

Volume noise(const Grid& grid, std::uint32_t levels, std::uint64_t seed, VoxelType type) {
  Volume volume = empty_volume(grid, type, 1, 0);
  Random random(seed);
  for (std::size_t i = 0; i < grid.sample_count(); ++i) store(volume, i, static_cast<double>(random.below(levels)));
  return volume;
}

Volume noise_with_gaps(const Grid& grid, std::uint32_t levels, std::uint64_t seed) {
  Volume volume = noise(grid, levels, seed, VoxelType::float64);
  Random random(seed + 1);
  constexpr double kInfinity = std::numeric_limits<double>::infinity();
  const std::array gaps{std::numeric_limits<double>::quiet_NaN(), kInfinity, -kInfinity};
  for (std::size_t i = 0; i < grid.sample_count(); ++i) {
    if (random.below(8) == 0) store(volume, i, gaps[random.below(3)]);
  }
  return volume;
}

Grid cubic_grid(std::int32_t n, double edge) {
  const double step = edge / (n - 1);
  return {
      .dims = {n, n, n}, .spacing = {step, step, step}, .origin = {-edge / 2, -edge / 2, -edge / 2}, .direction = {}};
}

void set_stored(Volume& volume, std::array<std::int32_t, 3> at, double stored) {
  const auto& n = volume.grid.dims;
  store(volume,
        static_cast<std::size_t>(at[0]) +
            static_cast<std::size_t>(n[0]) *
                (static_cast<std::size_t>(at[1]) + static_cast<std::size_t>(n[1]) * static_cast<std::size_t>(at[2])),
        stored);
}

ObjectRule threshold(double lo, Border border, Side side) {
  return {.kind = ObjectRule::Kind::threshold, .lo = lo, .hi = 0, .labels = {}, .side = side, .border = border};
}

ObjectRule range(double lo, double hi, Border border, Side side) {
  return {.kind = ObjectRule::Kind::range, .lo = lo, .hi = hi, .labels = {}, .side = side, .border = border};
}

ObjectRule labels(std::vector<Label> values, Border border, Side side) {
  return {
      .kind = ObjectRule::Kind::labels, .lo = 0, .hi = 0, .labels = std::move(values), .side = side, .border = border};
}

}  // namespace spherule::phantoms
