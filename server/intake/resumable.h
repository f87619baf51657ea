// SPDX-License-Identifier: GPL-3.0-or-later
//
// Uploads that come in pieces and survive what breaks between them: a connection, a client, this process.
//
// Each is two files in one folder: `<id>.part`, whose size is the offset to go on from and whose time is the time of
// service at which it last grew, and `<id>.info`, three lines: the announced length, the file's name, and when it was
// begun, whose time is the time of service of that. The latter comes last and, when an upload is removed, goes last:
// one without the other is a leftover. A power cut may bring back an upload that was just removed.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <mutex>
#include <set>
#include <string>
#include <string_view>
#include <vector>

#include "api/service.h"
#include "server/bytes/aside.h"

namespace spherule::server {

/// Thread safe. Every function throws not_found for an id that is unknown or expired, and all but remove() corrupt for
/// an upload whose record is damaged: the next sweep sets that aside.
class ResumableUploads final : public api::PartialUploads {
 public:
  /// Makes the folder if needed. An upload expires when nothing was added to it for `keep`. At most `limit` bytes each,
  /// and `most` at once.
  ResumableUploads(std::filesystem::path folder, std::uint64_t limit, std::chrono::seconds keep,
                   std::size_t most = 1000, Surroundings around = {});

  /// Throws no_space when the disk has no room for so many bytes beside what the unfinished uploads lack. For whoever
  /// writes to the same disk. O(uploads).
  void check_room(std::uint64_t bytes) const;

  /// Durable when it returns. Throws too_large over the limit, busy when there are too many, what check_room() throws.
  api::UploadInfo create(std::uint64_t length, std::string_view filename) override;
  api::UploadInfo find(const std::string& id) const override;

  /// Appends what `feed` hands on. All that has arrived is kept, durable, also when `feed` throws (which comes out
  /// here). Throws conflict when `offset` is not the upload's or another append is under way, too_large for more bytes
  /// than were announced.
  api::UploadInfo append(const std::string& id, std::uint64_t offset,
                         const std::function<void(const TakeBytes&)>& feed) override;

  /// Hands on all bytes of an upload, in order. Throws conflict while some are missing.
  void read(const std::string& id, const TakeBytes& take) const override;

  /// Throws conflict while something is being appended.
  void remove(const std::string& id) override;

 private:
  class Busy;
  std::filesystem::path part(const std::string& id) const;
  std::filesystem::path info(const std::string& id) const;
  std::vector<std::string> ids() const;
  std::uint64_t missing_bytes() const;
  void sweep();

  const std::filesystem::path folder_;
  const std::uint64_t limit_;
  const std::chrono::seconds keep_;
  const std::size_t most_;
  const Surroundings around_;
  std::mutex creating_;  // one looks at the room that is left, and takes of it, at a time
  mutable std::mutex mutex_;
  std::set<std::string> busy_;  // made, appended to or removed just now
};

/// Whether an .info file says what it should.
bool is_sound_upload(std::string_view info);

}  // namespace spherule::server
