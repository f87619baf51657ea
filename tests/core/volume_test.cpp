// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/volume.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>

#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr std::array kTypes = {VoxelType::uint8,   VoxelType::int8,   VoxelType::uint16, VoxelType::int16,
                               VoxelType::uint32,  VoxelType::int32,  VoxelType::uint64, VoxelType::int64,
                               VoxelType::float32, VoxelType::float64};

ErrorCode code_of(auto&& action) {
  try {
    action();
  } catch (const Error& error) {
    return error.code();
  }
  ADD_FAILURE() << "no Error was thrown";
  return ErrorCode::busy;
}

TEST(VoxelTypes, HaveNumPyNamesAndSizes) {
  for (const VoxelType type : kTypes) {
    EXPECT_EQ(voxel_type(name(type)), type);
    Volume volume;
    volume.type = type;
    volume.voxels.resize(bytes_per_voxel(type));
    visit_voxels(volume, [&]<typename T>(std::span<const T> samples) {
      EXPECT_EQ(sizeof(T), bytes_per_voxel(type));
      EXPECT_EQ(samples.size(), 1U);
      const std::string letter = std::is_floating_point_v<T> ? "float" : std::is_signed_v<T> ? "int" : "uint";
      EXPECT_EQ(name(type), letter + std::to_string(8 * sizeof(T)));
    });
  }
  for (const auto* word : {"", "uint", "UINT8", "float16", "uint8 "}) {
    EXPECT_EQ(code_of([&] { voxel_type(word); }), ErrorCode::invalid_argument) << word;
  }
}

TEST(Values, AreSlopeTimesStoredPlusInterceptAtTheRightSample) {
  for (const VoxelType type : kTypes) {
    const Grid grid{.dims = {3, 4, 5}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
    const auto volume = phantoms::sample([](Vec3 p) { return p.x + 3 * p.y + 12 * p.z; }, grid, type, 0.5, -2);
    // Stored: 2·(v + 2), which fits every type.
    for (std::int32_t k = 0; k < 5; ++k) {
      for (std::int32_t j = 0; j < 4; ++j) {
        for (std::int32_t i = 0; i < 3; ++i) {
          ASSERT_EQ(value_at(volume, i, j, k), i + 3 * j + 12 * k) << name(type);
        }
      }
    }
  }
}

TEST(GridFromAffine, RecoversSpacingDirectionAndOrigin) {
  // A rotation by 30 degrees about z and a mirrored last axis.
  const double c = std::sqrt(0.75), s = 0.5;
  const Mat3 direction{{Vec3{c, -s, 0}, Vec3{s, c, 0}, Vec3{0, 0, -1}}};
  const Mat3 axes{{Vec3{2 * c, -3 * s, 0}, Vec3{2 * s, 3 * c, 0}, Vec3{0, 0, -5}}};
  const Grid grid = grid_from_affine({4, 5, 6}, axes, {7, 8, 9});
  EXPECT_NEAR(norm(grid.spacing - Vec3{2, 3, 5}), 0, 1e-15);
  for (int r = 0; r < 3; ++r) EXPECT_NEAR(norm(grid.direction.rows[r] - direction.rows[r]), 0, 1e-15);
  EXPECT_NEAR(norm(grid.to_patient({2 * 1, 3 * 1, 5 * 1}) - (Vec3{7, 8, 9} + axes * Vec3{1, 1, 1})), 0, 1e-14);
}

TEST(GridFromAffine, RoundsSmallShearToARotationAndRefusesMore) {
  const auto sheared = [](double by) { return Mat3{{Vec3{1, by, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}}; };
  const Grid grid = grid_from_affine({2, 2, 2}, sheared(9e-4), {});
  const Mat3 should_be_one = transposed(grid.direction) * grid.direction;
  for (int r = 0; r < 3; ++r) EXPECT_NEAR(norm(should_be_one.rows[r] - Mat3{}.rows[r]), 0, 1e-15);
  EXPECT_EQ(code_of([&] { grid_from_affine({2, 2, 2}, sheared(1.1e-3), {}); }), ErrorCode::unusable);
}

TEST(GridFromAffine, RefusesWhatIsNoGrid) {
  const double inf = std::numeric_limits<double>::infinity(), nan = std::numeric_limits<double>::quiet_NaN();
  for (const double bad : {0.0, inf, nan, 1e-320, 1e300 * 1e10}) {
    const Mat3 axes{{Vec3{1, 0, 0}, Vec3{0, bad, 0}, Vec3{0, 0, 1}}};
    EXPECT_EQ(code_of([&] { grid_from_affine({2, 2, 2}, axes, {}); }), ErrorCode::unusable) << bad;
  }
  for (const double bad : {inf, nan})
    EXPECT_EQ(code_of([&] { grid_from_affine({2, 2, 2}, {}, {0, 0, bad}); }), ErrorCode::unusable);
  EXPECT_EQ(code_of([&] { grid_from_affine({2, 0, 2}, {}, {}); }), ErrorCode::unusable);
  EXPECT_EQ(code_of([&] { grid_from_affine({2, 2, -1}, {}, {}); }), ErrorCode::unusable);
}

// Whatever is made of a volume must stay a finite number: bounds in mm, and in steps.
TEST(GridFromAffine, RefusesWhatWouldMakeFiguresThatAreNotFinite) {
  const auto scaled = [](double step) { return Mat3{{Vec3{step, 0, 0}, Vec3{0, step, 0}, Vec3{0, 0, step}}}; };
  for (const double step : {1e110, 1.1e9, 0.6e9, 0.9e-9, 1e-110})
    EXPECT_EQ(code_of([&] { grid_from_affine({3, 3, 3}, scaled(step), {}); }), ErrorCode::unusable) << step;
  for (const double step : {0.5e9, 1e-9}) EXPECT_NO_THROW(grid_from_affine({3, 3, 3}, scaled(step), {})) << step;
  for (const double far : {1e110, 1.1e9, -1.1e9})
    EXPECT_EQ(code_of([&] { grid_from_affine({3, 3, 3}, {}, {0, far, 0}); }), ErrorCode::unusable) << far;
  EXPECT_NO_THROW(grid_from_affine({3, 3, 3}, {}, {0, 0.9e9, 0}));
  // The far corner counts, the way that the axes point.
  EXPECT_NO_THROW(grid_from_affine({11, 1, 1}, scaled(-1e8), {0.9e9, 0, 0}));
  EXPECT_EQ(code_of([&] { grid_from_affine({11, 1, 1}, scaled(1e8), {0.9e9, 0, 0}); }), ErrorCode::unusable);
  // So far away that neighbouring samples would be in the same place.
  EXPECT_NO_THROW(grid_from_affine({3, 3, 3}, scaled(0.01), {5e6, 4e5, 100}));
  EXPECT_NO_THROW(grid_from_affine({3, 3, 3}, scaled(1e-3), {0x1p35 * 1e-3, 0, 0}));
  EXPECT_EQ(code_of([&] { grid_from_affine({3, 3, 3}, scaled(1e-3), {0x1p37 * 1e-3, 0, 0}); }), ErrorCode::unusable);
  EXPECT_EQ(code_of([&] {
              grid_from_affine({3, 3, 3}, {{Vec3{1e110, 1e110, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}}}, {});
            }),
            ErrorCode::unusable);
}

TEST(ValueRange, IsOfValuesThatAreFiniteNotOfStoredNumbers) {
  const Grid grid{.dims = {3, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const std::array values{1e300, -1e10, 3.0};
  auto volume = phantoms::sample([&](Vec3 p) { return values[static_cast<std::size_t>(p.x)]; }, grid);
  volume.slope = 1e200;
  EXPECT_EQ(value_range(volume).not_finite, 1U);
  EXPECT_EQ(value_range(volume).min, 1e200 * -1e10);
  EXPECT_EQ(value_range(volume).max, 1e200 * 3);
}

TEST(ValueHistogram, OfAllThatFloatsHoldDoesNotOverflow) {
  const Grid grid{.dims = {3, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const double largest = std::numeric_limits<double>::max(), least = std::numeric_limits<double>::denorm_min();
  for (const auto& values : {std::array{-largest, 0.0, largest}, std::array{0.0, 0.0, least}}) {
    const auto volume = phantoms::sample([&](Vec3 p) { return values[static_cast<std::size_t>(p.x)]; }, grid);
    const auto counts = value_histogram(volume, value_range(volume), 3);
    EXPECT_EQ(counts[0] + counts[1] + counts[2], 3U);
    EXPECT_GE(counts[0], 1U);
  }
}

TEST(ValueRange, IsOverFiniteSamplesOnly) {
  const double inf = std::numeric_limits<double>::infinity(), nan = std::numeric_limits<double>::quiet_NaN();
  const Grid grid{.dims = {5, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const std::array values{nan, -3.0, inf, 7.0, -inf};
  const auto volume = phantoms::sample([&](Vec3 p) { return values[static_cast<std::size_t>(p.x)]; }, grid);
  const ValueRange range = value_range(volume);
  EXPECT_EQ(range.min, -3);
  EXPECT_EQ(range.max, 7);
  EXPECT_EQ(range.not_finite, 3U);
  const ValueRange nothing = value_range(phantoms::sample([&](Vec3) { return nan; }, grid));
  EXPECT_EQ(nothing.min, 0);
  EXPECT_EQ(nothing.max, 0);
  EXPECT_EQ(nothing.not_finite, 5U);
}

TEST(ValueRange, FollowsANegativeSlope) {
  const Grid grid{.dims = {4, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const auto volume = phantoms::sample([](Vec3 p) { return -2 * p.x + 1; }, grid, VoxelType::int16, -2, 1);
  EXPECT_EQ(value_range(volume).min, -5);
  EXPECT_EQ(value_range(volume).max, 1);
}

TEST(ValueHistogram, CountsEveryFiniteValueOnceAndClosesTheLastBucket) {
  const Grid grid{.dims = {10, 1, 1}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const auto volume = phantoms::sample([](Vec3 p) { return p.x; }, grid, VoxelType::uint8);
  EXPECT_EQ(value_histogram(volume, value_range(volume), 3), (std::vector<std::uint64_t>{3, 3, 4}));
  EXPECT_EQ(value_histogram(volume, {2, 4, 0}, 2), (std::vector<std::uint64_t>{1, 2}));
  EXPECT_EQ(value_histogram(volume, {5, 5, 0}, 2), (std::vector<std::uint64_t>{1, 0}));
  for (const std::size_t bad : {std::size_t{0}, std::size_t{65537}})
    EXPECT_EQ(code_of([&] { value_histogram(volume, {0, 9, 0}, bad); }), ErrorCode::invalid_argument);
}

}  // namespace
}  // namespace spherule
