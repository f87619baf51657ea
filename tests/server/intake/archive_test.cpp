// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/intake/archive.h"

#include <fcntl.h>
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <map>
#include <sstream>

#include "core/base/error.h"
#include "core/inside.h"
#include "core/read/read.h"
#include "server/base/digest.h"
#include "tests/archives.h"

namespace spherule::server {
namespace {

using test::zip;

class Archive : public testing::Test {
 protected:
  ~Archive() override { std::filesystem::remove(path); }
  std::map<std::string, std::string> unpack(const std::string& bytes,
                                            ArchiveLimits limits = {.unpacked_bytes = 1 << 30}) {
    std::ofstream(path, std::ios::binary) << bytes;
    const Blob blob(::open(path.c_str(), O_RDONLY | O_CLOEXEC), path, sha256_hex(bytes));
    std::map<std::string, std::string> files;
    std::string* now = nullptr;
    unpack_zip(
        blob, limits, [&](std::string_view name) { now = &files[std::string(name)]; },
        [&](std::string_view piece) { *now += piece; });
    return files;
  }
  static Volume read(const std::map<std::string, std::string>& files) {
    const auto folder = std::filesystem::temp_directory_path() / random_id("unzipped");
    std::filesystem::create_directory(folder);
    std::vector<std::filesystem::path> paths;
    for (const auto& [name, bytes] : files) {
      paths.push_back(folder / name);
      std::ofstream(paths.back(), std::ios::binary) << bytes;
    }
    Volume volume = read_volume(paths);
    std::filesystem::remove_all(folder);
    return volume;
  }
  // The code that refuses this, or nothing.
  std::optional<ErrorCode> refusal(const std::string& bytes, ArchiveLimits limits = {.unpacked_bytes = 1 << 30}) {
    try {
      unpack(bytes, limits);
      return std::nullopt;
    } catch (const Error& error) {
      return error.code();
    }
  }
  const std::filesystem::path path = std::filesystem::temp_directory_path() / (random_id("zip") + ".zip");
};

TEST_F(Archive, GivesItsFilesWithoutFolders) {
  const std::string long_text(100'000, 'x');
  const auto files = unpack(zip({{"scan/", "", false, 0040755},
                                 {"scan/a.mhd", "header"},
                                 {"scan/raw/b.raw", long_text, true},
                                 {"K\xc3\xb6rper.dcm", "d"},
                                 {"__MACOSX/scan/._a.mhd", "clutter"},
                                 {"scan/.DS_Store", "clutter"},
                                 {"scan/._a.mhd", "clutter"},
                                 {"empty", ""}}));
  const std::map<std::string, std::string> expected = {
      {"a.mhd", "header"}, {"b.raw", long_text}, {"K\xc3\xb6rper.dcm", "d"}, {"empty", ""}};
  EXPECT_EQ(files, expected);
  EXPECT_TRUE(is_zip(zip({{"a", "b"}})));
  EXPECT_FALSE(is_zip("PK"));
}

// A header in one folder names its data in another: both come without folders, and the last part of the name counts.
TEST_F(Archive, OfAHeaderThatNamesDataInAFolderIsRead) {
  const std::string header =
      "ObjectType = Image\nNDims = 3\nDimSize = 3 4 5\nElementType = MET_UCHAR\nElementDataFile = data/head.raw\n";
  const auto files = unpack(zip({{"scan/head.mhd", header}, {"scan/data/head.raw", std::string(60, '\7')}}));
  EXPECT_EQ(read(files).voxels, std::vector<std::byte>(60, std::byte{7}));
}

TEST_F(Archive, OfTheFieldAreRead) {
  for (const char* name : {"14-subfolder-mhd.zip", "P6-mac.zip"}) {
    const auto archive = std::filesystem::path(SPHERULE_SHARED_DATA) / "field" / name;
    if (!std::filesystem::exists(archive)) GTEST_SKIP() << "the shared data are not here: " << SPHERULE_SHARED_DATA;
    std::ostringstream bytes;
    bytes << std::ifstream(archive, std::ios::binary).rdbuf();
    const Volume volume = read(unpack(bytes.str()));
    ObjectRule rule;
    rule.lo = 600;
    EXPECT_EQ(classify_samples(volume, rule).inside.count(), 500U) << name;
    EXPECT_TRUE(volume.warnings.empty()) << name;
  }
}

TEST_F(Archive, RefusesNamesThatLeaveTheFolder) {
  for (const char* name : {"../a", "a/../../b", "/etc/passwd", "..", "..\\a", "C:\\a", "a/.."}) {
    EXPECT_EQ(refusal(zip({{name, "x"}})), ErrorCode::invalid_argument) << name;
  }
  EXPECT_EQ(refusal(zip({{"a..b/..c", "x"}})), std::nullopt);
  EXPECT_EQ(refusal(zip({{"", "x"}})), ErrorCode::invalid_argument) << "found by fuzz_archive";
  EXPECT_EQ(refusal(zip({{"link", "/etc/passwd", false, 0120777}})), ErrorCode::invalid_argument);
}

TEST_F(Archive, RefusesWhatIsOverItsLimits) {
  EXPECT_EQ(refusal(zip({{"a", "12345"}, {"b", "67890"}}), {.unpacked_bytes = 10}), std::nullopt);
  EXPECT_EQ(refusal(zip({{"a", "12345"}, {"b", "678901"}}), {.unpacked_bytes = 10}), ErrorCode::too_large);
  EXPECT_EQ(refusal(zip({{"a", "1"}, {"b", "2"}, {"c", "3"}}), {.unpacked_bytes = 10, .files = 2}),
            ErrorCode::too_large);
  const std::string bomb = zip({{"a", std::string(40 << 20, '\0'), true}});
  EXPECT_EQ(refusal(bomb), ErrorCode::too_large) << "the ratio";
  EXPECT_EQ(refusal(bomb, {.unpacked_bytes = 1 << 30, .ratio = 2000}), std::nullopt);
}

TEST_F(Archive, RefusesWhatIsDamaged) {
  const std::string good = zip({{"a", std::string(5000, 'a'), true}, {"b", "text"}});
  EXPECT_EQ(refusal(good), std::nullopt);
  for (std::size_t size = 4; size < good.size(); size += 7) {
    EXPECT_TRUE(refusal(good.substr(0, size))) << size;
  }
  EXPECT_EQ(refusal(zip({})), ErrorCode::malformed) << "no files";
  EXPECT_EQ(refusal(zip({{"a", "secret", false, 0100644, 0x0801}})), ErrorCode::malformed) << "encrypted";
  std::string wrong = zip({{"a", "checked by its sum"}});
  wrong[wrong.find("sum")] = 'S';
  EXPECT_EQ(refusal(wrong), ErrorCode::malformed);
}

}  // namespace
}  // namespace spherule::server
