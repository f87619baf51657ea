// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/read/files.h"

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

TEST(Nrrd, ReadsDataOnlyFromFilesThatWereSent) {
  const TempFolder folder;
  folder.add("unsent", std::string(60, '\1'));
  const auto sent = folder.add("given", std::string(61, '\7'));
  const auto header_of = [&](const std::string& name) {
    return folder.add("doe.nhdr", kStart + kBytes + "data file: " + name + "\n");
  };
  for (const std::string& name : {std::string("/etc/passwd"), std::string("unsent"), std::string("../unsent"),
                                  (folder.path() / "unsent").string(), std::string(".."), std::string("."),
                                  std::string("a/.."), std::string("absent")}) {
    expect_refused({header_of(name), sent}, ErrorCode::malformed);
  }
  // The last part of a name is what counts: files come without their folders.
  for (const std::string& name :
       {std::string("given"), std::string("./given"), std::string("../given"), std::string("data/given"),
        std::string("..\\given"), std::string("/elsewhere/given")}) {
    EXPECT_EQ(samples<std::uint8_t>(read_volume({header_of(name), sent})), std::vector<std::uint8_t>(60, 7)) << name;
  }
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
}

// Whatever axis holds the volumes: every sample is its own number, told by where it stands in the array.
TEST(Nrrd, FindsTheAxesOfSpaceAmongOthers) {
  std::string bytes;
  for (int n = 0; n < 120; ++n) bytes += static_cast<char>(n);
  struct Case {
    std::string fields;
    std::array<std::int32_t, 3> dims;
    int frames, first, step_x, step_y;  // of frame 1: the first sample, and to the next along x and y
  };
  const std::string three = "(1,0,0) (0,2,0) (0,0,3)", lps = "space: LPS\nspace directions: ";
  for (const Case& c : std::vector<Case>{
           {"dimension: 4\nsizes: 2 3 4 5\nkinds: list domain domain domain\n", {3, 4, 5}, 2, 1, 2, 6},
           {"dimension: 4\nsizes: 2 3 4 5\n" + lps + "none " + three + "\n", {3, 4, 5}, 2, 1, 2, 6},
           {"dimension: 4\nsizes: 3 2 4 5\nkinds: domain time domain domain\n", {3, 4, 5}, 2, 3, 1, 6},
           {"dimension: 4\nsizes: 3 4 2 5\nkinds: space space list space\n", {3, 4, 5}, 2, 12, 1, 3},
           {"dimension: 4\nsizes: 3 4 5 2\nkinds: domain domain domain domain\n", {3, 4, 5}, 2, 60, 1, 3},
           {"dimension: 5\nsizes: 1 3 4 5 2\nkinds: vector domain domain domain list\n", {3, 4, 5}, 2, 60, 1, 3},
           {"dimension: 5\nsizes: 1 3 4 5 2\n", {3, 4, 5}, 2, 60, 1, 3},
           {"dimension: 5\nsizes: 3 4 5 2 1\n", {3, 4, 5}, 2, 60, 1, 3},
           {"dimension: 4\nsizes: 4 5 3 2\nspacings: 1 1 nan nan\n", {4, 5, 1}, 0, 0, 0, 0},
           {"dimension: 4\nsizes: 3 4 5 2\nspace dimension: 4\nspace directions: (1,0,0,0) (0,2,0,0) (0,0,3,0) "
            "(0,0,0,1.5)\nspace origin: (7,8,9,0)\n",
            {3, 4, 5},
            2,
            60,
            1,
            3},
           {"dimension: 4\nsizes: 2 3 4 5\nspace: LPST\nspace directions: (0,0,0,1) (1,0,0,0) (0,2,0,0) (0,0,3,0)\n",
            {3, 4, 5},
            2,
            1,
            2,
            6},
           {"dimension: 3\nsizes: 5 4 6\nspace: left-posterior-superior-time\nspace directions: (1,0,0,0) (0,2,0,0) "
            "(0,0,0,2)\n",
            {5, 4, 1},
            6,
            20,
            1,
            5}}) {
    SCOPED_TRACE(c.fields);
    const std::string file = kStart + "type: uchar\nencoding: raw\n" + c.fields + "\n" + bytes;
    if (c.frames == 0) {
      refuse(file, ErrorCode::unusable, {.frame = 1});
      continue;
    }
    refuse(file, ErrorCode::unusable);
    refuse(file, ErrorCode::invalid_argument, {.frame = c.frames});
    const Volume volume = read(file, {.frame = 1});
    EXPECT_EQ(volume.grid.dims, c.dims);
    EXPECT_EQ(value_at(volume, 0, 0, 0), c.first);
    EXPECT_EQ(value_at(volume, 1, 0, 0), c.first + c.step_x);
    EXPECT_EQ(value_at(volume, 0, 1, 0), c.first + c.step_y);
    if (c.fields.find("directions") != std::string::npos) {
      EXPECT_EQ(volume.grid.spacing.x, 1);
      EXPECT_EQ(volume.grid.spacing.y, 2);
    }
    if (c.fields.find("origin") != std::string::npos) {
      expect_near(volume.grid.origin, {7, 8, 9}, 0);
    }
  }
  refuse(kStart +
             "type: uchar\nencoding: raw\ndimension: 4\nsizes: 3 4 5 2\nspace dimension: 4\nspace directions: "
             "(1,0,0,0) (0,2,0,0) (0,0,3,1) (0,0,0,1)\n\n" +
             bytes,
         ErrorCode::unusable, {.frame = 0});
  // One volume with axes of one sample around it needs no frame.
  for (const char* sizes :
       {"dimension: 4\nsizes: 1 4 5 6\n", "dimension: 4\nsizes: 4 5 6 1\n", "dimension: 5\nsizes: 1 4 5 6 1\n"})
    EXPECT_EQ(read(kStart + "type: uchar\nencoding: raw\n" + sizes + "\n" + bytes).grid.dims, (std::array{4, 5, 6}));
}

TEST(Nrrd, InterleavesWideSamplesOfManyFramesAndFiles) {
  std::vector<std::int16_t> all;
  for (int n = 0; n < 7 * 60; ++n) all.push_back(static_cast<std::int16_t>(n));
  const std::string head =
      kStart + "type: short\nendian: big\ndimension: 4\nsizes: 7 3 4 5\nkinds: list domain domain domain\n";
  const std::string bytes = bytes_of(all, true);
  const TempFolder folder;
  const auto header = folder.add("doe.nhdr", head + "encoding: raw\ndata file: LIST\na\nb\n");
  const auto a = folder.add("a", bytes.substr(0, 420)), b = folder.add("b", bytes.substr(420));
  const Volume packed = read(head + "encoding: gzip\n\n" + gzip(bytes), {.frame = 5});
  const Volume parts = read_volume({header, a, b}, {.frame = 5});
  for (std::size_t n = 0; n < 60; ++n) EXPECT_EQ(samples<std::int16_t>(packed)[n], 7 * static_cast<int>(n) + 5);
  EXPECT_EQ(packed.voxels, parts.voxels);
}

TEST(Nrrd, ConvertsUnitsToMillimetres) {
  const std::string directions =
      "space dimension: 3\nspace directions: (2,0,0) (0,3,0) (0,0,4)\nspace origin: (5,6,7)\n";
  for (const auto& [unit, mm] : {std::pair{"microns", 1e-3},
                                 {"um", 1e-3},
                                 {"\u00b5m", 1e-3},
                                 {"MM", 1.0},
                                 {"", 1.0},
                                 {"cm", 10.0},
                                 {"meters", 1000.0},
                                 {"nm", 1e-6},
                                 {"inches", 25.4}}) {
    const std::string word = '"' + std::string(unit) + "\" ";
    Volume volume = read(with(directions + "space units: " + word + word + word + "\n"));
    expect_near(volume.grid.spacing, mm * Vec3{2, 3, 4}, 1e-12 * mm);
    expect_near(volume.grid.origin, mm * Vec3{5, 6, 7}, 1e-12 * mm);
    EXPECT_FALSE(warns(volume, "unit of length")) << unit;
    volume = read(
        with("spacings: 2 3 4\naxis mins: 5 6 7\ncenterings: node node node\nunits: " + word + word + word + "\n"));
    expect_near(volume.grid.spacing, mm * Vec3{2, 3, 4}, 1e-12 * mm);
    expect_near(volume.grid.origin, mm * Vec3{5, 6, 7}, 1e-12 * mm);
  }
  // Each of its own, on the axis that it is of; turned ones by the world's axis.
  Volume volume = read(with("spacings: 2 3 4\nunits: \"mm\" \"cm\" \"um\"\n"));
  expect_near(volume.grid.spacing, {2, 30, 0.004}, 1e-12);
  volume = read(with("space dimension: 3\nspace directions: (0,2,0) (3,0,0) (0,0,4)\nspace units: mm cm mm\n"));
  expect_near(volume.grid.spacing, {20, 3, 4}, 1e-12);
  volume = read(with("spacings: 2 3 4\nunits: \"cubit\" \"cubit\" \"cubit\"\n"));
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 4}));
  EXPECT_TRUE(warns(volume, "unit of length is not known"));
  refuse(with(directions + "units: \"mm\" \"cm\" \"mm\"\n"), ErrorCode::unusable);
  refuse(with("spacings: 2 3 4\nunits: \"mm\"\n"), ErrorCode::malformed);
}

TEST(Nrrd, ReadsKeysWithColonsBesideFieldsOfTheSameName) {
  for (const char* keys : {"DICOM:SeriesDescription:=head\nDICOM:StudyDate:=20200101\n", "a: b:=c\n", "space:=doe\n",
                           "Segment0_ID:=a:b := c\n", "key:=\nkey:=\n", "spacings:=x\n", "an unknown: field\n"}) {
    EXPECT_EQ(read(with(keys + std::string("spacings: 1 2 3\n"))).grid.spacing, (Vec3{1, 2, 3})) << keys;
  }
}

TEST(Nrrd, ReadsEveryEncodingOfTheFormat) {
  for_each_type([&]<typename T>(T) {
    const std::vector<T> values = telling_values<T>(60);
    const std::string text = text_of(values);
    std::string type(name(type_of<T>())), hex;
    if (type == "float32") type = "float";
    if (type == "float64") type = "double";
    for (const char c : bytes_of(values, false)) {
      constexpr std::string_view kDigits = "0123456789abcdef";
      hex += kDigits[static_cast<unsigned char>(c) >> 4];
      hex += kDigits[static_cast<unsigned char>(c) & 15];
      if (hex.size() % 30 == 0) hex += '\n';
    }
    const std::string head = kStart + "type: " + type + "\ndimension: 3\nsizes: 3 4 5\nspacings: 1 1 1\n";
    for (const char* word : {"ascii", "text", "TXT"})
      EXPECT_EQ(samples<T>(read(head + "encoding: " + word + "\n\n" + text)), values) << type;
    EXPECT_EQ(samples<T>(read(head + "endian: little\nencoding: hex\n\n" + hex)), values) << type;
    const std::string packed = bzip2(bytes_of(values, true));
    EXPECT_EQ(samples<T>(read(head + "endian: big\nencoding: bzip2\n\n" + packed)), values) << type;
  });
  const std::string head = kStart + "type: uchar\ndimension: 3\nsizes: 3 4 5\nspacings: 1 1 1\nencoding: ";
  const std::string two = bzip2(std::string(20, '\7')) + bzip2(std::string(40, '\7'));
  EXPECT_EQ(samples<std::uint8_t>(read(head + "bz2\n\n" + two)), std::vector<std::uint8_t>(60, 7));
  for (std::size_t size = 0; size < two.size(); size += 3)
    refuse(head + "bz2\n\n" + two.substr(0, size), ErrorCode::malformed);
  std::string damaged = two;
  damaged[20] ^= 1;
  refuse(head + "bz2\n\n" + damaged, ErrorCode::malformed);
  std::string text;
  for (int n = 0; n < 60; ++n) text += "7 ";
  EXPECT_NO_THROW(read(head + "text\n\n" + text));
  for (const char* bad : {"x", "7.5", "256", "-1", "0x7", "1e1", "nan", "7 7 7"})
    refuse(head + "text\n\n" + text.substr(0, 118) + (std::string_view(bad) == "7 7 7" ? "" : bad),
           ErrorCode::malformed);
  EXPECT_TRUE(warns(read(head + "text\n\n" + text + " 7 7"), "go on after the last sample"));
  refuse(head + "hex\n\n" + std::string(119, '7'), ErrorCode::malformed);
  refuse(head + "hex\n\n" + std::string(118, '7') + "g7", ErrorCode::malformed);
  // Sizes that so few bytes cannot hold are refused before memory is taken.
  for (const char* encoding : {"text", "hex", "bzip2"}) {
    refuse(kStart + "type: uchar\ndimension: 3\nsizes: 1200 1200 1200\nspacings: 1 1 1\nencoding: " + encoding +
               "\n\n" + (std::string_view(encoding) == "bzip2" ? two : text),
           ErrorCode::malformed);
  }
}

TEST(Nrrd, TakesTheEndOfPackedDataWhereTheByteSkipSaysSo) {
  const std::string data = gzip(std::string(352, 'h') + std::string(60, '\7'));
  const TempFolder folder;
  const auto file = folder.add("doe.nii.gz", data);
  const auto header = [&](const std::string& sizes) {
    return folder.add("doe.nhdr", kStart + "type: uchar\ndimension: 3\nsizes: " + sizes +
                                      "\nspacings: 1 1 1\nencoding: gzip\nbyte skip: -1\ndata file: doe.nii.gz\n");
  };
  EXPECT_EQ(samples<std::uint8_t>(read_volume({header("3 4 5"), file})), std::vector<std::uint8_t>(60, 7));
  expect_refused_cheaply({header("3 4 50"), file}, ErrorCode::malformed);
  // Far more than any header before the samples is not unpacked to its end.
  const auto bomb = folder.add("doe.nii.gz", gzip(std::string(std::size_t{1} << 26, '\0')));
  expect_refused_cheaply({header("3 4 5"), bomb}, ErrorCode::malformed);
}

TEST(Nrrd, ADetachedHeaderComesBeforeWhatItsDataLookLike) {
  const std::string nifti = header({}) + std::string(60, '\7');
  const TempFolder folder;
  const auto data = folder.add("doe.nii", nifti);
  const auto head = folder.add("doe.nhdr", kStart + kBytes + "byte skip: -1\ndata file: doe.nii\n");
  EXPECT_EQ(read_volume({head, data}).format, "nrrd");
  EXPECT_EQ(read_volume({data, head}).format, "nrrd");
  EXPECT_EQ(read_volume({data}).format, "nifti");
  const auto other = folder.add("other.nhdr", kStart + kBytes + "byte skip: -1\ndata file: doe.nii\n");
  expect_refused({head, other, data}, ErrorCode::unusable);
}

TEST(Nrrd, TakesTheOnlyOtherFileWhenItHoldsJustTheSamples) {
  const TempFolder folder;
  const auto fitting = folder.add("renamed", std::string(60, '\7')),
             longer = folder.add("longer", std::string(61, '\7'));
  const auto head = folder.add("doe.nhdr", kStart + kBytes + "data file: C:\\scans\\head-1.raw\n");
  const Volume volume = read_volume({head, fitting});
  EXPECT_EQ(samples<std::uint8_t>(volume), std::vector<std::uint8_t>(60, 7));
  EXPECT_TRUE(warns(volume, "names its data file otherwise"));
  for (const Paths& files : {Paths{head, longer}, Paths{head, fitting, longer}, Paths{head}}) {
    expect_refused(files, ErrorCode::malformed);
    try {
      read_volume(files);
    } catch (const Error& error) {
      EXPECT_NE(std::string(error.what()).find("(head-1.raw)"), std::string::npos) << error.what();
    }
  }
  const auto packed = folder.add("renamed.gz", gzip(std::string(60, '\7')));
  const auto packed_head = folder.add("gz.nhdr", kStart +
                                                     "type: uchar\ndimension: 3\nsizes: 3 4 5\nspacings: 1 1 1\n"
                                                     "encoding: gzip\ndata file: a.gz\n");
  EXPECT_TRUE(warns(read_volume({packed_head, packed}), "names its data file otherwise"));
  expect_refused({packed_head, fitting}, ErrorCode::malformed);
}

TEST(Nrrd, HostileHeadersTakeNoMultipleOfTheirSize) {
  std::string keys, list, sizes = "sizes:";
  for (int n = 0; n < 2'000'000; ++n) keys += "k" + std::to_string(n) + ": \n", list += "a\n", sizes += " 1";
  refuse(kStart + keys, ErrorCode::malformed);
  refuse(kStart + kBytes + "data file: LIST\n" + list, ErrorCode::malformed);
  refuse(kStart + sizes + "\n\n", ErrorCode::malformed);
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
  for (const char* encoding : {"zrl", "quux", ""}) {
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
