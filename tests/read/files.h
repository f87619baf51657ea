// SPDX-License-Identifier: GPL-3.0-or-later
//
// Files for the tests of readers: folders that vanish, headers written field by field from the formats' own
// documents (not with the libraries under test), and what every refusal must obey.
#pragma once

#include <gtest/gtest.h>

#include <array>
#include <bit>
#include <charconv>
#include <cstring>
#include <filesystem>
#include <limits>
#include <string>
#include <string_view>
#include <vector>

#include "core/read/read.h"
#include "tests/archives.h"

namespace spherule::test {

using Paths = std::vector<std::filesystem::path>;

class TempFolder {
 public:
  TempFolder();
  ~TempFolder();
  TempFolder(const TempFolder&) = delete;
  TempFolder& operator=(const TempFolder&) = delete;
  std::filesystem::path add(const std::string& name, std::string_view bytes) const;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// Files of the shared data, in the folder `below` of them; skips where they are not.
class SharedFiles : public ::testing::Test {
 protected:
  explicit SharedFiles(const char* below = "") : folder_(std::filesystem::path(SPHERULE_SHARED_DATA) / below) {}
  void SetUp() override;
  Volume read(const std::vector<std::string>& names, const ReadOptions& options = {}) const;
  Paths paths(const std::vector<std::string>& names) const;
  const std::filesystem::path folder_;
};

std::string bytes_of_file(const std::filesystem::path& file);

/// The bytes of a number in either order.
template <typename T>
std::string bytes_of(T value, bool big_endian) {
  std::string bytes(sizeof value, '\0');
  std::memcpy(bytes.data(), &value, sizeof value);
  if (big_endian == (std::endian::native == std::endian::little)) bytes.assign(bytes.rbegin(), bytes.rend());
  return bytes;
}

template <typename T>
std::string bytes_of(const std::vector<T>& values, bool big_endian) {
  std::string bytes;
  for (const T v : values) bytes += bytes_of(v, big_endian);
  return bytes;
}

/// Numbers as text, with every kind of blank between.
template <typename T>
std::string text_of(const std::vector<T>& values) {
  std::string text;
  for (const T value : values) {
    std::array<char, 64> digits;
    char* end = nullptr;
    if constexpr (sizeof(T) == 1) end = std::to_chars(digits.data(), digits.data() + 64, static_cast<int>(value)).ptr;
    if constexpr (sizeof(T) > 1) end = std::to_chars(digits.data(), digits.data() + 64, value).ptr;
    text += std::string(digits.data(), end) + (text.size() % 3 == 0 ? "\r\n" : text.size() % 3 == 1 ? ", " : " ");
  }
  return text;
}

/// Values that a wrong type, sign or byte order would change.
template <typename T>
std::vector<T> telling_values(std::size_t count) {
  std::vector<T> values;
  for (std::size_t i = 0; i < count; ++i) values.push_back(static_cast<T>(i * i + i));
  values[0] = std::numeric_limits<T>::lowest();
  values[1] = std::numeric_limits<T>::max();
  return values;
}

/// Calls f with a value of each type that voxels have.
template <typename F>
void for_each_type(F&& f) {
  f(std::uint8_t{}), f(std::int8_t{}), f(std::uint16_t{}), f(std::int16_t{}), f(std::uint32_t{}), f(std::int32_t{});
  f(std::uint64_t{}), f(std::int64_t{}), f(float{}), f(double{});
}

template <typename T>
VoxelType type_of() {
  const std::string letter = std::is_floating_point_v<T> ? "float" : std::is_signed_v<T> ? "int" : "uint";
  return voxel_type(letter + std::to_string(8 * sizeof(T)));
}

template <typename T>
std::vector<T> samples(const Volume& volume) {
  EXPECT_EQ(volume.type, type_of<T>());
  std::vector<T> values(volume.voxels.size() / sizeof(T));
  std::memcpy(values.data(), volume.voxels.data(), volume.voxels.size());
  return values;
}

/// NIfTI headers by the offsets of nifti1.h and nifti2.h.
struct Nifti {
  int version = 1;
  bool big_endian = false;
  std::vector<std::int64_t> dims{3, 4, 5};
  int datatype = 2;  // uint8
  std::array<double, 8> pixdim{1, 1, 1, 1, 1, 1, 1, 1};
  double slope = 0, intercept = 0;
  int units = 2;  // mm
  int qform_code = 0, sform_code = 1;
  std::array<double, 3> quatern{0, 0, 0}, qoffset{0, 0, 0};
  std::array<double, 12> srow{1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0};
  bool pair = false;
  double vox_offset = -1;  // -1: right behind the header
  int rank = -1;           // -1: dims.size()
};
std::string header(const Nifti& nifti);
int nifti_code(VoxelType type);

/// Reads and expects an Error of that code with a sentence that keeps to error.h: ends like a sentence, and holds
/// neither a folder nor a file's name.
void expect_refused(const Paths& files, ErrorCode code, const ReadOptions& options = {});

/// The same, in a child process with little memory and time to spare: reading must neither crash nor take more than
/// 48 MiB beyond what the test had, nor more than a few seconds of processor time.
void expect_refused_cheaply(const Paths& files, ErrorCode code, const ReadOptions& options = {});

void expect_near(Vec3 actual, Vec3 expected, double tolerance);
/// Directions and spacings: column a of direction times spacing a.
void expect_step(const Volume& volume, int axis, Vec3 expected, double tolerance = 1e-12);

/// Whether a warning holds the words.
bool warns(const Volume& volume, std::string_view words);

}  // namespace spherule::test
