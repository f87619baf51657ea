// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/blob_store.h"

#include <gtest/gtest.h>
#include <sys/resource.h>

#include <algorithm>
#include <csignal>
#include <fstream>
#include <limits>
#include <sstream>

#include "server/intake/upload.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

namespace fs = std::filesystem;
using test::error_of;

constexpr std::uint64_t any_size = std::numeric_limits<std::uint64_t>::max();

std::string contents(const fs::path& path) {
  std::ifstream file(path, std::ios::binary);
  std::stringstream bytes;
  bytes << file.rdbuf();
  return bytes.str();
}

std::size_t files_under(const fs::path& folder) {
  std::size_t count = 0;
  for (const auto& entry : fs::recursive_directory_iterator(folder)) count += !entry.is_directory();
  return count;
}

/// The contract, kept by every store.
template <typename Store>
class BlobStoreContract : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  Store store = [&] {
    if constexpr (std::is_same_v<Store, FileBlobStore>)
      return FileBlobStore(folder.path());
    else
      return Store();
  }();
};
using Stores = testing::Types<FileBlobStore, test::MemoryBlobStore>;
TYPED_TEST_SUITE(BlobStoreContract, Stores);

TYPED_TEST(BlobStoreContract, ReturnsWhatWasStored) {
  const std::string bytes("some\0 bytes\n", 12);
  const std::string key = this->store.put("volumes/vol_1-0", bytes);
  const Blob blob = this->store.open(key);
  EXPECT_EQ(blob.size(), 12U);
  EXPECT_EQ(blob.sha256(), sha256_hex(bytes));
  EXPECT_EQ(blob.read(), bytes);
  EXPECT_EQ(contents(blob.path()), bytes);
  blob.verify();
  EXPECT_EQ(this->store.keys(), std::vector{key});
  EXPECT_EQ(this->store.read(this->store.put("empty", "")), "");
}

TYPED_TEST(BlobStoreContract, ReadsRanges) {
  const Blob blob = this->store.open(this->store.put("x", "0123456789"));
  std::string part(4, '?');
  EXPECT_EQ(blob.read_at(3, part), 4U);
  EXPECT_EQ(part, "3456");
  EXPECT_EQ(blob.read_at(8, part), 2U);
  EXPECT_EQ(part, "8956");
  EXPECT_EQ(blob.read_at(10, part), 0U);
  EXPECT_EQ(blob.read_at(1000, part), 0U);
}

TYPED_TEST(BlobStoreContract, StagedBytesAreReadableBeforeAndGoneWithoutCommit) {
  {
    const auto staging = this->store.stage(100);
    staging->append("abc");
    staging->append("def");
    EXPECT_EQ(staging->size(), 6U);
    EXPECT_EQ(staging->sha256(), sha256_hex("abcdef"));
    EXPECT_EQ(staging->open().read(), "abcdef");
    EXPECT_TRUE(this->store.keys().empty());
  }
  EXPECT_TRUE(this->store.keys().empty());
}

TYPED_TEST(BlobStoreContract, RefusesBytesOverTheLimit) {
  const auto staging = this->store.stage(5);
  staging->append("12345");
  EXPECT_EQ(error_of([&] { staging->append("6"); }), ErrorCode::too_large);
  EXPECT_EQ(error_of([&] { (void)this->store.stage(5, 6); }), ErrorCode::too_large);
  (void)this->store.stage(5, 5);
}

TYPED_TEST(BlobStoreContract, EqualBytesAreSeparateBlobs) {
  const std::string first = this->store.put("x", "same");
  const std::string second = this->store.put("x", "same");
  EXPECT_NE(first, second);
  this->store.remove(first);
  EXPECT_EQ(this->store.read(second), "same");
}

TYPED_TEST(BlobStoreContract, OpenBlobsOutliveRemoval) {
  const std::string key = this->store.put("x", "still here");
  const Blob blob = this->store.open(key);
  this->store.remove(key);
  this->store.remove(key);
  EXPECT_EQ(blob.read(), "still here");
  EXPECT_EQ(error_of([&] { (void)this->store.open(key); }), ErrorCode::not_found);
}

TYPED_TEST(BlobStoreContract, ScratchFoldersNameBlobs) {
  const std::string key = this->store.put("x", "header");
  fs::path linked;
  {
    ScratchFolder scratch(this->store.scratch_root());
    const fs::path path = scratch.link(this->store.open(key), "Scan of Ünal, J. (2).hdr");
    linked = path.parent_path();
    EXPECT_EQ(path.filename(), "Scan of Ünal, J. (2).hdr");
    EXPECT_EQ(contents(path), "header");
    for (const std::string& name :
         {std::string(), std::string("."), std::string(".."), std::string("a/b"), std::string("/etc/passwd"),
          std::string("a\0b", 3), std::string(256, 'a'), std::string("Scan of Ünal, J. (2).hdr")})
      EXPECT_EQ(error_of([&] { scratch.link(this->store.open(key), name); }), ErrorCode::invalid_argument) << name;
    const Blob blob = this->store.open(key);
    this->store.remove(key);
    EXPECT_EQ(contents(path), "header");
    EXPECT_EQ(blob.read(), "header");
  }
  EXPECT_FALSE(fs::exists(linked));
}

TYPED_TEST(BlobStoreContract, TellsWhatIsOnItsWay) {
  const std::string in = this->store.put("volumes/a", "x"), out = this->store.put("volumes/b", "x");
  this->store.settle(out);
  EXPECT_EQ(this->store.unsettled(), std::vector{in});
  this->store.settle(in);
  this->store.unsettle({out});
  EXPECT_EQ(this->store.unsettled(), std::vector{out});
  EXPECT_EQ(this->store.keys().size(), 2U) << "still there";
  this->store.remove(out);
  this->store.settle("no such key");
  EXPECT_TRUE(this->store.unsettled().empty());
  EXPECT_EQ(this->store.keys(), std::vector{in});
}

class FileBlobs : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  FileBlobStore store{folder.path() / "blobs"};
};

TEST_F(FileBlobs, KeysThatItDidNotMakeAreNotFound) {
  std::ofstream(folder.path() / "secret") << "x";
  const std::string digest = sha256_hex("x");
  for (const std::string& key :
       {std::string(), std::string("../secret"), "../secret." + digest, "a/b/c." + digest + "." + random_id("b"),
        "x." + digest + ".b_../../secret", "../secret." + digest + "." + random_id("b")}) {
    EXPECT_EQ(error_of([&] { (void)store.open(key); }), ErrorCode::not_found) << key;
    store.remove(key);
  }
  EXPECT_TRUE(fs::exists(folder.path() / "secret"));
}

TEST_F(FileBlobs, DamageIsFound) {
  const std::string bytes(3'000'000, 'x');
  const std::string flipped = store.put("models/a", bytes);
  const std::string torn = store.put("models/b", bytes);
  const std::string longer = store.put("models/c", bytes);
  const auto file_of = [&](const std::string& key) { return store.open(key).path(); };
  std::fstream(file_of(flipped), std::ios::in | std::ios::out | std::ios::binary).seekp(2'000'000).put('y');
  fs::resize_file(file_of(torn), 1'234'567);
  fs::resize_file(file_of(longer), 3'000'001);
  for (const std::string& key : {flipped, torn, longer}) {
    EXPECT_EQ(error_of([&] { (void)store.read(key); }), ErrorCode::corrupt);
    EXPECT_EQ(error_of([&] { store.open(key).verify(); }), ErrorCode::corrupt);
  }
}

TEST_F(FileBlobs, OpeningRemovesWhatAKilledProcessLeft) {
  const std::string key = store.put("volumes/kept", "kept");
  store.settle(key);
  const std::string travelling = store.put("volumes/travelling", "committed, and then the power went");
  auto abandoned = store.stage(any_size);
  abandoned->append("half an upl");
  const Blob blob = abandoned->open();
  fs::create_directory(store.scratch_root() / "scratch");
  fs::create_symlink(blob.path(), store.scratch_root() / "scratch" / "Name, Patient.hdr");
  EXPECT_EQ(files_under(folder.path()), 5U);
  FileBlobStore reopened(folder.path() / "blobs");
  EXPECT_EQ(files_under(folder.path()), 3U);
  EXPECT_EQ(reopened.unsettled(), std::vector{travelling});
  reopened.remove(travelling);
  EXPECT_TRUE(fs::is_empty(reopened.scratch_root()));
  EXPECT_EQ(reopened.read(key), "kept");
  EXPECT_EQ(reopened.keys(), std::vector{key});
}

TEST_F(FileBlobs, NotesOfEarlierVersionsAreUnderstood) {
  const std::string key = store.put("volumes/travelling", "x"), gone = store.put("volumes/gone", "y");
  for (const std::string& each : {key, gone}) {
    store.settle(each);
    std::string name = each;
    std::ranges::replace(name, '/', '+');
    std::ofstream(store.scratch_root() / name).flush();
  }
  store.remove(gone);
  EXPECT_EQ(FileBlobStore(folder.path() / "blobs").unsettled(), std::vector{key});
  EXPECT_TRUE(fs::is_empty(store.scratch_root()));
}

TEST_F(FileBlobs, ScansAreForTheServersEyesOnly) {
  const Blob blob = store.open(store.put("volumes/a", "x"));
  const auto others = fs::perms::group_all | fs::perms::others_all;
  EXPECT_EQ(fs::status(blob.path()).permissions() & others, fs::perms::none);
  EXPECT_EQ(fs::status(blob.path().parent_path()).permissions() & others, fs::perms::none);
  EXPECT_EQ(fs::status(folder.path() / "blobs").permissions() & others, fs::perms::none);
}

TEST_F(FileBlobs, RefusesADeclaredSizeThatDoesNotFit) {
  EXPECT_EQ(error_of([&] { (void)store.stage(any_size, store.free_bytes() + (std::uint64_t{1} << 40)); }),
            ErrorCode::no_space);
  EXPECT_EQ(files_under(folder.path()), 0U);
}

/// Makes every file of this process end at 1 MiB, which the kernel reports as a failed or short write.
class TightFileLimit {
 public:
  TightFileLimit() {
    getrlimit(RLIMIT_FSIZE, &before_);
    rlimit tight = before_;
    tight.rlim_cur = 1 << 20;
    signal_ = std::signal(SIGXFSZ, SIG_IGN);
    setrlimit(RLIMIT_FSIZE, &tight);
  }
  ~TightFileLimit() {
    setrlimit(RLIMIT_FSIZE, &before_);
    std::signal(SIGXFSZ, signal_);
  }

 private:
  rlimit before_{};
  void (*signal_)(int) = nullptr;
};

TEST_F(FileBlobs, AWriteThatDoesNotFitLeavesNothing) {
  const std::string key = store.put("a", "before");
  store.settle(key);
  {
    const TightFileLimit limit;
    const auto staging = store.stage(any_size);
    EXPECT_EQ(error_of([&] { staging->append(std::string(3 << 20, 'x')); }), ErrorCode::no_space);
  }
  EXPECT_EQ(files_under(folder.path()), 1U);
  EXPECT_EQ(store.read(key), "before");
  EXPECT_EQ(store.read(store.put("b", std::string(3 << 20, 'x'))).size(), std::size_t{3} << 20);
}

TEST_F(FileBlobs, AFailureAtAnyStepLeavesNothing) {
  test::FaultyBlobStore faulty(store);
  for (unsigned step = 1; step <= 3; ++step) {
    faulty.fail_append(step);
    const auto write = [&] {
      const auto staging = faulty.stage(any_size);
      for (const char* piece : {"a", "b", "c"}) staging->append(piece);
    };
    EXPECT_EQ(error_of(write), ErrorCode::no_space);
    EXPECT_EQ(files_under(folder.path()), 0U);
  }
  faulty.fail_append(0);
  faulty.fail_commit(true);
  EXPECT_EQ(error_of([&] { (void)faulty.put("a", "bytes"); }), ErrorCode::no_space);
  EXPECT_EQ(files_under(folder.path()), 0U);
}

TEST(FileBlobStoreStart, AFileInTheWayIsReported) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "blobs") << "x";
  EXPECT_EQ(error_of([&] { FileBlobStore store(folder.path() / "blobs"); }), ErrorCode::corrupt);
}

std::ptrdiff_t descriptors() {
  return std::distance(fs::directory_iterator("/proc/self/fd"), fs::directory_iterator());
}

// A zip of a thousand slices has a thousand files.
TEST(FileUpload, HoldsOneDescriptorForAnyNumberOfFiles) {
  const test::TemporaryFolder folder;
  FileBlobStore store(folder.path() / "blobs");
  FileUpload upload(store, any_size, 0, [](std::uint64_t) {});
  const auto before = descriptors();
  for (int i = 0; i < 100; ++i) {
    upload.begin_file("slice-" + std::to_string(1000 + i));
    upload.write("first");
    upload.write("second");
  }
  EXPECT_LE(descriptors(), before + 1);
  std::vector<std::string> keys;
  for (FileUpload::File& file : upload.files()) {
    file.staging->append("third");  // after a rest
    keys.push_back(file.staging->commit("volumes/vol_1-" + std::to_string(keys.size())));
    EXPECT_EQ(store.read(keys.back()), "firstsecondthird");
  }
  EXPECT_LE(descriptors(), before);
}

TEST(ScratchFolders, HoldNoDescriptorForAnyNumberOfFiles) {
  const test::TemporaryFolder folder;
  FileBlobStore store(folder.path() / "blobs");
  const std::string key = store.put("x", "slice");
  const auto before = descriptors();
  ScratchFolder scratch(store.scratch_root());
  for (int i = 0; i < 100; ++i) scratch.link(store.open(key), "slice-" + std::to_string(i));
  EXPECT_LE(descriptors(), before);
}

}  // namespace
}  // namespace spherule::server
