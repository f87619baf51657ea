// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/memory.h"

#include <gtest/gtest.h>

#include "core/io/export_grids.h"

namespace spherule::server {
namespace {

const Box kBox{{0, 0, 0}, {100, 80, 60}};

std::uint64_t to_write(FileFormat format, const FileOptions& options, std::uint64_t spheres = 1000,
                       const std::optional<Grid>& scan = {}) {
  return memory_to_write({.format = format, .options = options}, spheres, kBox, scan);
}

// A level set of a mm has at most the blocks of its box, and no more than are allowed however fine it is.
TEST(MemoryToWrite, CountsTheBlocksOfALevelSet) {
  const std::uint64_t coarse = to_write(FileFormat::vdb, {.voxel_mm = 1}),
                      fine = to_write(FileFormat::vdb, {.voxel_mm = 0.01});
  EXPECT_GE(coarse, 13U * 10 * 8 * 2048);
  EXPECT_LE(coarse, 10U * 13 * 10 * 8 * 4096);
  EXPECT_GE(fine, max_level_set_blocks * 2048);
  EXPECT_EQ(fine, to_write(FileFormat::vdb, {.voxel_mm = 1e-9}));
  EXPECT_EQ(to_write(FileFormat::vdb, {}), to_write(FileFormat::vdb, {.voxel_mm = 100.0 / 256}));
  EXPECT_EQ(coarse, to_write(FileFormat::vdb, {.voxel_mm = 1}, 1'000'000)) << "made in space, not of spheres";
}

TEST(MemoryToWrite, CountsTheSamplesOfAMask) {
  Grid scan;
  scan.dims = {200, 300, 400};
  EXPECT_GE(to_write(FileFormat::nifti, {}, 1000, scan), scan.sample_count());
  EXPECT_GE(to_write(FileFormat::nifti, {.voxel_mm = 0.5}, 1000, scan), 200U * 160 * 120);
  EXPECT_LT(to_write(FileFormat::nifti, {.voxel_mm = 0.5}, 1000, scan), to_write(FileFormat::nifti, {}, 1000, scan));
}

TEST(MemoryToWrite, CountsTrianglesAndLines) {
  const auto mesh = [](int detail) {
    return to_write(FileFormat::glb, {.glb = {.style = GlbOptions::Style::mesh, .detail = detail}});
  };
  EXPECT_EQ(mesh(3), 4 * mesh(2));
  EXPECT_GE(mesh(2), 1000U * 320 * 12);
  EXPECT_LE(mesh(5), max_glb_triangles * 48);
  EXPECT_LT(to_write(FileFormat::glb, {}), mesh(0));
  EXPECT_EQ(to_write(FileFormat::yade, {}, 2000), 2 * to_write(FileFormat::yade, {}, 1000));
}

}  // namespace
}  // namespace spherule::server
