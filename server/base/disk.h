// SPDX-License-Identifier: GPL-3.0-or-later
//
// Files and folders of a disk, and what a power cut leaves of them: of a file, what was written before its last sync();
// of a folder, the names that it had when it was last synchronised. All that the stores promise to keep they keep by
// the functions here, which throw what throw_storage() makes of the system's refusal.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <string_view>

#include "server/base/clock.h"

namespace spherule::server {

/// The Error for a disk, or a quota, that has no room.
[[noreturn]] void throw_no_space();
/// The Error for a call of the system that failed on a file or folder of the server's: no_space when it did not fit,
/// busy when too many files are open, else corrupt.
[[noreturn]] void throw_storage(int error_number);

/// An open file, closed by the destructor. One thread at a time.
class File {
 public:
  /// `flags` are those of open(2); what is made is for its owner's eyes only.
  File(const std::filesystem::path& path, int flags);
  ~File();
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  /// For system calls that take one.
  [[nodiscard]] int descriptor() const { return descriptor_; }

  /// Writes all of it; when it throws, perhaps some.
  void write(std::string_view bytes) const;
  /// Gives it the time that file_time() tells.
  void set_time(Time time) const;
  /// Returns once its bytes and its time survive a power cut. Its name is the folder's.
  void sync() const;

 private:
  int descriptor_;
};

/// The time that a file bears, which the stores set to the time of service; nothing when the file is not there.
std::optional<Time> file_time(const std::filesystem::path& file);

/// Makes a file of these bytes and this time, or puts it in place of the one that has its name: whole or not at all,
/// and durable when it returns, with its folder, which is made if needed. Its draft ends in `.new` instead; one that is
/// left of a crash is written over.
void write_durably(const std::filesystem::path& file, std::string_view bytes, Time time);

/// Moves a file, whose bytes are durable, to a folder of the same disk, which is made if needed, and is durable there
/// when it returns; a power cut may leave it in its old place as well. Without effect when it is not there.
void move_durably(const std::filesystem::path& from, const std::filesystem::path& to);

/// Makes the folder and its missing parents; they survive a power cut once this returns.
void make_folder(const std::filesystem::path& folder);

/// Returns once what a file or folder holds survives a power cut.
void sync_to_disk(const std::filesystem::path& path);

/// Bytes that can still be stored on the disk of this folder, the reserve not counted: what the server leaves for the
/// catalogue, which must be able to delete, and to say that the disk is full. Throws corrupt when the disk cannot tell.
std::uint64_t free_bytes_at(const std::filesystem::path& folder);

}  // namespace spherule::server
