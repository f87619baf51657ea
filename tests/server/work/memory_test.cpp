// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/memory.h"

#include <gtest/gtest.h>

#include <array>

#include "core/write/export_grids.h"

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
  EXPECT_LE(mesh(5), max_glb_triangles * 90);
  EXPECT_LT(to_write(FileFormat::glb, {}), mesh(0));
  EXPECT_EQ(to_write(FileFormat::yade, {}, 2000), 2 * to_write(FileFormat::yade, {}, 1000));
}

// A raw model of a few spheres, made from a large scan.
const ScanSize kScan{.samples = std::uint64_t{1} << 27, .bytes = std::uint64_t{1} << 29};
const ModelSize kFew{.spheres = 60, .cells = 100, .inside_cells = 60, .points = 40, .stored = 3000, .scan = kScan};
const ModelSize kSet{.spheres = 1'000'000, .stored = 32'000'000};

std::uint64_t to_draw(const RenderOptions& options, const ModelSize& model) {
  return memory_to_draw(options, std::array{model});
}

TEST(MemoryToModel, IsThatOfReadingUntilTheSurfaceIsKnown) {
  EXPECT_GE(memory_to_count(kScan), kScan.bytes + kScan.samples / 8);
  EXPECT_LE(memory_to_count(kScan), kScan.bytes + kScan.samples / 2) << "no guess that refuses what would fit";
  EXPECT_GE(memory_to_model(kScan, 1'000'000), memory_to_count(kScan) + 600'000'000);
}

TEST(MemoryToDerive, CountsTheVolumeBehindASmallModel) {
  EXPECT_GE(memory_to_measure(kFew), kScan.bytes);
  EXPECT_GE(memory_to_check(kFew), kScan.bytes);
  EXPECT_GE(to_draw({.style = Style::surface}, kFew), kScan.bytes);
  EXPECT_LT(to_draw({.style = Style::spheres}, kFew), kScan.bytes / 8);
  EXPECT_LT(memory_to_measure_parts(kFew), kScan.bytes / 8);
  EXPECT_GE(memory_to_simplify(SplittingOptions{}, kFew, kFew), kScan.bytes);
}

TEST(MemoryToDerive, CountsPixels) {
  EXPECT_GE(to_draw({.width = 4000, .height = 4000}, kFew), 4U * 4000 * 4000);
  EXPECT_GE(to_draw({.width = 400, .height = 400, .turntable = 100}, kFew), 4U * 4000 * 4000);
}

TEST(MemoryToDerive, CountsTheTextOfListings) {
  const auto to_list = [](api::SphereFormat format, std::vector<api::SphereFigure> columns) {
    return memory_to_list({.format = format, .listing = {.columns = std::move(columns)}}, kSet, {});
  };
  const std::uint64_t plain = to_list(api::SphereFormat::csv, {});
  EXPECT_GE(plain, kSet.loaded() + kSet.spheres * 4 * 18);
  EXPECT_GE(to_list(api::SphereFormat::csv, {api::SphereFigure::index}), plain + kSet.spheres * (18 + 8));
  EXPECT_GE(to_list(api::SphereFormat::csv, {api::SphereFigure::area_mm2}), plain + kSet.spheres * 300);
  EXPECT_GE(to_list(api::SphereFormat::npy, {}), kSet.loaded() + kSet.spheres * 16);
}

TEST(MemoryToApply, CountsBothGrids) {
  EXPECT_GE(memory_to_apply(api::Applied::volume, kFew, kFew), kScan.bytes + 8 * kScan.samples);
  EXPECT_GE(memory_to_apply(api::Applied::model, kFew, kSet), kSet.loaded() + 2 * kScan.samples);
}

TEST(MemoryToImport, CountsTheRowsOfATable) {
  EXPECT_GE(memory_to_import(api::SphereFormat::csv, 8'000'000, 1'000'000), 32U * 1'000'000);
  EXPECT_GE(memory_to_import(api::SphereFormat::npy, 16'000'000, 0), 32U * 1'000'000);
}

}  // namespace
}  // namespace spherule::server
