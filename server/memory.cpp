// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/memory.h"

#include <algorithm>
#include <cmath>

#include "core/io/export_grids.h"

namespace spherule::server {

namespace {

// Measured: 480 to 667 bytes a point (ct-head, abdomen-ct, engine, ch2), most of it CGAL's triangulation.
constexpr std::uint64_t bytes_a_point = 700;
// Measured on engine: 144 bytes a tetrahedron while the union is measured.
constexpr std::uint64_t bytes_a_tetrahedron = 150;
// Of an imported set, whose union makes its own tetrahedra: about 7 a sphere.
constexpr std::uint64_t bytes_a_sphere = 7 * bytes_a_tetrahedron;

// Cubes of an edge in a box, and a layer around; at most `most`.
std::uint64_t cubes_in(const Box& box, double edge, std::uint64_t most) {
  double cubes = 1;
  for (int a = 0; a < 3; ++a) cubes *= std::floor((box.max[a] - box.min[a]) / edge) + 3;
  return cubes < static_cast<double>(most) ? static_cast<std::uint64_t>(cubes) : most;
}

}  // namespace

std::uint64_t memory_to_model(const Grid& grid, VoxelType type) {
  const auto samples = static_cast<double>(grid.sample_count());
  const double points = std::min(samples / 8, 24 * std::pow(samples, 2.0 / 3));
  return memory_to_model(grid, type, static_cast<std::size_t>(points));
}

std::uint64_t memory_to_model(const Grid& grid, VoxelType type, std::size_t boundary_points) {
  // The samples, and a bit or two of each that say on which side they are.
  return grid.sample_count() * (bytes_per_voxel(type) + 1) + boundary_points * bytes_a_point;
}

std::uint64_t memory_to_derive(const api::ModelInfo& model) {
  return model.tetrahedra > 0 ? model.tetrahedra * bytes_a_tetrahedron : model.spheres * bytes_a_sphere;
}

std::uint64_t memory_to_write(const api::FileRequest& file, std::uint64_t spheres, const Box& box,
                              const std::optional<Grid>& scan) {
  // Text that grows by doubling; corners and triangles of meshes likewise; a block of a level set as it is made, in the
  // library's tree and in the file; a mask as bits, as bytes and packed.
  constexpr std::uint64_t bytes_a_line = 400, bytes_a_triangle = 48, bytes_a_block = 8192, bytes_a_sample = 3,
                          most_samples = std::uint64_t{1} << 29;
  switch (file.format) {
    case FileFormat::glb: {
      if (file.options.glb.style == GlbOptions::Style::instanced) return spheres * bytes_a_line;
      const std::uint64_t triangles = spheres * (std::uint64_t{20} << (2 * file.options.glb.detail));
      return std::min<std::uint64_t>(triangles, max_glb_triangles) * bytes_a_triangle;
    }
    case FileFormat::vdb: {
      const Vec3 size = box.max - box.min;
      const double voxel = file.options.voxel_mm.value_or(std::max({size.x, size.y, size.z, 1e-6}) / 256);
      return cubes_in(box, 8 * voxel, max_level_set_blocks) * bytes_a_block;
    }
    case FileFormat::nifti: {
      const auto& voxel = file.options.voxel_mm;
      return (voxel || !scan ? cubes_in(box, voxel.value_or(1), most_samples) : scan->sample_count()) * bytes_a_sample;
    }
    default: return spheres * bytes_a_line;
  }
}

std::uint64_t memory_to_simplify(const api::ModelInfo& model, const std::optional<Grid>& grid) {
  // By count: 5 bytes a sample for distances, 4 where balls are refined, the volume itself before that; of a raw model
  // 120 bytes a sphere for its clusters, and itself.
  constexpr std::uint64_t bytes_a_sample = 10, bytes_a_raw_sphere = 160, samples_of_a_union = std::uint64_t{1} << 22;
  const std::uint64_t samples = grid ? grid->sample_count() : samples_of_a_union;
  return samples * bytes_a_sample + model.spheres * (model.tetrahedra > 0 ? bytes_a_raw_sphere : bytes_a_sphere) +
         model.tetrahedra * sizeof(Tetrahedron);
}

std::uint64_t memory_to_slice(const api::VolumeInfo& volume) {
  return volume.grid.sample_count() * bytes_per_voxel(volume.type);
}

}  // namespace spherule::server
