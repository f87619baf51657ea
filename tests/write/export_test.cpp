// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/export.h"

#include <gtest/gtest.h>

#include <bit>
#include <cstring>
#include <limits>
#include <random>

#include "core/base/error.h"
#include "tests/errors.h"

namespace spherule {
namespace {

using test::expect_error;

std::vector<Sphere> random_spheres(std::size_t n) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> coordinate(-300, 300), radius(0, 40);
  std::vector<Sphere> spheres(n);
  for (Sphere& s : spheres) s = {{coordinate(random), coordinate(random), coordinate(random)}, radius(random)};
  return spheres;
}

Sphere as_float32(const Sphere& s) {
  return {{static_cast<float>(s.centre.x), static_cast<float>(s.centre.y), static_cast<float>(s.centre.z)},
          static_cast<float>(s.radius)};
}

void expect_csv_error(std::string_view csv, ErrorCode code, const std::string& words, const ImportLimits& limits = {}) {
  expect_error([&] { spheres_from_csv(csv, limits); }, code, words);
}

template <typename T>
std::string number_bytes(T value, bool big_endian) {
  std::string out(sizeof value, '\0');
  std::memcpy(out.data(), &value, sizeof value);
  if (big_endian) std::reverse(out.begin(), out.end());
  return out;
}

// An NPY file as other programs might write it.
std::string npy(const std::string& dictionary, const std::string& data, int version = 1) {
  std::string out = "\x93NUMPY";
  out += static_cast<char>(version);
  out += '\0';
  out += version == 1 ? number_bytes(static_cast<std::uint16_t>(dictionary.size()), false)
                      : number_bytes(static_cast<std::uint32_t>(dictionary.size()), false);
  return out + dictionary + data;
}

std::string dictionary(const std::string& descr, bool fortran, const std::string& shape) {
  return "{'descr': '" + descr + "', 'fortran_order': " + (fortran ? "True" : "False") + ", 'shape': " + shape +
         ", }\n";
}

template <typename T>
std::string array_bytes(const std::vector<Sphere>& spheres, bool fortran, bool big_endian) {
  std::string out;
  const auto column = [](const Sphere& s, int c) { return static_cast<T>(c < 3 ? s.centre[c] : s.radius); };
  if (fortran) {
    for (int c = 0; c < 4; ++c)
      for (const Sphere& s : spheres) out += number_bytes(column(s, c), big_endian);
  } else {
    for (const Sphere& s : spheres)
      for (int c = 0; c < 4; ++c) out += number_bytes(column(s, c), big_endian);
  }
  return out;
}

void expect_npy_error(const std::string& bytes, ErrorCode code, const std::string& words,
                      const ImportLimits& limits = {}) {
  expect_error([&] { spheres_from_npy(bytes, limits); }, code, words);
}

TEST(Csv, RoundTripIsExact) {
  auto spheres = random_spheres(1000);
  spheres.push_back({{-0.0, 1e-300, 5e-324}, 0});
  spheres.push_back({{1e9, -1e9, 1.0 / 3}, 1e9});
  EXPECT_EQ(spheres_from_csv(spheres_to_csv(spheres)), spheres);
}

TEST(Csv, SaysFrameAndUnits) {
  EXPECT_EQ(spheres_to_csv(std::vector<Sphere>{{{1, -2.5, 0.1}, 3}}),
            "# Spherule: centres and radii of spheres\n"
            "# frame: LPS (x to the patient's left, y to the posterior, z to the head)\n"
            "# units: mm\n"
            "x,y,z,r\n"
            "1,-2.5,0.1,3\n");
}

TEST(Csv, AnyColumnOrderExtraColumnsCommentsBlankLinesAndCrLf) {
  const std::vector<Sphere> expected{{{1, 2, 3}, 4}, {{-1, 0, 1e3}, 0}};
  EXPECT_EQ(spheres_from_csv("\xef\xbb\xbf# note\r\n\r\nname, r ,\"z\",y,x\r\na,4,3,2,1\r\n# more\r\n,0, 1e3,0,\t-1"),
            expected);
}

TEST(Csv, RefusesWhatIsNotASetOfSpheres) {
  const auto bad = ErrorCode::malformed;
  expect_csv_error("1,2,3,4\n", bad, "Line 1 of the CSV is not a header");
  expect_csv_error("# c\nx;y;z;r\n1;2;3;4\n", bad, "Line 2 of the CSV is not a header");
  expect_csv_error("x,y,r\n1,2,3\n", bad, "not a header");
  expect_csv_error("x,y,z,r,x\n1,2,3,4,5\n", bad, "names the column x twice");
  expect_csv_error("x,y,z,r\n1,2,3,4\n1,2,3\n", bad, "Line 3 of the CSV has fewer fields");
  expect_csv_error("x,y,z,r\n1,2,3,4,5\n", bad, "Line 2 of the CSV has more fields");
  for (const char* field : {"", "a", "1.2.3", "0x10", "1 2", "--1", "1e999", "\"4\"", "4\v"})
    expect_csv_error(std::string("x,y,z,r\n1,2,3,") + field + "\n", bad, "Line 2 of the CSV has a field");
  expect_csv_error(std::string("x,y,z,r\n1,2,3,4\0\n", 17), bad, "Line 2");
  expect_csv_error(std::string(5000, ',') + "x,y,z,r\n", bad, "more than 1000 columns");
  expect_csv_error("\x93NUMPY\x01", bad, "not a header");
}

TEST(Csv, RefusesSpheresThatCannotBeUsed) {
  const auto bad = ErrorCode::unusable;
  expect_csv_error("x,y,z,r\n1,2,3,4\nnan,0,0,1\n", bad, "Sphere 2 has a coordinate or radius that is not finite");
  expect_csv_error("x,y,z,r\n1,2,3,inf\n", bad, "Sphere 1 has a coordinate or radius that is not finite");
  expect_csv_error("x,y,z,r\n1,2,3,-1e-9\n", bad, "Sphere 1 has a negative radius");
  expect_csv_error("x,y,z,r\n1e10,2,3,1\n", bad, "beyond 1e9 mm");
  expect_csv_error("x,y,z,r\n1,2,3,0\n1,2,3,1e-170\n", bad, "Sphere 2 has a radius below 1e-18 mm");
  expect_csv_error("", bad, "has no spheres");
  expect_csv_error("# only\nx,y,z,r\n", bad, "has no spheres");
}

TEST(Csv, LimitIsExact) {
  const std::string csv = spheres_to_csv(random_spheres(10));
  EXPECT_EQ(spheres_from_csv(csv, {.max_spheres = 10}).size(), 10U);
  expect_csv_error(csv, ErrorCode::too_large, "more than 9 spheres", {.max_spheres = 9});
}

TEST(Npy, LayoutIsNumPys) {
  const std::string bytes = spheres_to_npy(std::vector<Sphere>{{{1, 2, 3}, 4}});
  ASSERT_EQ(bytes.size(), 128U + 32U);
  EXPECT_EQ(bytes.substr(0, 10), std::string("\x93NUMPY\x01\x00\x76\x00", 10));
  EXPECT_EQ(bytes.substr(10, 60), "{'descr': '<f8', 'fortran_order': False, 'shape': (1, 4), } ");
  EXPECT_EQ(bytes[127], '\n');
  EXPECT_EQ(bytes.substr(128), array_bytes<double>({{{1, 2, 3}, 4}}, false, false));
}

// As exact as CSV, however far from the origin the spheres lie.
TEST(Npy, RoundTripIsExact) {
  for (const std::size_t n : {1U, 9U, 1000U}) {
    auto spheres = random_spheres(n);
    EXPECT_EQ(spheres_from_npy(spheres_to_npy(spheres)), spheres);
    for (Sphere& s : spheres) s.centre = 1e-4 * s.centre + Vec3{5e6, -5e6, 5e6};
    EXPECT_EQ(spheres_from_npy(spheres_to_npy(spheres)), spheres);
    EXPECT_EQ(spheres_from_csv(spheres_to_csv(spheres)), spheres);
  }
}

TEST(Npy, ReadsEveryTypeByteOrderMemoryOrderAndVersion) {
  const auto spheres = random_spheres(5);
  for (const int version : {1, 2, 3})
    for (const bool fortran : {false, true})
      for (const bool big : {false, true}) {
        const std::string order = big ? ">" : "<";
        EXPECT_EQ(spheres_from_npy(npy(dictionary(order + "f8", fortran, "(5, 4)"),
                                       array_bytes<double>(spheres, fortran, big), version)),
                  spheres);
        const auto narrow = spheres_from_npy(
            npy(dictionary(order + "f4", fortran, "(5, 4)"), array_bytes<float>(spheres, fortran, big), version));
        ASSERT_EQ(narrow.size(), 5U);
        for (std::size_t i = 0; i < 5; ++i) EXPECT_EQ(narrow[i], as_float32(spheres[i]));
      }
}

TEST(Npy, RefusesCutAndPaddedFilesAtEveryLength) {
  const std::string good = spheres_to_npy(random_spheres(3));
  for (std::size_t n = 0; n < good.size(); ++n)
    expect_error([&] { spheres_from_npy(good.substr(0, n)); }, ErrorCode::malformed, "numpy.save");
  expect_npy_error(good + 'x', ErrorCode::malformed, "bytes after the array");
  expect_npy_error(good + std::string(16, '\0'), ErrorCode::malformed, "bytes after the array");
}

TEST(Npy, RefusesHeadersThatLie) {
  const auto bad = ErrorCode::malformed;
  const std::string row(16, '\0');
  // Shapes whose product overflows or asks for terabytes are answered without taking memory.
  expect_npy_error(npy(dictionary("<f4", false, "(9999999, 4)"), row), bad, "cut short");
  expect_npy_error(npy(dictionary("<f4", false, "(1152921504606846977, 4)"), row), bad, "cut short",
                   {.max_spheres = std::numeric_limits<std::size_t>::max()});
  expect_npy_error(npy(dictionary("<f4", false, "(1152921504606846977, 4)"), row), ErrorCode::too_large, "more than");
  expect_npy_error(npy(dictionary("<f4", false, "(99999999999999999999999, 4)"), row), bad, "shape");
  expect_npy_error(npy(dictionary("<f4", false, "(-1, 4)"), row), bad, "shape");
  expect_npy_error(npy("{'descr': '<f4', 'fortran_order': False}", row), bad, "lacks");
  expect_npy_error(npy("{'descr': '<f4', 'descr': '<f4', 'fortran_order': False, 'shape': (1, 4)}", row), bad,
                   "repeated");
  expect_npy_error(npy("{'descr': '<f4', 'fortran_order': Maybe, 'shape': (1, 4)}", row), bad, "parse");
  expect_npy_error(npy("{'descr': '<f4', 'fortran_order': False, 'shape': (1, 4)} + 1", row), bad, "parse");
  expect_npy_error(npy("{'descr': '<f4", row), bad, "parse");
  expect_npy_error(npy("", row), bad, "parse");
  expect_npy_error(npy(dictionary("<f4", false, "(1, 4)"), row, 9), bad, "unknown version");
  std::string huge_header = npy(dictionary("<f4", false, "(1, 4)"), row, 2);
  huge_header[11] = '\x7f';
  expect_npy_error(huge_header, bad, "cut short");
}

TEST(Npy, RefusesOtherArrays) {
  const auto bad = ErrorCode::unusable;
  const std::string data(64, '\0');
  for (const char* shape : {"(16,)", "(4, 3)", "(4, 2, 2)", "()", "(0, 3)", "(4,)"})
    expect_npy_error(npy(dictionary("<f4", false, shape), data), bad, "shape (N, 4)");
  for (const char* descr : {"<i4", "|u1", "<f2", "<c8", "|O"})
    expect_npy_error(npy(dictionary(descr, false, "(4, 4)"), data), bad, "float32 or float64");
  expect_npy_error(npy("{'descr': [('x', '<f4')], 'fortran_order': False, 'shape': (4,)}", data), bad, "float32");
  expect_npy_error(npy(dictionary("<f4", false, "(0, 4)"), ""), bad, "no spheres");
}

TEST(Npy, RefusesSpheresThatCannotBeUsed) {
  const auto with = [](double value, int column) {
    std::vector<Sphere> spheres(3, Sphere{{1, 2, 3}, 4});
    (column < 3 ? spheres[1].centre[column] : spheres[1].radius) = value;
    return npy(dictionary("<f8", true, "(3, 4)"), array_bytes<double>(spheres, true, false));
  };
  for (int column = 0; column < 4; ++column) {
    expect_npy_error(with(std::numeric_limits<double>::quiet_NaN(), column), ErrorCode::unusable, "Sphere 2 has");
    expect_npy_error(with(std::numeric_limits<double>::infinity(), column), ErrorCode::unusable, "not finite");
    expect_npy_error(with(1.1e9, column), ErrorCode::unusable, "beyond 1e9 mm");
  }
  expect_npy_error(with(-1, 3), ErrorCode::unusable, "Sphere 2 has a negative radius");
}

TEST(Npy, LimitIsExact) {
  const std::string bytes = spheres_to_npy(random_spheres(10));
  EXPECT_EQ(spheres_from_npy(bytes, {.max_spheres = 10}).size(), 10U);
  expect_npy_error(bytes, ErrorCode::too_large, "more than 9 spheres", {.max_spheres = 9});
}

TEST(Ply, HeaderAndRows) {
  const std::vector<Sphere> spheres = random_spheres(2);
  const std::string bytes = spheres_to_ply(spheres);
  const auto end = bytes.find("end_header\n");
  ASSERT_NE(end, std::string::npos);
  const std::string header = bytes.substr(0, end);
  EXPECT_TRUE(header.starts_with("ply\nformat binary_little_endian 1.0\n"));
  EXPECT_NE(header.find("element vertex 2\n"), std::string::npos);
  EXPECT_NE(header.find("comment SPACE=LPS\n"), std::string::npos);
  EXPECT_NE(header.find("comment UNITS=mm\n"), std::string::npos);
  EXPECT_EQ(bytes.substr(end + 11), array_bytes<double>(spheres, false, false));
}

TEST(Vtp, OffsetsLeadToTheArrays) {
  const std::vector<Sphere> spheres = random_spheres(3);
  const std::string bytes = spheres_to_vtp(spheres);
  const auto data = bytes.find("<AppendedData encoding=\"raw\">\n_") + 31;
  ASSERT_LT(data, bytes.size());
  const auto array = [&](const std::string& name) {
    const auto at = bytes.find("Name=\"" + name + "\"");
    const auto offset = bytes.find("offset=\"", at) + 8;
    const std::size_t start = data + std::stoul(bytes.substr(offset, 20));
    std::uint64_t length = 0;
    std::memcpy(&length, bytes.data() + start, 8);
    return bytes.substr(start + 8, length);
  };
  const std::string points = array("Points"), radii = array("radius");
  ASSERT_EQ(points.size(), 72U);
  ASSERT_EQ(radii.size(), 24U);
  std::string rows;
  for (std::size_t i = 0; i < 3; ++i) rows += points.substr(24 * i, 24) + radii.substr(8 * i, 8);
  EXPECT_EQ(rows, array_bytes<double>(spheres, false, false));
  std::string connectivity, offsets;
  for (std::int64_t i = 0; i < 3; ++i) {
    connectivity += number_bytes(i, false);
    offsets += number_bytes(i + 1, false);
  }
  EXPECT_EQ(array("connectivity"), connectivity);
  EXPECT_EQ(array("offsets"), offsets);
  EXPECT_NE(bytes.find(">76 80 83 0<"), std::string::npos) << "the frame is stated";
}

// Columns follow x, y, z and r in every format.
TEST(Exports, HaveMoreColumnsWhenGiven) {
  const std::vector<Sphere> spheres = random_spheres(3);
  const std::vector<SphereColumn> columns{{"volume_mm3", {1.5, 2.5, 1e-3}}, {"rank", {3, 1, 2}}};

  const std::string csv = spheres_to_csv(spheres, columns);
  EXPECT_NE(csv.find("\nx,y,z,r,volume_mm3,rank\n"), std::string::npos);
  EXPECT_TRUE(csv.ends_with(",0.001,2\n")) << csv;
  EXPECT_EQ(spheres_from_csv(csv), spheres) << "readers take the columns that they know";

  std::string rows;
  for (std::size_t i = 0; i < 3; ++i) {
    const Sphere& s = spheres[i];
    for (const double value :
         {s.centre.x, s.centre.y, s.centre.z, s.radius, columns[0].values[i], columns[1].values[i]}) {
      rows += number_bytes(value, false);
    }
  }
  const std::string npy_bytes = spheres_to_npy(spheres, columns);
  EXPECT_NE(npy_bytes.find("(3, 6)"), std::string::npos);
  EXPECT_TRUE(npy_bytes.ends_with("\n" + rows));
  EXPECT_EQ(npy_bytes.find('\n') % 64, 63U);

  const std::string ply = spheres_to_ply(spheres, columns);
  EXPECT_TRUE(
      ply.ends_with("property double radius\nproperty double volume_mm3\nproperty double rank\nend_header\n" + rows));

  const std::string vtp = spheres_to_vtp(spheres, columns);
  const auto data = vtp.find("<AppendedData encoding=\"raw\">\n_") + 31;
  for (const auto& [name, values] : columns) {
    const auto at = vtp.find("Name=\"" + name + "\"");
    ASSERT_NE(at, std::string::npos);
    const std::size_t start = data + std::stoul(vtp.substr(vtp.find("offset=\"", at) + 8, 20));
    std::uint64_t length = 0;
    std::memcpy(&length, vtp.data() + start, 8);
    ASSERT_EQ(length, 24U);
    for (std::size_t i = 0; i < 3; ++i) {
      EXPECT_EQ(vtp.substr(start + 8 + 8 * i, 8), number_bytes(values[i], false));
    }
  }
}

TEST(Exports, OfAnEmptySetAreWholeFiles) {
  EXPECT_TRUE(spheres_to_csv({}).ends_with("\nx,y,z,r\n"));
  EXPECT_EQ(spheres_to_npy({}).size(), 128U);
  EXPECT_NE(spheres_to_npy({}).find("(0, 4)"), std::string::npos);
  EXPECT_TRUE(spheres_to_ply({}).ends_with("end_header\n"));
  EXPECT_TRUE(spheres_to_vtp({}).ends_with("</VTKFile>\n"));
}

}  // namespace
}  // namespace spherule
