// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/io/files.h"

namespace spherule::test {
namespace {

const std::string kStart = "NRRD0004\n";
const std::string kBytes = "type: uchar\ndimension: 3\nsizes: 3 4 5\nencoding: raw\nkinds: domain domain domain\n";

Volume read(const std::string& bytes, const ReadOptions& options = {}) {
  const TempFolder folder;
  return read_volume({folder.add("doe.nrrd", bytes)}, options);
}

void refuse(const std::string& bytes, ErrorCode code, const ReadOptions& options = {}) {
  const TempFolder folder;
  expect_refused_cheaply({folder.add("doe.nrrd", bytes)}, code, options);
}

// A header with extra fields, and 60 zero bytes.
std::string with(const std::string& fields, const std::string& basic = kBytes, std::size_t bytes = 60) {
  return kStart + basic + fields + "\n" + std::string(bytes, '\0');
}

TEST(Nrrd, ReadsEveryTypeInEitherOrderEncodingAndPlace) {
  for (const bool big_endian : {false, true}) {
    for_each_type([&]<typename T>(T) {
      const auto values = telling_values<T>(60);
      const std::string bytes = bytes_of(values, big_endian);
      std::string type(name(type_of<T>()));
      if (type == "float32") type = "float";
      if (type == "float64") type = "double";
      const std::string fields = "type: " + type + "\ndimension: 3\nsizes: 3 4 5\nspacings: 1 2 3\nendian: " +
                                 (big_endian ? "big" : "little") + "\n";
      const TempFolder folder;
      const auto header = folder.add("doe.nhdr", kStart + fields + "encoding: raw\ndata file: doe.raw\n");
      const auto header_gz = folder.add("doe.gz.nhdr", kStart + fields + "encoding: gzip\ndatafile: ./doe.raw.gz\n\n");
      const std::vector<Paths> ways = {
          {folder.add("doe.nrrd", kStart + fields + "encoding: raw\n\n" + bytes)},
          {folder.add("doe.gz.nrrd", kStart + fields + "encoding: gzip\n\n" + gzip(bytes))},
          {header, folder.add("doe.raw", bytes)},
          {folder.add("doe.raw.gz", gzip(bytes)), header_gz},
      };
      for (const Paths& files : ways) {
        const Volume volume = read_volume(files);
        EXPECT_EQ(volume.grid.dims, (std::array{3, 4, 5}));
        EXPECT_EQ(samples<T>(volume), values);
        EXPECT_EQ(volume.grid.spacing, (Vec3{1, 2, 3}));
        EXPECT_EQ(volume.format, "nrrd");
      }
    });
  }
}

TEST(Nrrd, KnowsTheOtherNamesOfTypes) {
  const std::vector<std::pair<std::string, VoxelType>> names = {
      {"signed char", VoxelType::int8},      {"unsigned char", VoxelType::uint8},       {"short int", VoxelType::int16},
      {"unsigned short", VoxelType::uint16}, {"signed int", VoxelType::int32},          {"UINT", VoxelType::uint32},
      {"long long int", VoxelType::int64},   {"unsigned long long", VoxelType::uint64}, {"int16_t", VoxelType::int16},
      {"ulonglong", VoxelType::uint64}};
  for (const auto& [word, type] : names) {
    const std::string bytes = with("", "type: " + word + "\ndimension: 3\nsizes: 5 4 3\nencoding: raw\nendian: big\n",
                                   60 * bytes_per_voxel(type));
    EXPECT_EQ(read(bytes).type, type) << word;
  }
  refuse(with("", "type: block\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n"), ErrorCode::unusable);
  refuse(with("", "type: quux\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n"), ErrorCode::unusable);
  refuse(with("", "type: %s%n\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n"), ErrorCode::malformed);
}

TEST(Nrrd, ReadsCommentsKeysLineEndsAndAnyOrder) {
  std::string bytes =
      "NRRD0005\r\n# a comment: of doe\r\nencoding: RAW\r\nsizes: 5 4 3\r\nDimension: 3\r\nkey:=value: doe\r\n"
      "content: doe\r\ntype: uchar\r\n\r\n" +
      std::string(60, '\7');
  EXPECT_EQ(samples<std::uint8_t>(read(bytes)), std::vector<std::uint8_t>(60, 7));
}

TEST(Nrrd, TurnsEverySpaceToLps) {
  const std::string directions = "space directions: (0, 2, 0) (-3,0,0) (0,0,4)\nspace origin: (10,20,30)\n";
  for (const auto& [space, x, y, patient] : {std::tuple{"left-posterior-superior", 1, 1, true},
                                             {"LPS", 1, 1, true},
                                             {"right-anterior-superior", -1, -1, true},
                                             {"RAS", -1, -1, true},
                                             {"left-anterior-superior", 1, -1, true},
                                             {"LAS", 1, -1, true},
                                             {"scanner-xyz", 1, 1, false},
                                             {"3D-left-handed", 1, 1, false}}) {
    const Volume volume = read(with("space: " + std::string(space) + "\n" + directions));
    expect_near(volume.grid.origin, {x * 10.0, y * 20.0, 30}, 0);
    expect_step(volume, 0, {0, y * 2.0, 0});
    expect_step(volume, 1, {x * -3.0, 0, 0});
    expect_step(volume, 2, {0, 0, 4});
    EXPECT_EQ(warns(volume, "does not say how the volume lies"), !patient) << space;
  }
  refuse(with("space: left-posterior-superior-time\n" + directions), ErrorCode::unusable);
  refuse(with("space: LPST\n" + directions), ErrorCode::unusable);
}

TEST(Nrrd, ReadsSpacingsBesideASpaceAndAxisMins) {
  Volume volume = read(with("space: 3D-left-handed\nspacings: 3.2 3.2 1.5\n"));
  EXPECT_EQ(volume.grid.spacing, (Vec3{3.2, 3.2, 1.5}));
  EXPECT_EQ(volume.grid.origin, Vec3{});
  volume = read(with("spacings: 2 2 2\naxis mins: 10 20 30\ncenterings: node node node\n"));
  EXPECT_EQ(volume.grid.origin, (Vec3{10, 20, 30}));
  // The first of cells lies half a cell behind its border.
  volume = read(with("spacings: 2 2 2\naxis mins: 10 20 30\ncenters: cell cell cell\n"));
  EXPECT_EQ(volume.grid.origin, (Vec3{11, 21, 31}));
  EXPECT_EQ(read(with("")).grid.spacing, (Vec3{1, 1, 1}));
}

TEST(Nrrd, ReadsOneFileASlice) {
  const TempFolder folder;
  Paths slices;
  std::vector<std::uint8_t> expected;
  for (int k = 0; k < 5; ++k) {
    slices.push_back(folder.add("doe." + std::to_string(k + 8), std::string(12, static_cast<char>(k))));
    folder.add("d" + std::string(k + 8 < 10 ? "0" : "") + std::to_string(k + 8), std::string(12, static_cast<char>(k)));
    expected.insert(expected.end(), 12, static_cast<std::uint8_t>(k));
  }
  const auto read_with = [&](const std::string& data, const Paths& files) {
    Paths all = files;
    all.push_back(folder.add("doe.nhdr", kStart + kBytes + data));
    return samples<std::uint8_t>(read_volume(all));
  };
  EXPECT_EQ(read_with("data file: doe.%d 8 12 1\n", slices), expected);
  EXPECT_EQ(read_with("data file: doe.%d 8 12 1 2\n\n", slices), expected);
  EXPECT_EQ(read_with("data file: LIST\ndoe.8\ndoe.9\ndoe.10\ndoe.11\ndoe.12\n", slices), expected);
  Paths padded;
  for (const char* n : {"d08", "d09", "d10", "d11", "d12"}) padded.push_back(folder.path() / n);
  EXPECT_EQ(read_with("data file: d%02d 8 12 1\n", padded), expected);
  std::vector<std::uint8_t> reversed(expected.rbegin(), expected.rend());
  EXPECT_EQ(read_with("data file: doe.%d 12 8 -1\n", slices), reversed);

  const auto refuse_with = [&](const std::string& data) {
    Paths all = slices;
    all.push_back(folder.add("bad.nhdr", kStart + kBytes + data));
    expect_refused_cheaply(all, ErrorCode::malformed);
  };
  for (const char* pattern :
       {"doe.%d 8 13 1", "doe.%d 8 2000000000 1", "doe.%d 8 12 0", "doe.%d 8 11 1", "doe.%s 8 12 1", "doe.%n 8 12 1",
        "doe.%d%d 8 12 1", "doe.%999999999d 8 12 1", "doe.%-5d 8 12 1", "doe.%d 12 8 1", "doe.%d -8 12 1",
        "doe.%d 8 x 1", "doe.%d 9223372036854775807 9223372036854775807 9223372036854775807", "doe.% 8 12 1"}) {
    refuse_with("data file: " + std::string(pattern) + "\n");
  }
  refuse_with("data file: LIST\n");
  refuse_with("data file: LIST\ndoe.8\ndoe.9\n");
  refuse_with("data file: LIST\ndoe.8\ndoe.9\ndoe.10\ndoe.11\nother\n");
}

TEST(Nrrd, SkipsLinesAndBytes) {
  const TempFolder folder;
  const std::string data = "first\nsecond\nxyz" + std::string(60, '\7');
  const auto file = folder.add("doe.raw", data);
  const auto packed = folder.add("doe.gz", gzip("xyz" + std::string(60, '\7')));
  const auto read_with = [&](const std::string& fields, const std::filesystem::path& from) {
    return samples<std::uint8_t>(read_volume({folder.add("doe.nhdr", kStart + fields), from}));
  };
  const std::vector<std::uint8_t> sevens(60, 7);
  EXPECT_EQ(read_with(kBytes + "data file: doe.raw\nline skip: 2\nbyte skip: 3\n", file), sevens);
  EXPECT_EQ(read_with(kBytes + "data file: doe.raw\nbyteskip: 16\n", file), sevens);
  EXPECT_EQ(read_with(kBytes + "data file: doe.raw\nbyte skip: -1\n", file), sevens);
  EXPECT_EQ(
      read_with("type: uchar\ndimension: 3\nsizes: 5 4 3\nencoding: gz\ndata file: doe.gz\nbyte skip: 3\n", packed),
      sevens);
  for (const char* skip : {"line skip: 99", "line skip: -1", "byte skip: -2", "byte skip: 99", "byte skip: 9e9",
                           "byte skip: 9223372036854775807", "line skip: 9223372036854775807"}) {
    const auto header = folder.add("bad.nhdr", kStart + kBytes + "data file: doe.raw\n" + skip + "\n");
    expect_refused_cheaply({header, file}, ErrorCode::malformed);
  }
}

TEST(Nrrd, RefusesDataFilesOutsideTheFolder) {
  const TempFolder folder;
  const auto secret = folder.add("secret", std::string(60, '\0'));
  for (const std::string& name :
       {std::string("/etc/passwd"), std::string("../secret"), secret.string(), std::string("a/../secret"),
        std::string("..\\secret"), std::string(".."), std::string("."), std::string("absent")}) {
    const auto header = folder.add("doe.nhdr", kStart + kBytes + "data file: " + name + "\n");
    expect_refused({header, secret}, ErrorCode::malformed);
  }
  // There, but not sent.
  const auto header = folder.add("doe.nhdr", kStart + kBytes + "data file: secret\n");
  expect_refused({header}, ErrorCode::malformed);
  EXPECT_NO_THROW(read_volume({header, secret}));
}

TEST(Nrrd, ChoosesAFrameOfFour) {
  const std::string basic = "type: uchar\ndimension: 4\nsizes: 3 4 5 2\nencoding: raw\n";
  const std::string samples_of_two = "\n" + std::string(60, '\1') + std::string(60, '\2');
  for (const std::string fields :
       {"", "kinds: domain domain domain list\n", "kinds: space space space time\nspacings: 1 1 1 nan\n",
        "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1) none\nspace origin: (0,0,0)\n"}) {
    const std::string bytes = kStart + basic + fields + samples_of_two;
    EXPECT_EQ(samples<std::uint8_t>(read(bytes, {.frame = 1})), std::vector<std::uint8_t>(60, 2)) << fields;
    refuse(bytes, ErrorCode::unusable);
    refuse(bytes, ErrorCode::invalid_argument, {.frame = 2});
  }
  refuse(kStart + basic + "kinds: list domain domain domain\n" + samples_of_two, ErrorCode::unusable, {.frame = 0});
  refuse(kStart + basic + "space: LPS\nspace directions: none (1,0,0) (0,1,0) (0,0,1)\n" + samples_of_two,
         ErrorCode::unusable, {.frame = 0});
}

TEST(Nrrd, RefusesColoursAndVectors) {
  const std::string colour = "type: uchar\ndimension: 3\nsizes: 3 4 5\nencoding: raw\n";
  refuse(with("kinds: RGB-color domain domain\n", colour), ErrorCode::unusable);
  refuse(with("kinds: vector domain domain\n", colour), ErrorCode::unusable);
  refuse(with("", "type: uchar\ndimension: 4\nsizes: 3 4 5 1\nencoding: raw\nkinds: 3-color domain domain domain\n"),
         ErrorCode::unusable);
  refuse(with("", "type: uchar\ndimension: 5\nsizes: 3 4 5 1 2\nencoding: raw\n"), ErrorCode::unusable);
  // Nothing but the sizes says what a picture is.
  refuse(kStart + "type: uchar\ndimension: 3\nsizes: 3 20 1\nencoding: raw\n\n" + std::string(60, '\0'),
         ErrorCode::unusable);
  EXPECT_NO_THROW(read(with("spacings: 1 1 1\n", colour)));
  EXPECT_NO_THROW(read(with("kinds: domain domain domain\n", colour)));
}

TEST(Nrrd, ReadsFlatPicturesAsOneSlice) {
  const std::string flat = "type: uchar\ndimension: 2\nsizes: 6 10\nencoding: raw\n";
  Volume volume = read(with("spacings: 2 3\n", flat));
  EXPECT_EQ(volume.grid.dims, (std::array{6, 10, 1}));
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 1}));
  volume = read(with("space: RAS\nspace directions: (0,2,0) (0,0,3)\nspace origin: (1,2,3)\n", flat));
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 1}));
  expect_near(volume.grid.origin, {-1, -2, 3}, 0);
  expect_step(volume, 0, {0, -2, 0});
  volume = read(with("space dimension: 2\nspace directions: (2,0) (0,3)\nspace origin: (1,2)\n", flat));
  expect_near(volume.grid.origin, {1, 2, 0}, 0);
  refuse(with("space: RAS\nspace directions: (0,2,0) (0,2,0)\n", flat), ErrorCode::unusable);
}

TEST(Nrrd, RefusesImpossibleGeometry) {
  for (const char* fields :
       {"spacings: 0 1 1\n", "spacings: 1 -1 1\n", "spacings: nan 1 1\n", "spacings: 1 1 inf\n",
        "spacings: 1 1 1e999\n", "space: LPS\nspace directions: (1,0.1,0) (0,1,0) (0,0,1)\n",
        "space: LPS\nspace directions: (1,0,0) (1,0,0) (0,0,1)\n",
        "space: LPS\nspace directions: (1,0,0) (0,0,0) (0,0,1)\n",
        "space: LPS\nspace directions: (nan,0,0) (0,1,0) (0,0,1)\n",
        "space: LPS\nspace directions: (1,0,0) (0,1,0) (0,0,1)\nspace origin: (nan,0,0)\n",
        "space: LPS\nspace directions: (1,0,0,0) (0,1,0,0) (0,0,1,0)\n", "axis mins: 0 0 0\naxis maxs: 1 1 1\n"}) {
    refuse(with(fields), ErrorCode::unusable);
  }
  for (const char* fields :
       {"spacings: 1 1\n", "spacings: 1 1 1 1\n", "spacings: 1 1 x\n", "spacings: 1 1 1mm\n",
        "space directions: (1,0,0) (0,1,0)\n", "space directions: 1,0,0 0,1,0 0,0,1\n",
        "space directions: (1,0,0 (0,1,0) (0,0,1)\n", "space directions: (1,0,0) (0,1,0) (0,0,1)\nspacings: 1 1 1\n"}) {
    refuse(with(fields), ErrorCode::malformed);
  }
}

TEST(Nrrd, RefusesImpossibleSizes) {
  const auto sized = [](const std::string& sizes) {
    return with("spacings: 1 1 1\n", "type: uchar\ndimension: 3\nsizes: " + sizes + "\nencoding: raw\n");
  };
  for (const char* sizes : {"0 4 5", "3 -4 5"}) refuse(sized(sizes), ErrorCode::unusable);
  for (const char* sizes : {"3 4", "3 4 5 6", "3 4 five", "3.5 4 5", "99999999999999999999 1 1", ""}) {
    refuse(sized(sizes), ErrorCode::malformed);
  }
  refuse(sized("2000000 2000000 2000000"), ErrorCode::too_large);
  refuse(sized("9223372036854775807 9223372036854775807 9223372036854775807"), ErrorCode::too_large);
  refuse(sized("4294967299 1 1"), ErrorCode::too_large);
  refuse(sized("1000 1000 1000"), ErrorCode::malformed);
  refuse(sized("3 4 5"), ErrorCode::too_large, {.limits = {.max_voxels = 59}});
  for (const char* dimension : {"0", "-1", "17", "2147483648", "x"}) {
    refuse(with("", "type: uchar\ndimension: " + std::string(dimension) + "\nsizes: 3 4 5\nencoding: raw\n"),
           ErrorCode::malformed);
  }
}

TEST(Nrrd, RefusesCutAndContradictoryHeaders) {
  const std::string whole = with("spacings: 1 1 1\n");
  for (const std::size_t size : {9, 20, 60, 70, 80}) refuse(whole.substr(0, size), ErrorCode::malformed);
  refuse(whole.substr(0, whole.size() - 1), ErrorCode::malformed);
  refuse(with("type: short\n"), ErrorCode::malformed);
  refuse(with("nonsense\n"), ErrorCode::malformed);
  refuse(with("", "dimension: 3\nsizes: 5 4 3\nencoding: raw\n"), ErrorCode::malformed);
  refuse(with("", "type: uchar\ndimension: 3\nsizes: 5 4 3\n"), ErrorCode::malformed);
  refuse(with("", "type: short\ndimension: 3\nsizes: 5 4 3\nencoding: raw\n", 120), ErrorCode::malformed);  // no endian
  for (const char* encoding : {"bzip2", "hex", "ascii"}) {
    refuse(with("", "type: uchar\ndimension: 3\nsizes: 5 4 3\nencoding: " + std::string(encoding) + "\n"),
           ErrorCode::unusable);
  }
  const std::string packed = kStart + "type: uchar\ndimension: 3\nsizes: 5 4 3\nencoding: gzip\n\n";
  const std::string data = gzip(std::string(60, '\3'));
  EXPECT_NO_THROW(read(packed + data));
  refuse(packed + data.substr(0, data.size() - 3), ErrorCode::malformed);
  refuse(packed + "not gzip at all, just some text", ErrorCode::malformed);
  refuse(packed + gzip(std::string(59, '\3')), ErrorCode::malformed);
  // A header without an end.
  refuse(kStart + kBytes + "key:=" + std::string(std::size_t{1} << 20, 'x'), ErrorCode::too_large,
         {.limits = {.max_header_bytes = std::size_t{1} << 16}});
}

TEST(Nrrd, SaysSoWhenWrappedInGzip) { refuse(gzip(with("")), ErrorCode::unknown_format); }

}  // namespace
}  // namespace spherule::test
