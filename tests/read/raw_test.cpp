// SPDX-License-Identifier: GPL-3.0-or-later
#include <cmath>

#include "tests/read/files.h"

namespace spherule::test {
namespace {

ReadOptions raw(RawLayout layout) { return {.raw = layout}; }

TEST(Raw, ReadsEveryTypeInEitherOrderAndPacking) {
  for (const bool big_endian : {false, true}) {
    for_each_type([&]<typename T>(T) {
      const auto values = telling_values<T>(60);
      const std::string bytes = bytes_of(values, big_endian);
      const TempFolder folder;
      const RawLayout layout{
          .dims = {3, 4, 5}, .type = type_of<T>(), .spacing = {1, 2, 3}, .origin = {4, 5, 6}, .big_endian = big_endian};
      for (const auto& file : {folder.add("doe.raw", bytes), folder.add("doe.raw.gz", gzip(bytes))}) {
        const Volume volume = read_volume({file}, raw(layout));
        EXPECT_EQ(samples<T>(volume), values);
        EXPECT_EQ(volume.grid.dims, (std::array{3, 4, 5}));
        EXPECT_EQ(volume.grid.spacing, (Vec3{1, 2, 3}));
        EXPECT_EQ(volume.grid.origin, (Vec3{4, 5, 6}));
        EXPECT_EQ(volume.grid.direction, Mat3{});
        EXPECT_EQ(volume.format, "raw");
      }
    });
  }
}

TEST(Raw, BelievesASizeThatFitsOverBytesThatLookLikeGzip) {
  const TempFolder folder;
  const auto file = folder.add("doe", "\x1f\x8b\x01\x02");
  const Volume volume = read_volume({file}, raw({.dims = {2, 2, 1}}));
  EXPECT_EQ(samples<std::uint8_t>(volume), (std::vector<std::uint8_t>{0x1f, 0x8b, 1, 2}));
}

TEST(Raw, RefusesLayoutsThatAreNotPossible) {
  const TempFolder folder;
  const auto file = folder.add("doe", std::string(60, '\0'));
  for (const int n : {0, -1}) {
    expect_refused({file}, ErrorCode::invalid_argument, raw({.dims = {3, n, 5}}));
  }
  for (const double s : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
    expect_refused({file}, ErrorCode::invalid_argument, raw({.dims = {3, 4, 5}, .spacing = {1, s, 1}}));
  }
  expect_refused({file}, ErrorCode::invalid_argument, raw({.dims = {3, 4, 5}, .origin = {0, 0, std::nan("")}}));
  expect_refused({file, file}, ErrorCode::invalid_argument, raw({.dims = {3, 4, 5}}));
  try {
    read_volume({file}, raw({.dims = {3, 4, 0}}));
    ADD_FAILURE();
  } catch (const Error& error) {
    ASSERT_EQ(error.fields().size(), 1U);
    EXPECT_EQ(error.fields()[0].pointer, "dims");
  }
}

TEST(Raw, RefusesSizesThatTheFileOrTheLimitsDoNotHold) {
  const TempFolder folder;
  const auto file = folder.add("doe", std::string(60, '\0'));
  expect_refused_cheaply({file}, ErrorCode::malformed, raw({.dims = {3, 4, 6}}));
  expect_refused_cheaply({file}, ErrorCode::malformed, raw({.dims = {3, 4, 5}, .type = VoxelType::uint16}));
  expect_refused_cheaply({file}, ErrorCode::malformed, raw({.dims = {1000, 1000, 1000}}));
  expect_refused_cheaply({file}, ErrorCode::too_large, raw({.dims = {INT32_MAX, INT32_MAX, INT32_MAX}}));
  EXPECT_TRUE(warns(read_volume({file}, raw({.dims = {3, 4, 4}})), "go on after the last sample"));
  for (const double step : {1e110, 1e-110, 1e9})
    expect_refused_cheaply({file}, ErrorCode::invalid_argument, raw({.dims = {3, 4, 5}, .spacing = {1, step, 1}}));
  for (const double far : {1e110, -2e9})
    expect_refused_cheaply({file}, ErrorCode::invalid_argument, raw({.dims = {3, 4, 5}, .origin = {0, far, 0}}));
}

}  // namespace
}  // namespace spherule::test
