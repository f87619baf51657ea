// SPDX-License-Identifier: GPL-3.0-or-later
//
// Real scans, against what ../shared/data/README.md says was measured with other readers.
#include <cmath>

#include "tests/read/files.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

using SharedData = SharedFiles;

std::size_t at_least(const Volume& volume, double threshold) {
  return visit_voxels(volume, [&](auto samples) {
    std::size_t count = 0;
    for (const auto v : samples) count += volume.slope * static_cast<double>(v) + volume.intercept >= threshold;
    return count;
  });
}

std::size_t equal_to(const Volume& volume, double label) {
  return visit_voxels(volume, [&](auto samples) {
    std::size_t count = 0;
    for (const auto v : samples) count += static_cast<double>(v) == label;
    return count;
  });
}

RawLayout engine() { return {.dims = {256, 256, 128}}; }

TEST_F(SharedData, ScansHaveTheSizesTypesRangesAndCountsOfTheirReadme) {
  struct Scan {
    std::vector<std::string> files;
    std::string format;
    std::array<std::int32_t, 3> dims;
    Vec3 spacing;
    std::string type;
    double min, max;
    std::vector<std::pair<double, std::size_t>> counts;
  };
  std::vector<std::string> quarter{"ct-head-nrrd/quarter.nhdr"};
  for (int n = 1; n <= 93; ++n) quarter.push_back("ct-head-nrrd/quarter." + std::to_string(n));
  const std::vector<Scan> scans = {
      {{"ct-head.mhd", "ct-head.raw"},
       "metaimage",
       {64, 64, 93},
       {3.2, 3.2, 1.5},
       "int16",
       0,
       3926,
       {{500, 144968}, {1150, 34295}}},
      {quarter, "nrrd", {64, 64, 93}, {3.2, 3.2, 1.5}, "int16", 0, 3926, {{500, 144968}, {1150, 34295}}},
      {{"mr-small.raw", "mr-small.mhd"}, "metaimage", {48, 62, 42}, {4, 4, 4}, "uint8", 0, 255, {{30, 36922}}},
      {{"ch2.nii.gz"}, "nifti", {181, 217, 181}, {1, 1, 1}, "uint8", 0, 254, {{30, 3603543}, {60, 2846771}}},
      {{"stroke-t1.nii.gz"}, "nifti", {124, 160, 140}, {1, 1, 1}, "uint8", 0, 252, {{60, 889397}}},
      {{"abdomen-ct.nii.gz"},
       "nifti",
       {122, 101, 112},
       {3, 3, 3},
       "int32",
       -1207,
       3382,
       {{-300, 866749}, {200, 26922}}},
      {{"abdomen-ct-small.nii.gz"},
       "nifti",
       {122, 101, 30},
       {3, 3, 3},
       "int16",
       -1100,
       1207,
       {{-300, 230563}, {200, 3377}}},
      {{"abdomen-ct-small-labels.nii.gz"}, "nifti", {122, 101, 30}, {3, 3, 3}, "uint8", 0, 117, {}},
      {{"pet.nii"}, "nifti", {91, 109, 91}, {2, 2, 2}, "uint8", 0, 1, {{0.3, 306985}, {0.5, 226301}, {0.75, 85739}}},
      {{"spect.nii"}, "nifti", {91, 109, 91}, {2, 2, 2}, "int16", 0, 1929, {{1000, 184943}}},
      {{"engine.nii.gz"}, "nifti", {256, 256, 128}, {1, 1, 1}, "uint8", 0, 255, {{80, 1131002}, {180, 69847}}},
      {{"bonsai.nii.gz"}, "nifti", {256, 256, 256}, {1, 1, 1}, "uint8", 0, 255, {{40, 1618090}, {80, 1147123}}},
      {{"stent.nrrd"}, "nrrd", {128, 128, 256}, {1, 1, 1}, "int16", 0, 2000, {{300, 133537}, {1000, 6535}}},
      {{"embryo.nrrd"}, "nrrd", {256, 256, 256}, {1, 1, 1}, "uint8", 0, 197, {{40, 705027}, {80, 232832}}},
      {{"frog-labels.mhd", "frog-labels.zraw"}, "metaimage", {500, 470, 136}, {1, 1, 1.5}, "uint8", 0, 29, {}},
      {{"dicom-ct-j2k-labels.nii.gz"}, "nifti", {512, 512, 20}, {0.9765625, 0.9765625, 2}, "uint8", 0, 117, {}},
  };
  for (const Scan& scan : scans) {
    SCOPED_TRACE(scan.files[0]);
    const Volume volume = read(scan.files);
    EXPECT_EQ(volume.format, scan.format);
    EXPECT_EQ(volume.grid.dims, scan.dims);
    expect_near(volume.grid.spacing, scan.spacing, 1e-6);
    EXPECT_EQ(name(volume.type), scan.type);
    const ValueRange range = value_range(volume);
    EXPECT_EQ(range.not_finite, 0U);
    EXPECT_NEAR(range.min, scan.min, 1e-6);
    EXPECT_NEAR(range.max, scan.max, 1e-6);
    for (const auto& [threshold, count] : scan.counts) EXPECT_EQ(at_least(volume, threshold), count) << threshold;
  }
}

TEST_F(SharedData, LabelMapsHaveTheCountsOfTheirReadme) {
  Volume volume = read({"abdomen-ct-small-labels.nii.gz"});
  for (const auto& [label, count] : {std::pair{5, 38634U}, {2, 3947U}, {3, 3676U}, {1, 9452U}}) {
    EXPECT_EQ(equal_to(volume, label), count);
  }
  volume = read({"frog-labels.mhd", "frog-labels.zraw"});
  for (const auto& [label, count] : {std::pair{13, 440722U}, {10, 204672U}, {15, 133880U}, {9, 51297U}}) {
    EXPECT_EQ(equal_to(volume, label), count);
  }
  volume = read({"dicom-ct-j2k-labels.nii.gz"});
  for (const auto& [label, count] : {std::pair{5, 366708U}, {1, 130634U}, {6, 74102U}}) {
    EXPECT_EQ(equal_to(volume, label), count);
  }
}

Vec3 last_place(const Volume& volume) {
  const Grid& g = volume.grid;
  return g.to_patient({(g.dims[0] - 1) * g.spacing.x, (g.dims[1] - 1) * g.spacing.y, (g.dims[2] - 1) * g.spacing.z});
}

// After reports of users of other programs; counts by OpenVDB itself.
TEST_F(SharedData, OpenVdbFilesFromTheFieldAreRead) {
  EXPECT_EQ(at_least(read({"field/09-stream.vdb"}), 2), 2109U);
  const Volume moved = read({"field/10-instanced.vdb"}, {.grid = "density_moved"});
  EXPECT_EQ(at_least(moved, 2), 2109U);
  const Volume after_empty = read({"field/10-empty-first.vdb"});
  EXPECT_EQ(at_least(after_empty, 1), 515U);
  EXPECT_TRUE(warns(after_empty, "the first one with active voxels"));
  const Vec3 last = last_place(moved);  // with the layer around
  expect_near(last, {104.5, 4.5, 4.5}, 1);
  expect_refused_cheaply(paths({"field/16-sparse.vdb"}), ErrorCode::too_large);
}

TEST_F(SharedData, TheSameScanIsTheSameInEveryFormat) {
  const Volume raw = read({"engine.raw"}, {.raw = engine()});
  EXPECT_EQ(raw.voxels, read({"engine.nii.gz"}).voxels);
  std::vector<std::string> quarter{"ct-head-nrrd/quarter.nhdr"};
  for (int n = 1; n <= 93; ++n) quarter.push_back("ct-head-nrrd/quarter." + std::to_string(n));
  const Volume nrrd = read(quarter), meta = read({"ct-head.mhd", "ct-head.raw"});
  EXPECT_EQ(nrrd.voxels, meta.voxels);
  EXPECT_EQ(nrrd.grid.spacing, meta.grid.spacing);
  EXPECT_EQ(nrrd.grid.origin, meta.grid.origin);
  EXPECT_EQ(nrrd.grid.direction, meta.grid.direction);
}

// The affines as the NIfTI standard has them, worked out from the header's own bytes.
TEST_F(SharedData, AffinesAreThoseOfTheHeaders) {
  const auto f32 = [](const std::string& bytes, std::size_t at, bool big_endian) {
    std::uint32_t word = 0;
    std::memcpy(&word, bytes.data() + at, 4);
    return static_cast<double>(std::bit_cast<float>(big_endian ? __builtin_bswap32(word) : word));
  };
  // Uncompressed: the header as it is; PET's x axis is reversed (LAS), SPECT is big-endian.
  for (const auto& [file, big_endian] : {std::pair{"pet.nii", false}, {"spect.nii", true}}) {
    SCOPED_TRACE(file);
    const std::string bytes = bytes_of_file(folder_ / file);
    const Volume volume = read({file});
    const bool sform = bytes[big_endian ? 255 : 254] > 0, qform = bytes[big_endian ? 253 : 252] > 0;
    ASSERT_TRUE(sform || qform);
    for (int axis = 0; axis < 3; ++axis) {
      Vec3 step;
      if (sform) {
        for (int r = 0; r < 3; ++r) step[r] = f32(bytes, 280 + static_cast<std::size_t>(16 * r + 4 * axis), big_endian);
      } else {
        const double b = f32(bytes, 256, big_endian), c = f32(bytes, 260, big_endian), d = f32(bytes, 264, big_endian);
        const double a = std::sqrt(std::max(0.0, 1 - b * b - c * c - d * d));
        const double rotation[3][3] = {{a * a + b * b - c * c - d * d, 2 * (b * c - a * d), 2 * (b * d + a * c)},
                                       {2 * (b * c + a * d), a * a + c * c - b * b - d * d, 2 * (c * d - a * b)},
                                       {2 * (b * d - a * c), 2 * (c * d + a * b), a * a + d * d - b * b - c * c}};
        double spacing = f32(bytes, 80 + static_cast<std::size_t>(4 * axis), big_endian);
        if (axis == 2 && f32(bytes, 76, big_endian) < 0) spacing = -spacing;
        for (int r = 0; r < 3; ++r) step[r] = spacing * rotation[r][axis];
      }
      expect_step(volume, axis, {-step.x, -step.y, step.z}, 1e-5);
    }
    Vec3 origin;
    for (int r = 0; r < 3; ++r) {
      origin[r] = f32(bytes, sform ? 292 + static_cast<std::size_t>(16 * r) : 268 + static_cast<std::size_t>(4 * r),
                      big_endian);
    }
    expect_near(volume.grid.origin, {-origin.x, -origin.y, origin.z}, 1e-6);
  }
  expect_step(read({"pet.nii"}), 0, {2, 0, 0});     // LAS: x runs to the patient's left
  expect_step(read({"spect.nii"}), 0, {-2, 0, 0});  // RAS
  // The stroke scan is turned by some 19 degrees; sform and qform agree, so the axes are a rotation.
  const Volume oblique = read({"stroke-t1.nii.gz"});
  EXPECT_NEAR(std::acos(oblique.grid.direction.rows[2].z) * 180 / M_PI, 19, 0.5);
  // Both of these lie on DICOM's 0.9765625 mm grid, as the README says: x to the left, j against y.
  const Volume labels = read({"dicom-ct-j2k-labels.nii.gz"});
  expect_step(labels, 0, {0.9765625, 0, 0});
  expect_step(labels, 1, {0, -0.9765625, 0});
}

TEST_F(SharedData, ReadsOpenVdb) {
  Volume volume = read({"sphere-levelset.vdb"});
  EXPECT_EQ(volume.natural_side, Side::below);
  EXPECT_EQ(volume.grid.dims, (std::array{127, 127, 127}));  // 125 active and one more on either side
  expect_near(volume.grid.spacing, {0.05, 0.05, 0.05}, 1e-8);
  EXPECT_NEAR(value_range(volume).min, -0.15, 1e-4);
  EXPECT_NEAR(value_range(volume).max, 0.15, 1e-4);
  const std::size_t outside = at_least(volume, std::nextafter(0.0, 1.0));
  EXPECT_EQ(volume.grid.sample_count() - outside, 904089U);
  expect_near(volume.grid.origin, {-3.15, -3.15, -3.15}, 1e-6);

  volume = read({"smoke-fog.vdb"});
  EXPECT_EQ(volume.natural_side, Side::above);
  EXPECT_EQ(volume.grid.dims, (std::array{113, 224, 114}));
  expect_near(volume.grid.spacing, Vec3{1 / 2.1, 1 / 2.1, 1 / 2.1}, 1e-5);
  EXPECT_EQ(at_least(volume, 0.1), 260452U);
  EXPECT_EQ(at_least(volume, 0.5), 84933U);
  EXPECT_NEAR(value_range(volume).max, 5.715, 1e-3);

  volume = read({"sphere-fog.vdb"});
  EXPECT_EQ(volume.grid.dims, (std::array{13, 11, 13}));
  expect_near(volume.grid.spacing, {0.2, 0.2, 0.2}, 1e-7);
  EXPECT_EQ(value_range(volume).max, 1);
}

TEST_F(SharedData, EveryMalformedFileGetsItsRefusalCheaply) {
  const std::vector<std::tuple<std::string, ErrorCode, std::string>> files = {
      {"padded-header-missing-slices.mhd", ErrorCode::malformed, "data files that were not sent"},
      {"missing-slices.nhdr", ErrorCode::malformed, "data files that were not sent"},
      {"truncated.nii.gz", ErrorCode::malformed, "the file is cut"},
      {"four-d.nii.gz", ErrorCode::unusable, "2 volumes"},
      {"rgb-2d.nrrd", ErrorCode::unusable, "colour"},
      {"lfs-pointer.vdb", ErrorCode::unknown_format, "git-LFS"},
      {"points-only.vdb", ErrorCode::unusable, "no scalar grid"},
      {"truncated-pixels.dcm", ErrorCode::unknown_format, "DICOM is not read yet"},
      {"bad-vr.dcm", ErrorCode::unknown_format, "DICOM is not read yet"},
      {"no-preamble.dcm", ErrorCode::unknown_format, "DICOM is not read yet"},
      {"no-transfer-syntax.dcm", ErrorCode::unknown_format, "DICOM is not read yet"},
      {"truncated-plan.dcm", ErrorCode::unknown_format, "DICOM is not read yet"},
  };
  std::size_t known = 0;
  for (const auto& entry : fs::directory_iterator(folder_ / "malformed")) {
    for (const auto& [file, code, words] : files) {
      if (entry.path().filename() != file) continue;
      ++known;
      SCOPED_TRACE(file);
      expect_refused_cheaply({entry.path()}, code);
      try {
        read_volume({entry.path()});
      } catch (const Error& error) {
        EXPECT_NE(std::string_view(error.what()).find(words), std::string::npos) << error.what();
      }
    }
  }
  EXPECT_EQ(known, files.size());
  EXPECT_EQ(read({"malformed/four-d.nii.gz"}, {.frame = 1}).grid.dims, (std::array{128, 96, 24}));
  EXPECT_NE(read({"malformed/four-d.nii.gz"}, {.frame = 0}).voxels,
            read({"malformed/four-d.nii.gz"}, {.frame = 1}).voxels);
}

// Cut anywhere, and beside the data of another scan.
TEST_F(SharedData, CutScansAreRefused) {
  const TempFolder folder;
  const std::string scan = bytes_of_file(folder_ / "embryo.nrrd"), vdb = bytes_of_file(folder_ / "smoke-fog.vdb");
  for (const double part : {0.01, 0.5, 0.999}) {
    const auto cut = [&](const std::string& bytes) {
      return bytes.substr(0, static_cast<std::size_t>(part * static_cast<double>(bytes.size())));
    };
    expect_refused({folder.add("doe.nrrd", cut(scan))}, ErrorCode::malformed);
    expect_refused({folder.add("doe.vdb", cut(vdb))}, ErrorCode::malformed);
  }
  expect_refused(paths({"ct-head.mhd", "mr-small.raw"}), ErrorCode::malformed);
}

}  // namespace
}  // namespace spherule::test
