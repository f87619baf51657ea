// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pairs of volumes for registration whose true transform is known: a real object, resampled twice.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>
#include <vector>

#include "core/base/parallel.h"
#include "core/pipeline.h"
#include "core/register/transform.h"
#include "tests/bench/scans.h"
#include "tests/phantoms.h"

namespace spherule::bench {

/// A real object as a scalar field over mm of its own grid: 0 outside everything, about 1 inside, the surface at
/// `level`.
class RealObject {
 public:
  RealObject(const Scan& scan, const std::filesystem::path& folder) : name(name_of(scan)) {
    const Volume volume = read(scan, folder);
    grid_ = volume.grid;
    const InsideSamples samples = classify_samples(volume, scan.rule);
    values_.resize(grid_.sample_count());
    double inside = 0, outside = 0;
    std::size_t count = 0, n = 0;
    const bool indicator = scan.rule.kind == ObjectRule::Kind::labels;
    for (std::int32_t k = 0; k < grid_.dims[2]; ++k) {
      for (std::int32_t j = 0; j < grid_.dims[1]; ++j) {
        for (std::int32_t i = 0; i < grid_.dims[0]; ++i, ++n) {
          const bool in = samples.inside.test(i, j, k);
          values_[n] = static_cast<float>(indicator ? in : value_at(volume, i, j, k));
          (in ? inside : outside) += values_[n];
          count += in;
          if (in) where_.push_back({i * grid_.spacing.x, j * grid_.spacing.y, k * grid_.spacing.z});
        }
      }
    }
    inside /= static_cast<double>(count);
    outside /= static_cast<double>(values_.size() - count);
    const auto unit = [&](double v) { return (v - outside) / (inside - outside); };
    for (float& v : values_) v = static_cast<float>(unit(v));
    level = indicator ? 0.5 : unit(scan.rule.lo);
    floor_ = std::min(0.0F, *std::ranges::min_element(values_));
    for (const Vec3 p : where_) box.include(p);
    Vec3 sum;
    for (const Vec3 p : where_) sum = sum + p;
    centre = (1 / static_cast<double>(where_.size())) * sum;
  }

  std::string name;
  double level = 0.5;
  Box box;
  Vec3 centre;
  const std::vector<Vec3>& inside() const { return where_; }

  /// Trilinear; the lowest value beyond the grid.
  double operator()(Vec3 p) const {
    std::array<std::int32_t, 3> at{};
    std::array<double, 3> part{};
    for (int a = 0; a < 3; ++a) {
      const double x = p[a] / grid_.spacing[a];
      const auto s = static_cast<std::size_t>(a);
      if (!(x > -1 && x < grid_.dims[s])) return floor_;
      at[s] = static_cast<std::int32_t>(std::floor(x));
      part[s] = x - at[s];
    }
    const auto [nx, ny, nz] = grid_.dims;
    if (at[0] >= 0 && at[0] + 1 < nx && at[1] >= 0 && at[1] + 1 < ny && at[2] >= 0 && at[2] + 1 < nz) {
      const std::size_t row = static_cast<std::size_t>(nx), slice = row * static_cast<std::size_t>(ny);
      const float* v = &values_[static_cast<std::size_t>(at[0]) + row * static_cast<std::size_t>(at[1]) +
                                slice * static_cast<std::size_t>(at[2])];
      const auto line = [&](const float* w) { return w[0] + part[0] * (w[1] - w[0]); };
      const auto plane = [&](const float* w) { return line(w) + part[1] * (line(w + row) - line(w)); };
      return plane(v) + part[2] * (plane(v + slice) - plane(v));
    }
    double sum = 0;
    for (int c = 0; c < 8; ++c) {
      double weight = 1;
      std::size_t index = 0, stride = 1;
      bool within = true;
      for (std::size_t a = 0; a < 3; ++a) {
        const bool up = (c >> a & 1) != 0;
        const std::int32_t i = at[a] + up;
        weight *= up ? part[a] : 1 - part[a];
        within = within && i >= 0 && i < grid_.dims[a];
        index += static_cast<std::size_t>(std::max(i, 0)) * stride;
        stride *= static_cast<std::size_t>(grid_.dims[a]);
      }
      if (weight > 0) sum += weight * (within ? values_[index] : floor_);
    }
    return sum;
  }

 private:
  Grid grid_;
  std::vector<float> values_;
  std::vector<Vec3> where_;
  float floor_ = 0;
};

/// How a volume of the object is taken.
struct Taking {
  AffineMap to_object;  ///< from the volume's frame to the object's
  double voxel = 1;     ///< edge, in the object's mm
  double noise = 0;     ///< standard deviation, of the difference between inside and outside
  double cropped = 0;   ///< share of the object that is cut off by a plane
  std::uint64_t seed = 1;
};

inline double normal_random(phantoms::Random& random) {
  return std::sqrt(-2 * std::log(1 - random.unit())) * std::cos(2 * std::numbers::pi * random.unit());
}

/// A uniformly random rotation.
inline Mat3 random_rotation(phantoms::Random& random) {
  Quaternion q{normal_random(random), normal_random(random), normal_random(random), normal_random(random)};
  const double size = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  return rotation(Quaternion{q.w / size, q.x / size, q.y / size, q.z / size});
}

inline Vec3 random_direction(phantoms::Random& random) {
  return normalised({normal_random(random), normal_random(random), normal_random(random)});
}

/// Samples the object on an upright cubic grid of its own that just holds it, each voxel the mean over its own space
/// (as a scanner sees it), so coarse volumes are blurred and not merely thinned.
inline Volume taken(const RealObject& object, const Taking& how, unsigned threads = 2) {
  const AffineMap from_object = inverse(how.to_object);
  const double step = how.voxel / scale_of(how.to_object);
  phantoms::Random random(how.seed);
  Vec3 cut_normal;
  double cut_offset = std::numeric_limits<double>::infinity();
  if (how.cropped > 0) {
    cut_normal = random_direction(random);
    std::vector<double> along;
    for (const Vec3 p : object.inside()) along.push_back(dot(cut_normal, p));
    const auto at = along.begin() + static_cast<std::ptrdiff_t>((1 - how.cropped) * static_cast<double>(along.size()));
    std::nth_element(along.begin(), at, along.end());
    cut_offset = *at;
  }
  Box box;
  for (const Vec3 p : object.inside())
    if (dot(cut_normal, p) <= cut_offset) box.include(from_object(p));
  Volume volume;
  volume.type = VoxelType::float32;
  volume.format = "resampled";
  for (int a = 0; a < 3; ++a) {
    volume.grid.dims[static_cast<std::size_t>(a)] = static_cast<std::int32_t>((box.max[a] - box.min[a]) / step) + 6;
    volume.grid.spacing[a] = step;
    volume.grid.origin[a] = box.min[a] - 2.5 * step + (random.unit() - 0.5) * step;
  }
  const auto [nx, ny, nz] = volume.grid.dims;
  volume.voxels.resize(volume.grid.sample_count() * sizeof(float));
  auto* out = reinterpret_cast<float*>(volume.voxels.data());
  const int sub = how.voxel > 3 * 1.0 ? 4 : 2;
  const Context context{.threads = threads, .cancel = {}, .progress = {}};
  parallel_for(context, {}, static_cast<std::size_t>(nz), 1, [&, nx = nx, ny = ny](std::size_t k, std::size_t) {
    for (std::int32_t j = 0; j < ny; ++j) {
      for (std::int32_t i = 0; i < nx; ++i) {
        double sum = 0;
        for (int s = 0; s < sub * sub * sub; ++s) {
          const auto within = [&](int n) { return (n + 0.5) / sub - 0.5; };
          const Vec3 p =
              how.to_object(volume.grid.to_patient({step * (i + within(s % sub)), step * (j + within(s / sub % sub)),
                                                    step * (static_cast<double>(k) + within(s / sub / sub))}));
          sum += dot(cut_normal, p) > cut_offset ? std::min(object(p), 0.0) : object(p);
        }
        out[(k * static_cast<std::size_t>(ny) + static_cast<std::size_t>(j)) * static_cast<std::size_t>(nx) +
            static_cast<std::size_t>(i)] = static_cast<float>(sum / (sub * sub * sub));
      }
    }
  });
  if (how.noise > 0) {
    for (std::size_t n = 0; n < volume.grid.sample_count(); ++n)
      out[n] += static_cast<float>(how.noise * normal_random(random));
  }
  return volume;
}

inline BuiltModel model_of(const RealObject& object, const Volume& volume, unsigned threads = 2) {
  return build_model(volume, threshold(object.level), {}, {.threads = threads, .cancel = {}, .progress = {}});
}

/// Turned any way, scaled by 0.7 … 1.4, shifted by up to a size: from a volume's frame to the object's.
inline AffineMap random_pose(const RealObject& object, phantoms::Random& random) {
  const double scale = 0.7 * std::pow(2.0, random.unit());
  const Mat3 linear = scaled(scale, random_rotation(random));
  const Vec3 size = object.box.max - object.box.min;
  const Vec3 place{(random.unit() - 0.5) * size.x, (random.unit() - 0.5) * size.y, (random.unit() - 0.5) * size.z};
  return {linear, object.centre - linear * place};
}

/// The real objects: none of them symmetric.
inline std::vector<Scan> registration_scans() {
  const RawLayout engine{.dims = {256, 256, 128}, .type = VoxelType::uint8, .spacing = {1, 1, 1}, .origin = {}};
  return {
      {"ct-head.mhd", threshold(1150), 0, {}},      {"stroke-t1.nii.gz", threshold(60), 0, {}},
      {"abdomen-ct.nii.gz", threshold(200), 0, {}}, {"abdomen-ct-small-labels.nii.gz", label(5), 0, {}},
      {"pet.nii", threshold(0.5), 0, {}},           {"spect.nii", threshold(1000), 0, {}},
      {"engine.raw", threshold(80), 0, engine},     {"bonsai.nii.gz", threshold(80), 0, {}},
      {"embryo.nrrd", threshold(40), 0, {}},        {"frog-labels.mhd", label(10), 0, {}},
  };
}

}  // namespace spherule::bench
