// SPDX-License-Identifier: GPL-3.0-or-later
//
// Stand-ins for the blob store, and the folders that tests write to.
#pragma once

#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>
#include <vector>

#include "core/base/error.h"
#include "server/bytes/blob_store.h"
#include "server/records/catalog.h"

namespace spherule::server::test {

/// A new empty folder, removed with its contents by the destructor.
class TemporaryFolder {
 public:
  explicit TemporaryFolder(const std::filesystem::path& parent = std::filesystem::temp_directory_path());
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  [[nodiscard]] const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

/// A catalogue in a file of its own, on a disk in memory where there is one.
class ScratchCatalog : private TemporaryFolder, public Catalog {
 public:
  ScratchCatalog();
};

/// A request that bears a text, and the text of a job's request.
inline api::WorkRequest asks(const std::string& text = {}) { return api::ModelRequest{.volume = text, .rule = {}}; }
inline std::string asked(const JobRecord& job) { return std::get<api::ModelRequest>(*job.request).volume; }

/// Keeps blobs in anonymous memory; safe to use from several threads.
class MemoryBlobStore final : public BlobStore {
 public:
  MemoryBlobStore();
  ~MemoryBlobStore() override;
  std::unique_ptr<Staging> stage(std::uint64_t limit, std::optional<std::uint64_t> declared = {}) override;
  Blob open(const std::string& key) const override;
  void remove(const std::string& key) override;
  std::vector<std::string> keys() const override;
  std::vector<std::string> unsettled() const override;
  void settle(const std::string& key) override;
  void unsettle(const std::vector<std::string>& keys) override;
  std::uint64_t free_bytes() const override;
  std::filesystem::path scratch_root() const override { return scratch_.path(); }

 private:
  struct Blobs;
  std::shared_ptr<Blobs> blobs_;
  TemporaryFolder scratch_;
};

/// Another store, with failures on demand.
class FaultyBlobStore final : public BlobStore {
 public:
  explicit FaultyBlobStore(BlobStore& inner) : inner_(inner) {}

  /// The n-th append from now (1: the next) and all after it throw no_space; 0: never.
  void fail_append(unsigned n) { appends_left_ = n; }
  /// Commits throw no_space.
  void fail_commit(bool fail) { fail_commit_ = fail; }
  /// remove() throws, and removes nothing.
  void fail_remove(bool fail) { fail_remove_ = fail; }

  std::unique_ptr<Staging> stage(std::uint64_t limit, std::optional<std::uint64_t> declared = {}) override;
  Blob open(const std::string& key) const override { return inner_.open(key); }
  void remove(const std::string& key) override;
  std::vector<std::string> keys() const override { return inner_.keys(); }
  std::vector<std::string> unsettled() const override { return inner_.unsettled(); }
  void settle(const std::string& key) override { inner_.settle(key); }
  void unsettle(const std::vector<std::string>& keys) override { inner_.unsettle(keys); }
  std::uint64_t free_bytes() const override { return inner_.free_bytes(); }
  std::filesystem::path scratch_root() const override { return inner_.scratch_root(); }

 private:
  class FaultyStaging;
  BlobStore& inner_;
  unsigned appends_left_ = 0;
  bool fail_commit_ = false;
  bool fail_remove_ = false;
};

/// Code of the Error that `act` throws; nothing when it returns.
std::optional<ErrorCode> error_of(const std::function<void()>& act);

/// Runs `act` in a child process with a real file system of 2 (or more) MiB, and expects it to return "", else what
/// went wrong. Skips the test where the process may not mount one.
void on_a_small_disk(const std::function<std::string(const std::filesystem::path& disk)>& act, unsigned mib = 2);

/// Takes all that is left of a disk, as somebody else might, by a file there.
void fill_disk(const std::filesystem::path& file);

}  // namespace spherule::server::test
