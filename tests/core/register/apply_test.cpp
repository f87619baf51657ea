// SPDX-License-Identifier: GPL-3.0-or-later
//
// What is done with a transform: files, resampled volumes, pictures.
#include <gtest/gtest.h>

#include <fstream>

#include "core/read/read.h"
#include "core/register/itk.h"
#include "core/register/picture.h"
#include "core/register/resample.h"
#include "core/write/write_nifti.h"
#include "tests/core/register/poses.h"
#include "tests/core/render/scenes.h"
#include "tests/errors.h"

namespace spherule {
namespace {

TEST(ItkTransform, IsTheTextThatItkWrites) {
  const AffineMap map{{{Vec3{0, -2, 0}, Vec3{2, 0, 0}, Vec3{0, 0, 2}}}, {1.5, -0.1, 1e-7}};
  EXPECT_EQ(itk_transform(map),
            "#Insight Transform File V1.0\n"
            "#Transform 0\n"
            "Transform: AffineTransform_double_3_3\n"
            "Parameters: 0 -2 0 2 0 0 0 0 2 1.5 -0.1 1e-07\n"
            "FixedParameters: 0 0 0\n");
}

// A linear function is what linear interpolation gives back exactly, in any pose and on any grid.
TEST(Resample, LinearFunctionsAreExact) {
  phantoms::Random random(1);
  for (int t = 0; t < 5; ++t) {
    const auto linear = [](Vec3 p) { return 3 * p.x - 2 * p.y + 0.5 * p.z + 7; };
    Grid grid = phantoms::cubic_grid(12, 30);
    grid.direction = poses::random_rotation(random);
    const Volume moving = phantoms::sample(linear, grid, VoxelType::float64);
    const AffineMap map{scaled(1.5, poses::random_rotation(random)), poses::within_cube(random, 20)};
    Grid fixed = phantoms::cubic_grid(9, 8);
    const Vec3 middle = grid.to_patient({15, 15, 15});
    fixed.origin = map(middle) + Vec3{-4, -4, -4};
    const Volume result = resampled(moving, map, fixed);
    ASSERT_EQ(result.type, VoxelType::float32);
    for (std::int32_t k = 0; k < 9; ++k) {
      for (std::int32_t j = 0; j < 9; ++j) {
        for (std::int32_t i = 0; i < 9; ++i) {
          const Vec3 at =
              inverse(map)(fixed.to_patient({i * fixed.spacing.x, j * fixed.spacing.y, k * fixed.spacing.z}));
          EXPECT_NEAR(value_at(result, i, j, k), linear(at), 1e-4);
        }
      }
    }
  }
}

TEST(Resample, TheIdentityKeepsEverySampleAndBeyondIsTheLeast) {
  const Volume moving = phantoms::noise(phantoms::cubic_grid(7, 6), 200, 3);
  const Volume same = resampled(moving, {}, moving.grid);
  const Volume shifted =
      resampled(moving, {{}, {100, 0, 0}}, moving.grid, {.threads = 3, .cancel = {}, .progress = {}});
  const double least = value_range(moving).min;
  for (std::int32_t k = 0; k < 7; ++k) {
    for (std::int32_t j = 0; j < 7; ++j) {
      for (std::int32_t i = 0; i < 7; ++i) {
        EXPECT_EQ(value_at(same, i, j, k), value_at(moving, i, j, k));
        EXPECT_EQ(value_at(shifted, i, j, k), least);
      }
    }
  }
  // A single slice has nothing to interpolate between.
  Grid flat = phantoms::cubic_grid(7, 6);
  flat.dims[2] = 1;
  const Volume slice = phantoms::noise(flat, 200, 3);
  EXPECT_EQ(value_at(resampled(slice, {}, flat), 3, 4, 0), value_at(slice, 3, 4, 0));
}

TEST(Resample, SamplesOfAModelAreThoseInItsBalls) {
  const SphereModel ball{.spheres = {{{1, 0, 0}, 2}}, .solid = {}};
  const AffineMap map{scaled(2, Mat3{}), {0, 1, 0}};
  const Volume samples = sampled(ball, map, phantoms::cubic_grid(21, 20));
  for (std::int32_t k = 0; k < 21; ++k)
    for (std::int32_t j = 0; j < 21; ++j)
      for (std::int32_t i = 0; i < 21; ++i)
        EXPECT_EQ(value_at(samples, i, j, k), norm(Vec3{i - 10.0, j - 10.0, k - 10.0} - Vec3{2, 1, 0}) <= 4 ? 1 : 0);
}

TEST(WriteNifti, IsReadBack) {
  phantoms::Random random(2);
  const auto file = std::filesystem::path(testing::TempDir()) / "spherule-write-nifti-test.nii";
  for (int t = 0; t < 12; ++t) {
    Grid grid;
    grid.dims = {5, 4, 3};
    grid.spacing = {0.5, 1.25, 3};
    grid.origin = poses::within_cube(random, 200);
    // Half turns about the axes, where the quaternion's real part is 0, and any pose; both hands.
    if (t < 4) grid.direction = rotation(std::numbers::pi * Vec3{double(t == 1), double(t == 2), double(t == 3)});
    if (t >= 4) grid.direction = poses::random_rotation(random);
    if (t % 2 == 1)
      for (Vec3& row : grid.direction.rows) row.z = -row.z;
    const VoxelType type = t % 3 == 0 ? VoxelType::float32 : t % 3 == 1 ? VoxelType::uint8 : VoxelType::int16;
    Volume volume = phantoms::noise(grid, 100, 5, type);
    volume.slope = 0.5, volume.intercept = -3;
    const std::string bytes = volume_to_nifti(volume);
    for (const bool without_sform : {false, true}) {
      std::string written = bytes;
      if (without_sform) written[254] = 0;
      std::ofstream(file, std::ios::binary) << written;
      const Volume again = read_volume({file});
      EXPECT_EQ(again.grid.dims, grid.dims);
      EXPECT_EQ(again.type, type);
      EXPECT_EQ(again.voxels, volume.voxels);
      EXPECT_EQ(again.slope, 0.5);
      EXPECT_EQ(again.intercept, -3);
      for (const Vec3 p : {Vec3{0, 0, 0}, Vec3{2, 0, 0}, Vec3{0, 3.75, 0}, Vec3{0, 0, 6}})
        EXPECT_LT(norm(again.grid.to_patient(p) - grid.to_patient(p)), 1e-4) << t << without_sform;
    }
  }
  Volume long_row;
  long_row.grid.dims = {40000, 1, 1};
  long_row.voxels.resize(40000);
  std::ofstream(file, std::ios::binary) << volume_to_nifti(long_row);
  EXPECT_EQ(read_volume({file}).grid.dims, long_row.grid.dims) << "NIfTI-2";
  std::filesystem::remove(file);
}

TEST(BeforeAfter, ShowsTwoPicturesThatDiffer) {
  const SphereModel fixed{.spheres = {{{0, 0, 0}, 2}, {{3, 0, 0}, 1}}, .solid = {}};
  SphereModel moving = fixed;
  for (Sphere& s : moving.spheres) s.centre = s.centre + Vec3{0, 0, 9};
  RenderOptions options;
  options.width = 60, options.height = 50, options.samples_per_axis = 1;
  const Image both = before_and_after(fixed, moving, {{}, {0, 0, -9}}, options);
  EXPECT_EQ(both.width, 120);
  EXPECT_EQ(both.height, 50);
  const auto half = [&](int from) {
    std::vector<std::uint8_t> pixels;
    for (int y = 0; y < 50; ++y)
      for (int x = 0; x < 60; ++x) pixels.insert(pixels.end(), both.at(from + x, y), both.at(from + x, y) + 4);
    return pixels;
  };
  EXPECT_NE(half(0), half(60));
  // After, both lie in the same place: as a picture of the pair that never moved.
  const Image still = before_and_after(fixed, fixed, {}, options);
  std::vector<std::uint8_t> right;
  for (int y = 0; y < 50; ++y)
    for (int x = 0; x < 60; ++x) right.insert(right.end(), still.at(60 + x, y), still.at(60 + x, y) + 4);
  EXPECT_EQ(half(60), right);
}

// What raw models show is found by their tetrahedra, and moved with them.
TEST(BeforeAfter, ShowsAllBallsOfRawModels) {
  const Scan scan = lumpy_scan();
  const SphereModel raw = build_model(scan.volume, scan.rule).model;
  const AffineMap map{scaled(1.1, rotation(Vec3{0.3, 0.2, 0.5})), {3, 4, 5}};
  const RenderOptions options{.width = 200, .height = 200, .layout = Layout::overlaid};
  const Image both = before_and_after(raw, raw, map, options);
  const SphereModel still{.spheres = raw.spheres, .solid = {}};
  SphereModel moved = still;
  for (int after = 0; after < 2; ++after) {
    const std::array<Subject, 2> subjects{Subject{.model = &still}, Subject{.model = &moved}};
    const Image one = render(subjects, options).front();
    Image part = blank_image(one.width, one.height);
    place(both, -after * one.width, 0, part);
    EXPECT_EQ(part.rgba, one.rgba) << after;
    for (Sphere& ball : moved.spheres) ball = {map(ball.centre), scale_of(map) * ball.radius};
  }
}

TEST(BeforeAfter, RefusesStylesThatNeedMoreThanBalls) {
  const SphereModel model{.spheres = {{{0, 0, 0}, 2}}, .solid = {}};
  RenderOptions options;
  options.width = 16, options.height = 16, options.samples_per_axis = 1;
  for (const Style style : {Style::surface, Style::tetrahedra, Style::points}) {
    options.style = style;
    test::expect_error([&] { before_and_after(model, model, {}, options); }, ErrorCode::unusable);
  }
}

}  // namespace
}  // namespace spherule
