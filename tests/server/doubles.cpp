// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/server/doubles.h"

#include <fcntl.h>
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mman.h>
#include <sys/mount.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdlib>
#include <fstream>
#include <iostream>
#include <limits>
#include <map>
#include <mutex>
#include <set>
#include <stdexcept>

// ThreadSanitizer keeps a thread of its own, and by default refuses threads in the children of such a process.
extern "C" const char* __tsan_default_options();
extern "C" const char* __tsan_default_options() { return "die_after_fork=0"; }

namespace spherule::server::test {

TemporaryFolder::TemporaryFolder(const std::filesystem::path& parent) : path_(parent / random_id("spherule-test")) {
  std::filesystem::create_directories(path_);
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

namespace {

std::filesystem::path memory_folder() {
  const std::filesystem::path memory = "/dev/shm";
  return ::access(memory.c_str(), W_OK) == 0 ? memory : std::filesystem::temp_directory_path();
}

}  // namespace

ScratchCatalog::ScratchCatalog()
    : TemporaryFolder(memory_folder()), Catalog(TemporaryFolder::path() / "catalog.sqlite") {}

struct MemoryBlobStore::Blobs {
  std::mutex mutex;
  std::map<std::string, std::string> by_key;
  std::set<std::string> unsettled;
};

namespace {

Blob blob_of(const std::string& bytes) {
  const int descriptor = memfd_create("blob", MFD_CLOEXEC);
  if (descriptor < 0 || ::write(descriptor, bytes.data(), bytes.size()) != static_cast<ssize_t>(bytes.size()))
    throw std::runtime_error("no memory file");
  return {descriptor, "/proc/self/fd/" + std::to_string(descriptor), sha256_hex(bytes)};
}

}  // namespace

MemoryBlobStore::MemoryBlobStore() : blobs_(std::make_shared<Blobs>()) {}
MemoryBlobStore::~MemoryBlobStore() = default;

std::unique_ptr<Staging> MemoryBlobStore::stage(std::uint64_t limit, std::optional<std::uint64_t> declared) {
  class MemoryStaging final : public Staging {
   public:
    MemoryStaging(std::uint64_t most, std::shared_ptr<Blobs> blobs) : Staging(most), blobs_(std::move(blobs)) {}
    Blob open() const override { return blob_of(bytes_); }
    std::string commit(std::string_view name) override {
      const std::lock_guard lock(blobs_->mutex);
      std::string key = std::string(name) + "." + sha256() + "." + random_id("b");
      blobs_->by_key[key] = bytes_;
      blobs_->unsettled.insert(key);
      return key;
    }

   protected:
    void write(std::string_view bytes) override { bytes_ += bytes; }

   private:
    std::shared_ptr<Blobs> blobs_;
    std::string bytes_;
  };
  if (declared && *declared > limit) throw Error(ErrorCode::too_large, "Too large.");
  return std::make_unique<MemoryStaging>(limit, blobs_);
}

Blob MemoryBlobStore::open(const std::string& key) const {
  const std::lock_guard lock(blobs_->mutex);
  const auto found = blobs_->by_key.find(key);
  if (found == blobs_->by_key.end()) throw Error(ErrorCode::not_found, "No such blob.");
  return blob_of(found->second);
}

void MemoryBlobStore::remove(const std::string& key) {
  const std::lock_guard lock(blobs_->mutex);
  blobs_->by_key.erase(key);
  blobs_->unsettled.erase(key);
}

std::vector<std::string> MemoryBlobStore::unsettled() const {
  const std::lock_guard lock(blobs_->mutex);
  return {blobs_->unsettled.begin(), blobs_->unsettled.end()};
}

void MemoryBlobStore::settle(const std::string& key) {
  const std::lock_guard lock(blobs_->mutex);
  blobs_->unsettled.erase(key);
}

void MemoryBlobStore::unsettle(const std::vector<std::string>& keys) {
  const std::lock_guard lock(blobs_->mutex);
  blobs_->unsettled.insert(keys.begin(), keys.end());
}

std::vector<std::string> MemoryBlobStore::keys() const {
  const std::lock_guard lock(blobs_->mutex);
  std::vector<std::string> keys;
  for (const auto& [key, bytes] : blobs_->by_key) keys.push_back(key);
  return keys;
}

std::uint64_t MemoryBlobStore::free_bytes() const { return std::numeric_limits<std::uint64_t>::max(); }

class FaultyBlobStore::FaultyStaging final : public Staging {
 public:
  FaultyStaging(std::unique_ptr<Staging> inner, FaultyBlobStore& store)
      : Staging(std::numeric_limits<std::uint64_t>::max()), inner_(std::move(inner)), store_(store) {}
  Blob open() const override { return inner_->open(); }
  std::string commit(std::string_view name) override {
    if (store_.fail_commit_) throw Error(ErrorCode::no_space, "Full.");
    return inner_->commit(name);
  }

 protected:
  void write(std::string_view bytes) override {
    if (store_.appends_left_ == 1) throw Error(ErrorCode::no_space, "Full.");
    if (store_.appends_left_ > 1) --store_.appends_left_;
    inner_->append(bytes);
  }

 private:
  std::unique_ptr<Staging> inner_;
  FaultyBlobStore& store_;
};

std::unique_ptr<Staging> FaultyBlobStore::stage(std::uint64_t limit, std::optional<std::uint64_t> declared) {
  return std::make_unique<FaultyStaging>(inner_.stage(limit, declared), *this);
}

void FaultyBlobStore::remove(const std::string& key) {
  if (fail_remove_) throw Error(ErrorCode::corrupt, "Broken.");
  inner_.remove(key);
}

std::optional<ErrorCode> error_of(const std::function<void()>& act) {
  try {
    act();
    return {};
  } catch (const Error& error) {
    return error.code();
  }
}

void on_a_small_disk(const std::function<std::string(const std::filesystem::path& disk)>& act, unsigned mib) {
  constexpr int not_possible_here = 77;
  const auto in_child = [&]() -> int {
    const TemporaryFolder folder;
    if (unshare(CLONE_NEWNS) != 0 || mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        mount("none", folder.path().c_str(), "tmpfs", 0, ("size=" + std::to_string(mib) + "m").c_str()) != 0)
      return not_possible_here;
    std::string wrong;
    try {
      wrong = act(folder.path());
    } catch (const std::exception& error) {
      wrong = error.what();
    }
    umount(folder.path().c_str());
    std::cerr << wrong << std::flush;
    return wrong.empty() ? 0 : 1;
  };
  // A new process image rather than a fork, since ThreadSanitizer does not bear threads in a forked one.
  GTEST_FLAG_SET(death_test_style, "threadsafe");
  bool possible = true;
  EXPECT_EXIT(
      std::_Exit(in_child()),
      [&](int status) {
        possible = WIFEXITED(status) && WEXITSTATUS(status) != not_possible_here;
        return WIFEXITED(status) && (!possible || WEXITSTATUS(status) == 0);
      },
      "");
  if (!possible) GTEST_SKIP() << "only root may mount the small file system that this needs";
}

void fill_disk(const std::filesystem::path& file) {
  std::ofstream filler(file);
  for (const std::string piece(4096, 'x'); filler.write(piece.data(), 4096) && filler.flush();) {
  }
}

}  // namespace spherule::server::test
