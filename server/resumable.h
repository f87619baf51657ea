// SPDX-License-Identifier: GPL-3.0-or-later
//
// Uploads that come in pieces and survive what breaks between them: a connection, a client, this process.
//
// Each is two files in one folder: `<id>.part`, whose size is the offset to go on from, and `<id>.info`, three lines:
// the announced length, the file's name, and when it was begun.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <mutex>
#include <set>
#include <string>
#include <string_view>

#include "api/service.h"

namespace spherule::server {

/// Thread safe. Every function throws not_found for an id that is unknown or expired.
class ResumableUploads {
 public:
  /// Makes the folder if needed. An upload expires when nothing was added to it for `keep`. At most `limit` bytes each,
  /// and `most` at once.
  ResumableUploads(std::filesystem::path folder, std::uint64_t limit, std::chrono::seconds keep,
                   std::size_t most = 1000);

  /// Durable when it returns. Throws too_large over the limit, busy when there are too many, no_space.
  api::UploadInfo create(std::uint64_t length, std::string_view filename);
  api::UploadInfo find(const std::string& id) const;

  using Take = std::function<void(std::string_view piece)>;
  /// Appends what `feed` hands on. All that has arrived is kept, durable, also when `feed` throws (which comes out
  /// here). Throws conflict when `offset` is not the upload's or another append is under way, too_large for more bytes
  /// than were announced.
  api::UploadInfo append(const std::string& id, std::uint64_t offset, const std::function<void(const Take&)>& feed);

  /// Hands on all bytes of an upload, in order. Throws conflict while some are missing.
  void read(const std::string& id, const Take& take) const;

  /// Throws conflict while something is being appended.
  void remove(const std::string& id);

 private:
  class Busy;
  std::filesystem::path part(const std::string& id) const;
  std::filesystem::path info(const std::string& id) const;
  void sweep();

  const std::filesystem::path folder_;
  const std::uint64_t limit_;
  const std::chrono::seconds keep_;
  const std::size_t most_;
  mutable std::mutex mutex_;
  std::set<std::string> busy_;  // appended to just now
};

}  // namespace spherule::server
