// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/read/files.h"

#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <sstream>

namespace spherule::test {

namespace fs = std::filesystem;

TempFolder::TempFolder() {
  std::string name = (fs::temp_directory_path() / "spherule-io-XXXXXX").string();
  if (!mkdtemp(name.data())) throw std::runtime_error("no temporary folder");
  path_ = name;
}

TempFolder::~TempFolder() {
  std::error_code ignored;
  fs::remove_all(path_, ignored);
}

fs::path TempFolder::add(const std::string& name, std::string_view bytes) const {
  const fs::path file = path_ / name;
  std::ofstream(file, std::ios::binary).write(bytes.data(), static_cast<std::streamsize>(bytes.size()));
  return file;
}

void SharedFiles::SetUp() {
  if (!fs::is_directory(folder_)) GTEST_SKIP() << "the shared data are not here: " << SPHERULE_SHARED_DATA;
}

Volume SharedFiles::read(const std::vector<std::string>& names, const ReadOptions& options) const {
  return read_volume(paths(names), options);
}

Paths SharedFiles::paths(const std::vector<std::string>& names) const {
  Paths files;
  for (const std::string& name : names) files.push_back(folder_ / name);
  return files;
}

namespace {

void put(std::string& bytes, std::size_t at, const std::string& value) { bytes.replace(at, value.size(), value); }

}  // namespace

std::string bytes_of_file(const fs::path& file) {
  std::ostringstream bytes;
  bytes << std::ifstream(file, std::ios::binary).rdbuf();
  return bytes.str();
}

int nifti_code(VoxelType type) {
  switch (type) {
    case VoxelType::uint8: return 2;
    case VoxelType::int16: return 4;
    case VoxelType::int32: return 8;
    case VoxelType::float32: return 16;
    case VoxelType::float64: return 64;
    case VoxelType::int8: return 256;
    case VoxelType::uint16: return 512;
    case VoxelType::uint32: return 768;
    case VoxelType::int64: return 1024;
    case VoxelType::uint64: break;
  }
  return 1280;
}

std::string header(const Nifti& n) {
  const bool be = n.big_endian;
  std::array<std::int64_t, 8> dim{};
  dim[0] = n.rank >= 0 ? n.rank : static_cast<std::int64_t>(n.dims.size());
  for (std::size_t i = 0; i < 7; ++i) dim[i + 1] = i < n.dims.size() ? n.dims[i] : 1;
  const double behind = n.version == 1 ? 352 : 544;
  const double vox_offset = n.vox_offset >= 0 ? n.vox_offset : n.pair ? 0 : behind;
  const std::size_t size = n.version == 1 ? 348 : 540;
  std::string h(size + (n.pair ? 0 : 4), '\0');
  put(h, 0, bytes_of(static_cast<std::int32_t>(size), be));
  if (n.version == 1) {
    const auto f32 = [&](double v) { return bytes_of(static_cast<float>(v), be); };
    const auto i16 = [&](std::int64_t v) { return bytes_of(static_cast<std::int16_t>(v), be); };
    for (std::size_t i = 0; i < 8; ++i) put(h, 40 + 2 * i, i16(dim[i])), put(h, 76 + 4 * i, f32(n.pixdim[i]));
    put(h, 70, i16(n.datatype)), put(h, 108, f32(vox_offset)), put(h, 112, f32(n.slope)), put(h, 116, f32(n.intercept));
    h[123] = static_cast<char>(n.units);
    put(h, 252, i16(n.qform_code)), put(h, 254, i16(n.sform_code));
    for (std::size_t i = 0; i < 3; ++i) put(h, 256 + 4 * i, f32(n.quatern[i])), put(h, 268 + 4 * i, f32(n.qoffset[i]));
    for (std::size_t i = 0; i < 12; ++i) put(h, 280 + 4 * i, f32(n.srow[i]));
    put(h, 344, n.pair ? "ni1" : "n+1");
  } else {
    const auto f64 = [&](double v) { return bytes_of(v, be); };
    const auto i64 = [&](std::int64_t v) { return bytes_of(v, be); };
    const auto i32 = [&](int v) { return bytes_of(static_cast<std::int32_t>(v), be); };
    put(h, 4, std::string(n.pair ? "ni2" : "n+2") + std::string("\0\r\n\032\n", 5));
    put(h, 12, bytes_of(static_cast<std::int16_t>(n.datatype), be));
    for (std::size_t i = 0; i < 8; ++i) put(h, 16 + 8 * i, i64(dim[i])), put(h, 104 + 8 * i, f64(n.pixdim[i]));
    put(h, 168, i64(static_cast<std::int64_t>(vox_offset))), put(h, 176, f64(n.slope)), put(h, 184, f64(n.intercept));
    put(h, 344, i32(n.qform_code)), put(h, 348, i32(n.sform_code)), put(h, 500, i32(n.units));
    for (std::size_t i = 0; i < 3; ++i) put(h, 352 + 8 * i, f64(n.quatern[i])), put(h, 376 + 8 * i, f64(n.qoffset[i]));
    for (std::size_t i = 0; i < 12; ++i) put(h, 400 + 8 * i, f64(n.srow[i]));
  }
  return h;
}

void expect_refused(const Paths& files, ErrorCode code, const ReadOptions& options) {
  try {
    read_volume(files, options);
    ADD_FAILURE() << "was read";
  } catch (const Error& error) {
    const std::string sentence = error.what();
    EXPECT_EQ(error.code(), code) << sentence;
    EXPECT_TRUE(sentence.ends_with('.') && sentence.find("  ") == std::string::npos) << sentence;
    EXPECT_EQ(sentence.find('\n'), std::string::npos) << sentence;
    for (const auto& file : files) {
      EXPECT_EQ(sentence.find(file.parent_path().string()), std::string::npos) << sentence;
      EXPECT_EQ(sentence.find(file.filename().string()), std::string::npos) << sentence;
    }
  }
}

void expect_refused_cheaply(const Paths& files, ErrorCode code, const ReadOptions& options) {
  expect_refused(files, code, options);
  const pid_t child = fork();
  ASSERT_GE(child, 0);
  if (child == 0) {
    const rlimit seconds{5, 5};
    setrlimit(RLIMIT_CPU, &seconds);
    rusage before{}, after{};
    getrusage(RUSAGE_SELF, &before);
    int result = 1;
    try {
      read_volume(files, options);
    } catch (const Error&) {
      result = 0;
    }
    getrusage(RUSAGE_SELF, &after);
    if (after.ru_maxrss - before.ru_maxrss > 48 * 1024) result = 2;
    _exit(result);
  }
  int status = 0;
  ASSERT_EQ(waitpid(child, &status, 0), child);
  EXPECT_TRUE(WIFEXITED(status)) << "crashed or took too long: signal " << WTERMSIG(status);
  EXPECT_NE(WEXITSTATUS(status), 2) << "took more than 48 MiB";
  EXPECT_EQ(WEXITSTATUS(status), 0);
}

void expect_near(Vec3 actual, Vec3 expected, double tolerance) {
  for (int a = 0; a < 3; ++a) EXPECT_NEAR(actual[a], expected[a], tolerance) << "component " << a;
}

void expect_step(const Volume& volume, int axis, Vec3 expected, double tolerance) {
  expect_near(volume.grid.spacing[axis] * volume.grid.direction.column(axis), expected, tolerance);
}

bool warns(const Volume& volume, std::string_view words) {
  for (const std::string& warning : volume.warnings) {
    if (warning.find(words) != std::string::npos) return true;
  }
  return false;
}

}  // namespace spherule::test
