// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where bytes are kept: the one seam between the server and a file system. Blobs are immutable, written in full or not
// at all, and checked against their digest when read. What a blob means is the catalogue's business.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/bytes/staging.h"

namespace spherule::server {

/// All functions are thread safe. A key is what Staging::commit returned; callers keep it (in the catalogue) and read
/// nothing into it.
class BlobStore {
 public:
  virtual ~BlobStore() = default;

  /// Begins a blob of at most `limit` bytes. With `declared` (a Content-Length), refuses before the first byte:
  /// too_large over the limit, no_space when the disk would have less than a small reserve left.
  [[nodiscard]] virtual std::unique_ptr<Staging> stage(std::uint64_t limit,
                                                       std::optional<std::uint64_t> declared = {}) = 0;

  /// Throws not_found for a key that has no blob.
  [[nodiscard]] virtual Blob open(const std::string& key) const = 0;

  /// Without effect when there is no such blob. Open Blobs stay readable.
  virtual void remove(const std::string& key) = 0;

  // A blob that has no owner may be one on its way in or out, or one whose owner was lost. These tell them apart after
  // the process has ended between two steps.

  /// Keys of blobs that were on their way: committed and not settled yet, or unsettled and not removed yet.
  [[nodiscard]] virtual std::vector<std::string> unsettled() const = 0;
  /// The blob has an owner now, which is on the disk.
  virtual void settle(const std::string& key) = 0;
  /// The blobs are about to lose their owners, and to be removed; survives a power cut. Best effort, so that a full
  /// disk stops no deletion.
  virtual void unsettle(const std::vector<std::string>& keys) = 0;

  /// Every committed key, in no particular order.
  [[nodiscard]] virtual std::vector<std::string> keys() const = 0;

  /// Bytes that can still be stored, the reserve not counted.
  [[nodiscard]] virtual std::uint64_t free_bytes() const = 0;

  /// Where ScratchFolders of this store belong.
  [[nodiscard]] virtual std::filesystem::path scratch_root() const = 0;

  /// Stores bytes that are already in memory; see Staging::commit.
  [[nodiscard]] std::string put(std::string_view name, std::string_view bytes);

  /// open(key).read().
  [[nodiscard]] std::string read(const std::string& key) const { return open(key).read(); }
};

/// Blobs as files under `root`, which is made if needed. Commit: fsync of the file, rename, fsync of the folder.
/// The digest is part of the key, hence of the file's name, so contents are plain and usable by any reader.
/// Opening the store removes what a killed process left half-written; the caller must be the only one that uses
/// `root` (open the Catalog first: it holds the lock). Every write, announced or not, leaves the reserve of the disk
/// alone, and throws no_space before that.
class FileBlobStore final : public BlobStore {
 public:
  explicit FileBlobStore(std::filesystem::path root);

  /// The keys of the blobs under `root`, without opening it as a store.
  static std::vector<std::string> keys_in(const std::filesystem::path& root);

  std::unique_ptr<Staging> stage(std::uint64_t limit, std::optional<std::uint64_t> declared = {}) override;
  Blob open(const std::string& key) const override;
  void remove(const std::string& key) override;
  std::vector<std::string> keys() const override { return keys_in(root_); }
  std::vector<std::string> unsettled() const override;
  void settle(const std::string& key) override;
  void unsettle(const std::vector<std::string>& keys) override;
  std::uint64_t free_bytes() const override;
  std::filesystem::path scratch_root() const override;

 private:
  std::filesystem::path root_;
};

}  // namespace spherule::server
