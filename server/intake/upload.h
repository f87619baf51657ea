// SPDX-License-Identifier: GPL-3.0-or-later
//
// Files on their way from a request to the disk.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <vector>

#include "api/service.h"
#include "server/bytes/blob_store.h"
#include "server/intake/archive.h"

namespace spherule::server {

/// Streams every file to a staging file of the blob store; what is not committed vanishes with the object. Not thread
/// safe: one request writes it.
class FileUpload final : public api::Upload {
 public:
  struct File {
    std::string name;
    std::unique_ptr<Staging> staging;
  };

  /// Throws no_space where there is no room for so many bytes more.
  using CheckRoom = std::function<void(std::uint64_t bytes)>;

  /// Checks the room for `announced` bytes (0: unknown) before the first byte is taken, and while they come, as others
  /// may take of it; `limit` bytes are the most that a file may have. Throws what `room` throws, and no_space.
  FileUpload(BlobStore& blobs, std::uint64_t limit, std::uint64_t announced, CheckRoom room);

  void begin_file(std::string_view name) override;
  void write(std::string_view piece) override;

  /// When all that has arrived is one zip archive, puts its files in its place. Throws what unpack_zip() throws.
  void unpack(const ArchiveLimits& limits);

  /// What has arrived, ascending by name. Throws invalid_argument when that is nothing.
  std::vector<File>& files();

 private:
  BlobStore& blobs_;
  std::uint64_t limit_;
  CheckRoom room_;
  std::uint64_t since_look_ = 0;  // bytes
  std::unique_ptr<Staging> first_;
  std::vector<File> files_;
};

/// The bytes of a file without holding them in memory.
class Mapping {
 public:
  /// Throws corrupt when the file cannot be read.
  explicit Mapping(const Blob& blob);
  ~Mapping();
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  std::string_view text() const { return {static_cast<const char*>(data_), size_}; }

 private:
  void* data_ = nullptr;
  std::size_t size_;
};

}  // namespace spherule::server
