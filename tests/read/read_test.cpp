// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/read.h"

#include <cmath>
#include <stop_token>
#include <thread>

#include "core/read/read_header.h"
#include "tests/read/files.h"

namespace spherule::test {
namespace {

TEST(Read, SaysWhatItAcceptsWhenItKnowsNothing) {
  const TempFolder folder;
  for (const std::string& bytes :
       {std::string("just some text\n"), std::string(1000, '\0'), std::string("x"), std::string("NRRD0009\nx"),
        gzip("text"), std::string("key = value\n"), std::string("\x5c\x01\x00\x00", 4)}) {
    const auto file = folder.add("doe.nii", bytes);
    expect_refused_cheaply({file}, ErrorCode::unknown_format);
    try {
      read_volume({file});
    } catch (const Error& error) {
      for (const char* format : {"NIfTI", "NRRD", "MetaImage", "OpenVDB", "format=raw"}) {
        EXPECT_NE(std::string(error.what()).find(format), std::string::npos) << format;
      }
    }
  }
}

TEST(Read, NamesFormatsThatItDoesNotRead) {
  const TempFolder folder;
  const auto says = [&](const std::string& bytes, std::string_view words) {
    const auto file = folder.add("doe", bytes);
    expect_refused({file}, ErrorCode::unknown_format);
    try {
      read_volume({file});
    } catch (const Error& error) {
      EXPECT_NE(std::string_view(error.what()).find(words), std::string::npos) << error.what();
    }
  };
  says(std::string(128, '\0') + "DICM" + std::string(100, '\0'), "DICOM is not read yet");
  says("\x08" + std::string(20, '\0') + "1.2.840.10008.5.1.4.1.1.2", "DICOM is not read yet");
  says("version https://git-lfs.github.com/spec/v1\noid sha256:0\nsize 1\n", "git-LFS");
}

TEST(Read, RefusesNothingEmptyAbsentAndSeveral) {
  const TempFolder folder;
  expect_refused({}, ErrorCode::invalid_argument);
  expect_refused({folder.add("doe", "")}, ErrorCode::malformed);
  expect_refused({folder.path() / "absent"}, ErrorCode::not_found);
  expect_refused({folder.path()}, ErrorCode::not_found);
  const std::string bytes = header({}) + std::string(60, '\0');
  expect_refused({folder.add("doe1", bytes), folder.add("doe2", bytes)}, ErrorCode::unusable);
  expect_refused({folder.add("doe3", gzip(bytes).substr(0, 15))}, ErrorCode::malformed);
}

TEST(Read, KnowsFormatsByTheirBytesNotTheirNames) {
  const TempFolder folder;
  EXPECT_EQ(read_volume({folder.add("a.nrrd", header({}) + std::string(60, '\0'))}).format, "nifti");
  EXPECT_EQ(read_volume({folder.add("b.vdb", "NRRD0001\ntype: uchar\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n\n" +
                                                 std::string(60, '\0'))})
                .format,
            "nrrd");
  EXPECT_EQ(read_volume({folder.add("c.nii.gz",
                                    "\n\nComment = x\nNDims = 3\nDimSize = 3 4 5\nElementType = MET_UCHAR\n"
                                    "ElementDataFile = LOCAL\n" +
                                        std::string(60, '\0'))})
                .format,
            "metaimage");
}

TEST(Read, CountsValuesThatAreNotFinite) {
  std::vector<float> values(60, 1);
  values[3] = std::nanf("");
  const TempFolder folder;
  const auto read = [&] {
    return read_volume({folder.add("doe", header({.datatype = 16}) + bytes_of(values, false))});
  };
  EXPECT_TRUE(warns(read(), "1 voxel is not a finite number"));
  values[7] = -HUGE_VALF;
  const Volume volume = read();
  EXPECT_TRUE(warns(volume, "2 voxels are not a finite number"));
  EXPECT_TRUE(std::isnan(value_at(volume, 0, 1, 0)));
}

TEST(Read, SaysWhereSlicesAreThick) {
  const TempFolder folder;
  const auto warned = [&](std::array<std::int32_t, 3> dims, Vec3 spacing) {
    const auto file = folder.add("doe", std::string(60, '\1'));
    return warns(read_volume({file}, {.raw = RawLayout{.dims = dims, .spacing = spacing}}), "thick slices");
  };
  EXPECT_FALSE(warned({3, 4, 5}, {1, 1, 3.9}));
  EXPECT_TRUE(warned({3, 4, 5}, {1, 1, 3.92}));
  EXPECT_TRUE(warned({3, 4, 5}, {30, 1, 1}));
  EXPECT_TRUE(warned({3, 4, 5}, {1, 1, 0.03}));
  EXPECT_FALSE(warned({6, 10, 1}, {1, 1, 30})) << "one slice";
}

TEST(Read, ReportsProgressAndStopsWhenAsked) {
  const TempFolder folder;
  const auto file = folder.add("doe", gzip(header({.dims = {256, 256, 64}}) + std::string(256 * 256 * 64, '\1')));
  std::stop_source stop;
  double last = 0;
  int calls = 0;
  Context context{.threads = 1, .cancel = stop.get_token(), .progress = [&](std::string_view stage, double done) {
                    EXPECT_EQ(stage, "read");
                    EXPECT_GE(done, last);
                    last = done;
                    ++calls;
                  }};
  read_volume({file}, {}, context);
  EXPECT_EQ(last, 1);
  EXPECT_GE(calls, 4);
  context.progress = [&](std::string_view, double) { stop.request_stop(); };
  try {
    read_volume({file}, {}, context);
    ADD_FAILURE();
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::cancelled);
  }
}

// With the header alone: what is asked for is known before any sample is looked at.
TEST(Read, AsksForTheMemoryOfTheSamplesFirst) {
  const TempFolder folder;
  const std::string nrrd = "NRRD0001\ntype: short\ndimension: 3\nsizes: 50 40 30\nencoding: raw\nendian: little\n\n";
  const std::string meta =
      "ObjectType = Image\nNDims = 3\nDimSize = 50 40 30\nElementType = MET_SHORT\n"
      "ElementDataFile = LOCAL\n";
  const RawLayout layout{.dims = {50, 40, 30}, .type = VoxelType::int16};
  const std::vector<std::pair<std::string, ReadOptions>> files = {
      {nrrd, {}}, {meta, {}}, {gzip(header({.dims = {50, 40, 30}, .datatype = 4})), {}}, {"x", {.raw = layout}}};
  for (auto [bytes, options] : files) {
    const auto file = folder.add("doe", bytes);
    std::size_t asked = 0;
    options.limits.admit = [&](std::size_t wanted) {
      asked = wanted;
      if (wanted == 2 * 50 * 40 * 30) throw Error(ErrorCode::busy, "no room");
    };
    try {
      read_volume({file}, options);
      ADD_FAILURE();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::busy) << error.what();
    }
    EXPECT_EQ(asked, 2U * 50 * 40 * 30);
  }
}

TEST(Read, ReadsFromSeveralThreadsAtOnce) {
  const TempFolder folder;
  const std::string good = "NRRD0001\ntype: uchar\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n";
  const auto nrrd = folder.add("a", good + "\n" + std::string(60, '\7'));
  const auto bad = folder.add("b", "NRRD0001\ntype: quux\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n\n");
  const auto nifti = folder.add("c", gzip(header({.version = 2}) + std::string(60, '\7')));
  std::vector<std::jthread> threads;
  for (int t = 0; t < 4; ++t) {
    threads.emplace_back([&] {
      for (int n = 0; n < 50; ++n) {
        EXPECT_EQ(samples<std::uint8_t>(read_volume({nrrd})), std::vector<std::uint8_t>(60, 7));
        EXPECT_THROW(read_volume({bad}), Error);
        EXPECT_EQ(samples<std::uint8_t>(read_volume({nifti})), std::vector<std::uint8_t>(60, 7));
      }
    });
  }
}

TEST(ReadHeader, WritesNumbersThatReadBackTheSame) {
  for (const double v : {0.1, 1e300, -3.0000000000000004, 5e-324}) {
    EXPECT_EQ(header_number(joined(std::array{v})), v);
  }
}

}  // namespace
}  // namespace spherule::test
