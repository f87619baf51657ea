// SPDX-License-Identifier: GPL-3.0-or-later
#include <cmath>

#include "tests/read/files.h"

namespace spherule::test {
namespace {

std::string zeros(const Nifti& n, std::size_t bytes = 60) { return header(n) + std::string(bytes, '\0'); }

Volume read(const std::string& bytes, const ReadOptions& options = {}) {
  const TempFolder folder;
  return read_volume({folder.add("doe.nii", bytes)}, options);
}

void refuse(const std::string& bytes, ErrorCode code, const ReadOptions& options = {}) {
  const TempFolder folder;
  expect_refused_cheaply({folder.add("doe.nii", bytes)}, code, options);
}

TEST(Nifti, ReadsEveryTypeInEitherVersionOrderAndPacking) {
  for (const int version : {1, 2}) {
    for (const bool big_endian : {false, true}) {
      for_each_type([&]<typename T>(T) {
        const auto values = telling_values<T>(60);
        Nifti n{.version = version, .big_endian = big_endian, .datatype = nifti_code(type_of<T>())};
        const std::string bytes = header(n) + bytes_of(values, big_endian);
        for (const std::string& file : {bytes, gzip(bytes)}) {
          const Volume volume = read(file);
          EXPECT_EQ(volume.grid.dims, (std::array{3, 4, 5}));
          EXPECT_EQ(samples<T>(volume), values);
          EXPECT_EQ(volume.format, "nifti");
          EXPECT_EQ(volume.slope, 1);
          EXPECT_EQ(volume.intercept, 0);
          EXPECT_EQ(volume.natural_side, Side::above);
          EXPECT_TRUE(volume.warnings.empty());
        }
      });
    }
  }
}

TEST(Nifti, ReadsPairsOfHeaderAndImage) {
  for (const int version : {1, 2}) {
    const auto values = telling_values<std::int16_t>(60);
    const std::string head = header({.version = version, .big_endian = true, .datatype = 4, .pair = true});
    const std::string image = bytes_of(values, true);
    const TempFolder folder;
    const auto hdr = folder.add("doe.hdr", head), hdr_gz = folder.add("doe.hdr.gz", gzip(head));
    const auto img = folder.add("doe.img", image), img_gz = folder.add("doe.img.gz", gzip(image));
    const auto other = folder.add("other", image), wrong = folder.add("wrong.img", std::string(120, '\1'));
    EXPECT_EQ(samples<std::int16_t>(read_volume({hdr, img})), values);
    EXPECT_EQ(samples<std::int16_t>(read_volume({img_gz, hdr_gz})), values);
    EXPECT_EQ(samples<std::int16_t>(read_volume({hdr, other})), values);
    EXPECT_EQ(samples<std::int16_t>(read_volume({wrong, hdr, img})), values);
    expect_refused({hdr}, ErrorCode::malformed);
    expect_refused({hdr, other, wrong}, ErrorCode::malformed);
  }
}

TEST(Nifti, SkipsExtensionsBeforeTheSamples) {
  const std::string bytes = header({.vox_offset = 1000}) + std::string(1000 - 352, 'x') + std::string(60, '\7');
  EXPECT_EQ(samples<std::uint8_t>(read(bytes)), std::vector<std::uint8_t>(60, 7));
  EXPECT_EQ(samples<std::uint8_t>(read(gzip(bytes))), std::vector<std::uint8_t>(60, 7));
  // 0 in a single file means right behind the header.
  EXPECT_EQ(samples<std::uint8_t>(read(header({.vox_offset = 0}) + std::string(60, '\7'))),
            std::vector<std::uint8_t>(60, 7));
}

TEST(Nifti, AppliesSlopeAndInterceptUnlessTheSlopeIsZeroOrNotANumber) {
  Volume volume = read(zeros({.slope = 0.5, .intercept = -3}));
  EXPECT_EQ(volume.slope, 0.5);
  EXPECT_EQ(volume.intercept, -3);
  for (const double none : {0.0, std::nan("")}) {
    volume = read(zeros({.slope = none, .intercept = 5}));
    EXPECT_EQ(volume.slope, 1);
    EXPECT_EQ(volume.intercept, 0);
  }
  refuse(zeros({.slope = HUGE_VAL}), ErrorCode::unusable);
  refuse(zeros({.slope = 1, .intercept = std::nan("")}), ErrorCode::unusable);
}

TEST(Nifti, PrefersSformThenQformThenSpacings) {
  // Permuted and mirrored: i goes to superior, j to the left of RAS (-x), k to anterior.
  Nifti n{.pixdim = {1, 9, 9, 9, 1, 1, 1, 1},
          .qform_code = 1,
          .sform_code = 2,
          .srow = {0, -2, 0, 10, 0, 0, 3, 20, 4, 0, 0, 30}};
  Volume volume = read(zeros(n));
  expect_near(volume.grid.origin, {-10, -20, 30}, 0);
  expect_step(volume, 0, {0, 0, 4});
  expect_step(volume, 1, {2, 0, 0});
  expect_step(volume, 2, {0, -3, 0});

  // A quarter turn about z: quaternion (cos 45°, 0, 0, sin 45°); qfac = -1 mirrors k.
  n = {.version = 2,
       .pixdim = {-1, 2, 3, 4, 1, 1, 1, 1},
       .qform_code = 1,
       .sform_code = 0,
       .quatern = {0, 0, std::sqrt(0.5)},
       .qoffset = {10, 20, 30}};
  volume = read(zeros(n));
  expect_near(volume.grid.origin, {-10, -20, 30}, 1e-12);
  expect_step(volume, 0, {0, -2, 0});
  expect_step(volume, 1, {3, 0, 0});
  expect_step(volume, 2, {0, 0, -4});
  EXPECT_TRUE(volume.warnings.empty());

  n.qform_code = 0;
  volume = read(zeros(n));
  expect_near(volume.grid.origin, {0, 0, 0}, 0);
  expect_step(volume, 0, {-2, 0, 0});
  expect_step(volume, 1, {0, -3, 0});
  expect_step(volume, 2, {0, 0, 4});
  EXPECT_TRUE(warns(volume, "does not say how the volume lies"));
}

TEST(Nifti, ConvertsUnitsToMillimetres) {
  for (const auto& [units, factor] : {std::pair{1, 1000.0}, {2, 1.0}, {3, 0.001}, {0, 1.0}}) {
    const Volume volume = read(zeros({.units = units | 8, .srow = {2, 0, 0, 10, 0, 3, 0, 20, 0, 0, 4, 30}}));
    expect_near(volume.grid.spacing, factor * Vec3{2, 3, 4}, 1e-12 * factor);
    expect_near(volume.grid.origin, factor * Vec3{-10, -20, 30}, 1e-12 * factor);
  }
}

TEST(Nifti, ReadsAnObliqueAffine) {
  // Rows of Rz(30°)·Ry(20°) times spacings 1, 2, 3.
  const double c = std::cos(M_PI / 6), s = 0.5, d = std::cos(M_PI / 9), e = std::sin(M_PI / 9);
  const Nifti n{.version = 2, .srow = {c * d, -s * 2, c * e * 3, 1, s * d, c * 2, s * e * 3, 2, -e, 0, d * 3, 3}};
  const Volume volume = read(zeros(n));
  expect_near(volume.grid.spacing, {1, 2, 3}, 1e-12);
  expect_step(volume, 0, {-c * d, -s * d, -e});
  expect_step(volume, 1, {s * 2, -c * 2, 0});
  expect_step(volume, 2, {-c * e * 3, -s * e * 3, d * 3});
  expect_near(volume.grid.origin, {-1, -2, 3}, 0);
}

TEST(Nifti, RefusesShearedSingularAndNonFiniteAffines) {
  refuse(zeros({.srow = {1, 0.01, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}), ErrorCode::unusable);
  refuse(zeros({.srow = {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 0, 0}}), ErrorCode::unusable);
  refuse(zeros({.srow = {1, 1, 0, 0, 1, 1, 0, 0, 0, 0, 1, 0}}), ErrorCode::unusable);
  refuse(zeros({.srow = {std::nan(""), 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}}), ErrorCode::unusable);
  refuse(zeros({.srow = {1, 0, 0, HUGE_VAL, 0, 1, 0, 0, 0, 0, 1, 0}}), ErrorCode::unusable);
  for (const int code : {0, 1}) {
    for (const double step : {0.0, -1.0, std::nan(""), HUGE_VAL}) {
      refuse(zeros({.pixdim = {1, 1, step, 1, 1, 1, 1, 1}, .qform_code = code, .sform_code = 0}), ErrorCode::unusable);
    }
  }
  refuse(zeros({.qform_code = 1, .sform_code = 0, .quatern = {std::nan(""), 0, 0}}), ErrorCode::unusable);
  refuse(zeros({.qform_code = 1, .sform_code = 0, .qoffset = {0, HUGE_VAL, 0}}), ErrorCode::unusable);
}

TEST(Nifti, TakesTheQformWhereTheSformCannotBeUsed) {
  Nifti n{.pixdim = {1, 2, 3, 4, 1, 1, 1, 1}, .qform_code = 1, .sform_code = 1, .qoffset = {-10, -20, -30}};
  const double nan = std::nan("");
  for (const std::array<double, 12>& srow :
       {std::array<double, 12>{}, std::array<double, 12>{nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan, nan},
        std::array<double, 12>{2, 1, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0},
        std::array<double, 12>{1e30, 0, 0, 0, 0, 1e30, 0, 0, 0, 0, 1e30, 0}}) {
    n.srow = srow;
    const Volume volume = read(zeros(n));
    EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 4}));
    expect_near(volume.grid.origin, {10, 20, -30}, 0);
    EXPECT_TRUE(warns(volume, "the qform"));
    EXPECT_FALSE(warns(volume, "pixdim; the sform"));
  }
  n.pixdim[2] = 0;
  refuse(zeros(n), ErrorCode::unusable);
}

TEST(Nifti, SaysWhereSformAndPixdimDisagree) {
  const auto warned = [](std::array<double, 8> pixdim, std::array<double, 12> srow, int units = 2) {
    return warns(read(zeros({.pixdim = pixdim, .units = units, .srow = srow})), "than its pixdim");
  };
  EXPECT_TRUE(warned({1, 0.866, 0.866, 0.796, 1, 1, 1, 1}, {1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0}));
  EXPECT_TRUE(warned({1, 2, 3, 4.01, 1, 1, 1, 1}, {2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0}));
  EXPECT_FALSE(warned({1, 2, 3, 4, 1, 1, 1, 1}, {2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0}));
  EXPECT_FALSE(warned({-1, -2, 3, 4, 1, 1, 1, 1}, {0, -3, 0, 0, 2, 0, 0, 0, 0, 0, 4, 0})) << "turned, old signs";
  EXPECT_FALSE(warned({1, 200, 300, 400, 1, 1, 1, 1}, {200, 0, 0, 0, 0, 300, 0, 0, 0, 0, 400, 0}, 3)) << "microns";
  EXPECT_FALSE(warned({1, 0, 0, 0, 1, 1, 1, 1}, {2, 0, 0, 0, 0, 3, 0, 0, 0, 0, 4, 0})) << "pixdim says nothing";
}

TEST(Nifti, MendsWhatLibniftiMendsAndSaysSo) {
  Nifti n{.dims = {3, 4, 5, 0}, .qform_code = 1, .sform_code = 0};
  for (const int version : {1, 2}) {
    n.version = version;
    EXPECT_TRUE(warns(read(zeros(n)), "beyond its third dimension"));
  }
  n = {.dims = {6, 10, 1}, .pixdim = {1, 2, 3, 0, 1, 1, 1, 1}, .qform_code = 1, .sform_code = 0};
  const Volume volume = read(zeros(n));
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 1}));
  EXPECT_TRUE(warns(volume, "pixdim 0"));
  n = {.dims = {3, 4, 5}, .pixdim = {1, 2, 3, 0, 1, 1, 1, 1}, .qform_code = 1, .sform_code = 0};
  refuse(zeros(n), ErrorCode::unusable);
  // Only the flag of extensions, and none behind it.
  std::string flagged = zeros({});
  flagged[348] = 1;
  EXPECT_TRUE(read(flagged).warnings.empty());
}

TEST(Nifti, RefusesScalingThatMakesInfiniteValues) {
  Nifti n{.version = 2, .datatype = 1280, .slope = 1e290};
  refuse(zeros(n, 480), ErrorCode::unusable);
  n.slope = 1, n.intercept = -1e290;
  refuse(zeros(n, 480), ErrorCode::unusable);
}

TEST(Nifti, RefusesGeometryBeyondItsBounds) {
  for (const double step : {1e30, 1e-30}) {
    refuse(zeros({.srow = {step, 0, 0, 0, 0, step, 0, 0, 0, 0, step, 0}}), ErrorCode::unusable);
    const float f = static_cast<float>(step);
    refuse(zeros({.pixdim = {1, f, f, f, 1, 1, 1, 1}, .qform_code = 1, .sform_code = 0}), ErrorCode::unusable);
  }
  refuse(zeros({.srow = {1, 0, 0, 1e30, 0, 1, 0, 0, 0, 0, 1, 0}}), ErrorCode::unusable);
}

TEST(Nifti, APairsSamplesOfTheRightSizeAreNoGzipWhateverTheyStartWith) {
  std::string image(60, '\7');
  image[0] = '\x1f', image[1] = '\x8b';
  const TempFolder folder;
  const Volume volume = read_volume({folder.add("doe.hdr", header({.pair = true})), folder.add("doe.img", image)});
  EXPECT_EQ(samples<std::uint8_t>(volume)[1], 0x8b);
}

TEST(Nifti, ReadsFlatPicturesAsOneSlice) {
  const Volume flat =
      read(header({.dims = {6, 10}, .srow = {2, 0, 0, 0, 0, 2, 0, 0, 0, 0, 0, 0}}) + std::string(60, 1));
  EXPECT_EQ(flat.grid.dims, (std::array{6, 10, 1}));
  expect_near(flat.grid.spacing, {2, 2, 1}, 1e-12);
  EXPECT_EQ(read(header({.dims = {60}}) + std::string(60, 1)).grid.dims, (std::array{60, 1, 1}));
  EXPECT_EQ(read(header({.dims = {3, 4, 5, 1, 1, 1, 1}}) + std::string(60, 1)).grid.dims, (std::array{3, 4, 5}));
}

TEST(Nifti, ChoosesAFrameOfFour) {
  const std::string bytes = header({.dims = {3, 4, 5, 2}}) + std::string(60, '\1') + std::string(60, '\2');
  for (const std::string& file : {bytes, gzip(bytes)}) {
    refuse(file, ErrorCode::unusable);
    for (const int frame : {0, 1}) {
      const Volume volume = read(file, {.frame = frame});
      EXPECT_EQ(samples<std::uint8_t>(volume), std::vector<std::uint8_t>(60, static_cast<std::uint8_t>(frame + 1)));
      EXPECT_TRUE(volume.warnings.empty());
    }
    for (const int frame : {-1, 2}) refuse(file, ErrorCode::invalid_argument, {.frame = frame});
    refuse(file.substr(0, file.size() - 1), ErrorCode::malformed, {.frame = 0});
  }
  EXPECT_NO_THROW(read(zeros({}), {.frame = 0}));
  refuse(zeros({}), ErrorCode::invalid_argument, {.frame = 1});
  try {
    read(bytes);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("2 volumes"), std::string::npos);
    EXPECT_NE(std::string(error.what()).find("frame=0"), std::string::npos);
  }
}

TEST(Nifti, RefusesVectorsColoursAndOddTypes) {
  refuse(zeros({.dims = {3, 4, 5, 1, 3}}), ErrorCode::unusable);
  for (const int type : {128, 2304, 32, 1792, 2048, 1, 1536})
    refuse(zeros({.datatype = type}, 4000), ErrorCode::unusable);
  for (const int type : {0, 3, -5, 30000}) refuse(zeros({.datatype = type}), ErrorCode::malformed);
}

TEST(Nifti, RefusesImpossibleSizes) {
  for (const int version : {1, 2}) {
    for (const std::int64_t n : {0, -1}) refuse(zeros({.version = version, .dims = {3, n, 5}}), ErrorCode::unusable);
    for (const int rank : {0, 8, -7}) {
      Nifti n{.version = version};
      std::string h = header(n);
      h.replace(version == 1 ? 40 : 16, version == 1 ? 2 : 8,
                version == 1 ? bytes_of(static_cast<std::int16_t>(rank), false)
                             : bytes_of(static_cast<std::int64_t>(rank), false));
      refuse(h + std::string(60, '\0'), ErrorCode::malformed);
    }
  }
  refuse(zeros({.dims = {32767, 32767, 32767}}), ErrorCode::too_large);
  refuse(zeros({.version = 2, .dims = {INT64_MAX, INT64_MAX, INT64_MAX}}), ErrorCode::too_large);
  refuse(zeros({.version = 2, .dims = {std::int64_t{1} << 32, 1, 1}}), ErrorCode::too_large);
  refuse(zeros({.version = 2, .dims = {3, 4, 5, INT64_MAX}}), ErrorCode::malformed, {.frame = 0});
  refuse(zeros({.dims = {3, 4, 5}}), ErrorCode::too_large, {.limits = {.max_voxels = 59}});
  refuse(zeros({.datatype = 64}, 480), ErrorCode::too_large, {.limits = {.max_bytes = 479}});
  EXPECT_NO_THROW(read(zeros({.datatype = 64}, 480), {.limits = {.max_voxels = 60, .max_bytes = 480}}));
}

TEST(Nifti, RefusesSizesThatTheFileCannotHold) {
  // Plausible to the limits, not to the file.
  refuse(zeros({.dims = {1000, 1000, 1000}}), ErrorCode::malformed);
  refuse(gzip(zeros({.dims = {1000, 1000, 1000}})), ErrorCode::malformed);
  // Plausible to both at first sight: memory must follow what arrives.
  std::string noise = header({.dims = {1000, 1000, 1000}});
  std::uint32_t state = 1;
  for (int i = 0; i < 2'000'000; ++i) noise += static_cast<char>((state = state * 1664525 + 1013904223) >> 24);
  refuse(gzip(noise), ErrorCode::malformed);
}

TEST(Nifti, RefusesCutAndDamagedFiles) {
  const std::string bytes = zeros({.vox_offset = 400}, 48 + 60);
  for (const std::size_t size : {4, 100, 347, 348, 351, 399, 400, 459}) {
    refuse(bytes.substr(0, size), size < 348 ? ErrorCode::unknown_format : ErrorCode::malformed);
  }
  std::string packed = gzip(header({}) + bytes_of(telling_values<std::uint8_t>(60), false));
  for (std::size_t size = 3; size < packed.size(); ++size) refuse(packed.substr(0, size), ErrorCode::malformed);
  std::string bad_checksum = packed;
  bad_checksum[packed.size() - 6] ^= 1;
  refuse(bad_checksum, ErrorCode::malformed);
  std::string bad_length = packed;
  bad_length[packed.size() - 1] ^= 1;
  refuse(bad_length, ErrorCode::malformed);
  packed[packed.size() / 2] ^= 0x55;
  refuse(packed, ErrorCode::malformed);
}

TEST(Nifti, RefusesImpossibleOffsets) {
  for (const double offset : {1.0, 300.0, 400.5, HUGE_VAL}) refuse(zeros({.vox_offset = offset}), ErrorCode::malformed);
  refuse(zeros({.vox_offset = 1e9}), ErrorCode::too_large);
  std::string negative = zeros({});
  negative.replace(108, 4, bytes_of(-352.0F, false));
  refuse(negative, ErrorCode::malformed);
}

TEST(Nifti, ReadsGzipInSeveralMembersAndIgnoresWhatFollows) {
  const std::string bytes = header({}) + bytes_of(telling_values<std::uint8_t>(60), false);
  const std::string members = gzip(bytes.substr(0, 200)) + gzip(bytes.substr(200, 180)) + gzip(bytes.substr(380));
  EXPECT_EQ(samples<std::uint8_t>(read(members)), telling_values<std::uint8_t>(60));
  EXPECT_EQ(samples<std::uint8_t>(read(gzip(bytes) + std::string(512, '\0'))), telling_values<std::uint8_t>(60));
  for (const std::string& longer : {bytes + "surplus", gzip(bytes + "surplus")}) {
    const Volume volume = read(longer);
    EXPECT_EQ(samples<std::uint8_t>(volume), telling_values<std::uint8_t>(60));
    EXPECT_TRUE(warns(volume, "go on after the last sample"));
  }
}

TEST(Nifti, DoesNotUnpackABombBehindTheSamples) {
  const std::string bomb = gzip(zeros({}, std::size_t{1} << 26));
  const TempFolder folder;
  const auto file = folder.add("doe.nii.gz", bomb);
  EXPECT_TRUE(warns(read_volume({file}), "go on after the last sample"));
  // As one volume of its full size it is a volume of zeros: legitimate, but for the limits.
  refuse(gzip(zeros({.dims = {1024, 1024, 64}}, std::size_t{1} << 26)), ErrorCode::too_large,
         {.limits = {.max_bytes = std::size_t{1} << 25}});
}

TEST(Nifti, NamesAnalyzeHeaders) {
  std::string analyze = header({});
  analyze.replace(344, 4, std::string(4, '\0'));
  analyze[38] = 'r';
  refuse(analyze + std::string(60, '\0'), ErrorCode::unusable);
}

}  // namespace
}  // namespace spherule::test
