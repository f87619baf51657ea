// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/read/files.h"

namespace spherule::test {
namespace {

Volume read(const std::string& bytes, const ReadOptions& options = {}) {
  const TempFolder folder;
  return read_volume({folder.add("doe.mha", bytes)}, options);
}

void refuse(const std::string& bytes, ErrorCode code, const ReadOptions& options = {}) {
  const TempFolder folder;
  expect_refused_cheaply({folder.add("doe.mha", bytes)}, code, options);
}

// A header of 3 × 4 × 5 bytes with extra fields, and 60 zero bytes.
std::string with(const std::string& fields, const std::string& basic = "NDims = 3\nDimSize = 3 4 5\n",
                 const std::string& type = "MET_UCHAR") {
  return "ObjectType = Image\n" + basic + fields + "ElementType = " + type + "\nElementDataFile = LOCAL\n" +
         std::string(60, '\0');
}

template <typename T>
std::string met_type() {
  const std::string sign = std::is_unsigned_v<T> ? "U" : "";
  if constexpr (std::is_same_v<T, float>) return "MET_FLOAT";
  if constexpr (std::is_same_v<T, double>) return "MET_DOUBLE";
  if constexpr (sizeof(T) == 1) return "MET_" + sign + "CHAR";
  if constexpr (sizeof(T) == 2) return "MET_" + sign + "SHORT";
  if constexpr (sizeof(T) == 4) return "MET_" + sign + "INT";
  return "MET_" + sign + "LONG_LONG";
}

TEST(MetaImage, ReadsEveryTypeInEitherOrderPackingAndPlace) {
  for (const bool big_endian : {false, true}) {
    for_each_type([&]<typename T>(T) {
      const auto values = telling_values<T>(60);
      const std::string bytes = bytes_of(values, big_endian);
      const std::string fields = "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = " +
                                 std::string(big_endian ? "True" : "False") +
                                 "\nDimSize = 3 4 5\nElementSpacing = 1 2 3\nElementType = " + met_type<T>() + "\n";
      const std::string packed = "CompressedData = True\nCompressedDataSize = 99\n";
      const TempFolder folder;
      const std::vector<Paths> ways = {
          {folder.add("a.mha", fields + "ElementDataFile = LOCAL\n" + bytes)},
          {folder.add("b.mha", fields + packed + "ElementDataFile = LOCAL\n" + zlib_stream(bytes))},
          {folder.add("c.mhd", fields + "ElementDataFile = doe.raw\n"), folder.add("doe.raw", bytes)},
          {folder.add("doe.zraw", zlib_stream(bytes)),
           folder.add("d.mhd", packed + fields + "ElementDataFile = doe.zraw")},
      };
      for (const Paths& files : ways) {
        const Volume volume = read_volume(files);
        EXPECT_EQ(volume.grid.dims, (std::array{3, 4, 5}));
        EXPECT_EQ(samples<T>(volume), values);
        EXPECT_EQ(volume.grid.spacing, (Vec3{1, 2, 3}));
        EXPECT_EQ(volume.format, "metaimage");
        EXPECT_TRUE(volume.warnings.empty());
      }
    });
  }
}

TEST(MetaImage, ReadsSamplesThatAreText) {
  for_each_type([&]<typename T>(T) {
    const auto values = telling_values<T>(60);
    const std::string text = text_of(values);
    // The order of bytes does not matter for digits.
    const std::string fields = "NDims = 3\nBinaryData = False\nBinaryDataByteOrderMSB = True\nDimSize = 3 4 5\n" +
                               std::string("ElementType = ") + met_type<T>() + "\n";
    const TempFolder folder;
    for (const Paths& files : {Paths{folder.add("a.mha", fields + "ElementDataFile = LOCAL\n" + text)},
                               Paths{folder.add("b.mhd", fields + "HeaderSize = 5\nElementDataFile = doe.txt\n"),
                                     folder.add("doe.txt", "head\n" + text)}}) {
      const Volume volume = read_volume(files);
      EXPECT_EQ(samples<T>(volume), values);
      EXPECT_TRUE(volume.warnings.empty());
    }
  });
  const auto head = [](const std::string& sizes) {
    return "NDims = 3\nBinaryData = False\nDimSize = " + sizes + "\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n";
  };
  const std::string most = text_of(std::vector<std::uint8_t>(59, 7));
  EXPECT_TRUE(read(head("3 4 5") + most + "7").warnings.empty());
  EXPECT_TRUE(warns(read(head("3 4 5") + most + "7 7\n"), "go on after the last sample"));
  for (const char* last : {"", "x", "-1", "256", "7.5", "1e1", "nan", "7x", "\xff", "7 y"})
    refuse(head("3 4 5") + most + last, ErrorCode::malformed);
  refuse(head("3 4 5") + most + std::string(1000, '7'), ErrorCode::malformed);
  refuse(head("3 4 5") + std::string(60, '\0'), ErrorCode::malformed);
  // Sizes that so little text cannot hold are refused before memory is taken.
  refuse(head("1200 1200 1200") + most, ErrorCode::malformed);
  refuse(head("3 4 5").insert(0, "HeaderSize = -1\n") + most + "7", ErrorCode::malformed);
  // Packed samples are binary.
  EXPECT_NO_THROW(read(head("3 4 5").insert(0, "CompressedData = True\n") + zlib_stream(std::string(60, '\7'))));
}

TEST(MetaImage, KnowsTheOtherNamesOfFieldsAndTypes) {
  const std::string bytes =
      "NDims=3\r\n\r\nDimSize = 3 4 5\r\nElementSize = 1 2 3\r\nPosition = 4 5 6\r\n"
      "Rotation = 0 1 0 -1 0 0 0 0 1\r\nElementByteOrderMSB = True\r\nElementType = MET_USHORT\r\n"
      "ElementDataFile = LOCAL\r\n" +
      bytes_of(std::vector<std::uint16_t>(60, 258), true);
  const Volume volume = read(bytes);
  EXPECT_EQ(samples<std::uint16_t>(volume), std::vector<std::uint16_t>(60, 258));
  EXPECT_EQ(volume.grid.spacing, (Vec3{1, 2, 3}));
  EXPECT_EQ(volume.grid.origin, (Vec3{4, 5, 6}));
  // MET_LONG is of 32 bits.
  EXPECT_EQ(read(with("", "NDims = 3\nDimSize = 3 5 1\n", "MET_LONG")).type, VoxelType::int32);
  EXPECT_EQ(read(with("", "NDims = 3\nDimSize = 3 5 1\n", "MET_ULONG")).type, VoxelType::uint32);
}

TEST(MetaImage, TakesRowsOfTheMatrixAsAxes) {
  // Axis i runs to y, j against x: rows are the axes' directions.
  const Volume volume = read(with("TransformMatrix = 0 1 0 -1 0 0 0 0 1\nOffset = 4 5 6\nElementSpacing = 2 3 4\n"));
  expect_step(volume, 0, {0, 2, 0});
  expect_step(volume, 1, {-3, 0, 0});
  expect_step(volume, 2, {0, 0, 4});
  expect_near(volume.grid.origin, {4, 5, 6}, 0);
}

TEST(MetaImage, ConvertsUnitsToMillimetres) {
  for (const auto& [unit, factor] : {std::pair{"um", 0.001}, {"cm", 10.0}, {"mm", 1.0}, {"?", 1.0}}) {
    const Volume volume =
        read(with("DistanceUnits = " + std::string(unit) + "\nElementSpacing = 1 2 3\nOffset = 4 5 6\n"));
    expect_near(volume.grid.spacing, factor * Vec3{1, 2, 3}, 1e-15);
    expect_near(volume.grid.origin, factor * Vec3{4, 5, 6}, 1e-15);
  }
}

TEST(MetaImage, FieldsThatDoNotMatterMayRepeatAndComeFirst) {
  const std::string own = "NDims = 3\nDimSize = 3 4 5\nElementSpacing = 1 2 3\n";
  EXPECT_TRUE(read(with("Comment = b\n", own)).warnings.empty());
  for (const std::string& bytes :
       {with("Comment = a\nComment = b\n", own), "0008|0060 = CT\n0010|0010 = X\n" + with("", own),
        "Name = x\n" + std::string(10'000, '#').replace(0, 4, "a = ") + "\n" + with("", own)}) {
    if (bytes.find("####") != std::string::npos) {
      EXPECT_EQ(read(bytes).grid.spacing, (Vec3{1, 2, 3}));
      continue;
    }
    const Volume volume = read(bytes);
    EXPECT_EQ(volume.grid.spacing, (Vec3{1, 2, 3}));
    EXPECT_TRUE(warns(volume, "do not matter for the volume"));
  }
  refuse(with("ElementSpacing = 1 2 4\n", own), ErrorCode::malformed);
}

TEST(MetaImage, FindsDataByTheLastPartOfItsNameOrByItsSize) {
  const std::string fields = "NDims = 3\nDimSize = 3 4 5\nElementType = MET_UCHAR\nElementDataFile = ";
  const TempFolder folder;
  const auto raw = folder.add("head.raw", std::string(60, '\7')), cut = folder.add("cut.raw", std::string(59, '\7'));
  for (const char* name : {"data/head.raw", "./head.raw", "C:\\scans\\head.raw"}) {
    const Volume volume = read_volume({folder.add("doe.mhd", fields + name + "\n"), raw});
    EXPECT_EQ(samples<std::uint8_t>(volume), std::vector<std::uint8_t>(60, 7));
    EXPECT_TRUE(volume.warnings.empty());
  }
  const auto header = folder.add("doe.mhd", fields + "volume.raw\n");
  EXPECT_TRUE(warns(read_volume({header, raw}), "names its data file otherwise"));
  expect_refused({header, cut}, ErrorCode::malformed);
  expect_refused({header, raw, cut}, ErrorCode::malformed);
  try {
    read_volume({header, cut});
  } catch (const Error& error) {
    EXPECT_NE(std::string(error.what()).find("(volume.raw)"), std::string::npos) << error.what();
  }
}

TEST(MetaImage, HostileHeadersTakeNoMultipleOfTheirSize) {
  std::string keys, list, sizes = "DimSize =";
  for (int n = 0; n < 2'000'000; ++n) keys += "k" + std::to_string(n) + "=\n", list += "a\n", sizes += " 1";
  refuse("NDims = 3\n" + keys, ErrorCode::malformed);
  refuse("NDims = 3\nDimSize = 3 4 5\nElementType = MET_UCHAR\nElementDataFile = LIST\n" + list, ErrorCode::malformed);
  refuse("NDims = 3\n" + sizes + "\n", ErrorCode::malformed);
}

TEST(MetaImage, ReadsListsPatternsAndOffsets) {
  const TempFolder folder;
  Paths slices;
  std::vector<std::uint8_t> expected;
  for (int k = 0; k < 5; ++k) {
    slices.push_back(folder.add("doe." + std::to_string(k), "head" + std::string(12, static_cast<char>(k))));
    expected.insert(expected.end(), 12, static_cast<std::uint8_t>(k));
  }
  const std::string fields = "NDims = 3\nDimSize = 3 4 5\nElementType = MET_UCHAR\n";
  for (const char* data : {"HeaderSize = 4\nElementDataFile = doe.%d 0 4 1\n",
                           "HeaderSize = -1\nElementDataFile = LIST\ndoe.0\ndoe.1\ndoe.2\n\ndoe.3\ndoe.4\n",
                           "HeaderSize = 4\nElementDataFile = LIST 2\ndoe.0\ndoe.1\ndoe.2\ndoe.3\ndoe.4"}) {
    Paths all = slices;
    all.push_back(folder.add("doe.mhd", fields + data));
    EXPECT_EQ(samples<std::uint8_t>(read_volume(all)), expected);
  }
  for (const char* data :
       {"ElementDataFile = doe.%d 0 5 1\n", "ElementDataFile = LIST\n", "ElementDataFile = LIST\ndoe.0\n",
        "HeaderSize = 5\nElementDataFile = doe.%d 0 4 1\n", "HeaderSize = -2\nElementDataFile = doe.%d 0 4 1\n",
        "HeaderSize = 99999999999999\nElementDataFile = doe.%d 0 4 1\n", "ElementDataFile = doe.%s 0 4 1\n",
        "ElementDataFile = \n", "ElementDataFile = /etc/passwd\n", "ElementDataFile = ../doe.0\n",
        "ElementDataFile = absent\n", "CompressedData = True\nHeaderSize = -1\nElementDataFile = doe.0\n"}) {
    Paths all = slices;
    all.push_back(folder.add("bad.mhd", fields + data));
    expect_refused_cheaply(all, ErrorCode::malformed);
  }
}

TEST(MetaImage, ChoosesAFrameOfFour) {
  std::string bytes =
      "NDims = 4\nDimSize = 3 4 5 2\nElementSpacing = 1 2 3 4\nOffset = 7 8 9 0\n"
      "TransformMatrix = 1 0 0 0 0 0 1 0 0 -1 0 0 0 0 0 1\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n" +
      std::string(60, '\1') + std::string(60, '\2');
  const Volume volume = read(bytes, {.frame = 1});
  EXPECT_EQ(samples<std::uint8_t>(volume), std::vector<std::uint8_t>(60, 2));
  expect_step(volume, 1, {0, 0, 2});
  expect_step(volume, 2, {0, -3, 0});
  expect_near(volume.grid.origin, {7, 8, 9}, 0);
  refuse(bytes, ErrorCode::unusable);
  refuse(bytes, ErrorCode::invalid_argument, {.frame = 2});
}

TEST(MetaImage, ReadsFlatPicturesAsOneSlice) {
  const Volume volume =
      read(with("ElementSpacing = 2 3\nOffset = 4 5\nTransformMatrix = 0 1 -1 0\n", "NDims = 2\nDimSize = 6 10\n"));
  EXPECT_EQ(volume.grid.dims, (std::array{6, 10, 1}));
  EXPECT_EQ(volume.grid.spacing, (Vec3{2, 3, 1}));
  expect_step(volume, 0, {0, 2, 0});
}

TEST(MetaImage, RefusesWhatIsNotOneScalarAVoxel) {
  refuse(with("ElementNumberOfChannels = 3\n"), ErrorCode::unusable);
  refuse(with("", "NDims = 5\nDimSize = 3 4 5 1 1\n"), ErrorCode::unusable);
  for (const char* type : {"MET_CHAR_ARRAY", "MET_STRING", "MET_NONE", "MET_OTHER", "MET_FLOAT_MATRIX", "MET_QUUX"}) {
    const TempFolder folder;
    expect_refused_cheaply({folder.add("doe.mha", with("", "NDims = 3\nDimSize = 3 4 5\n", type))},
                           ErrorCode::unusable);
  }
  refuse(with("", "NDims = 3\nDimSize = 3 4 5\n", "%s%n"), ErrorCode::malformed);
  refuse("ObjectType = Tube\nNDims = 3\nElementDataFile = LOCAL\n", ErrorCode::unusable);
}

TEST(MetaImage, RefusesImpossibleGeometry) {
  for (const char* fields :
       {"ElementSpacing = 0 1 1\n", "ElementSpacing = 1 -1 1\n", "ElementSpacing = nan 1 1\n",
        "ElementSpacing = 1 1 inf\n", "Offset = nan 0 0\n", "TransformMatrix = 1 0.1 0 0 1 0 0 0 1\n",
        "TransformMatrix = 1 0 0 1 0 0 0 0 1\n", "TransformMatrix = 0 0 0 0 0 0 0 0 0\n"}) {
    refuse(with(fields), ErrorCode::unusable);
  }
  for (const char* fields : {"ElementSpacing = 1 1\n", "ElementSpacing = 1 1 1 1\n", "ElementSpacing = 1 1 x\n",
                             "TransformMatrix = 1 0 0 0 1 0 0 0\n", "Offset = \n"}) {
    refuse(with(fields), ErrorCode::malformed);
  }
}

TEST(MetaImage, RefusesImpossibleSizes) {
  const auto sized = [](const std::string& sizes) { return with("", "NDims = 3\nDimSize = " + sizes + "\n"); };
  for (const char* sizes : {"0 4 5", "3 -4 5"}) refuse(sized(sizes), ErrorCode::unusable);
  for (const char* sizes : {"3 4", "3 4 5 6", "3 4 five", "3.5 4 5", "99999999999999999999 1 1", ""}) {
    refuse(sized(sizes), ErrorCode::malformed);
  }
  refuse(sized("2000000 2000000 2000000"), ErrorCode::too_large);
  refuse(sized("4294967299 1 1"), ErrorCode::too_large);
  refuse(sized("1000 1000 1000"), ErrorCode::malformed);
  refuse(sized("3 4 5"), ErrorCode::too_large, {.limits = {.max_bytes = 59}});
  for (const char* n : {"0", "1", "-3", "9"}) {
    refuse(with("", "NDims = " + std::string(n) + "\nDimSize = 3 4 5\n"), ErrorCode::unusable);
  }
}

TEST(MetaImage, RefusesCutAndContradictoryHeaders) {
  const std::string whole = with("");
  for (const std::size_t size : {19, 30, 40, 60, 80}) refuse(whole.substr(0, size), ErrorCode::malformed);
  refuse(whole.substr(0, whole.size() - 1), ErrorCode::malformed);
  refuse(with("NDims = 3\n"), ErrorCode::malformed);
  refuse(with("no field\n"), ErrorCode::malformed);
  refuse(with(std::string(100, 'k') + " = 1\n"), ErrorCode::malformed);
  const std::string packed =
      "NDims = 3\nDimSize = 3 4 5\nCompressedData = True\nElementType = MET_UCHAR\nElementDataFile = LOCAL\n";
  const std::string data = zlib_stream(std::string(60, '\3'));
  EXPECT_NO_THROW(read(packed + data));
  refuse(packed + data.substr(0, data.size() - 2), ErrorCode::malformed);
  refuse(packed + std::string(100, 'x'), ErrorCode::malformed);
  std::string damaged = data;
  damaged.back() ^= 1;
  refuse(packed + damaged, ErrorCode::malformed);
  refuse("NDims = 3\nComment = " + std::string(std::size_t{1} << 20, 'x') + "\n", ErrorCode::too_large,
         {.limits = {.max_header_bytes = std::size_t{1} << 16}});
}

}  // namespace
}  // namespace spherule::test
