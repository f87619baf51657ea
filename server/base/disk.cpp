// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/disk.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <cstdio>
#include <system_error>

#include "core/base/error.h"

namespace spherule::server {

namespace fs = std::filesystem;

namespace {

constexpr std::uint64_t reserve_bytes = std::uint64_t{64} << 20;

}  // namespace

[[noreturn]] void throw_no_space() {
  throw Error(ErrorCode::no_space, "The server's storage is full; delete what is no longer needed, or try later.");
}

[[noreturn]] void throw_storage(int error) {
  // EFBIG is a limit of the process or of the file system, EDQUOT one of the user: all mean that it does not fit.
  if (error == ENOSPC || error == EDQUOT || error == EFBIG) throw_no_space();
  if (error == EMFILE || error == ENFILE)
    throw Error(ErrorCode::busy, "The server has too many files open; try again in a moment.");
  throw Error(
      ErrorCode::corrupt,
      "The server cannot use its storage; its operator must check the data folder, its permissions and its disk.");
}

std::uint64_t free_bytes_at(const fs::path& folder) {
  struct statvfs status {};
  if (::statvfs(folder.c_str(), &status) != 0) throw_storage(errno);
  const std::uint64_t free = std::uint64_t{status.f_bavail} * status.f_frsize;
  return free > reserve_bytes ? free - reserve_bytes : 0;
}

File::File(const fs::path& path, int flags) : descriptor_(::open(path.c_str(), flags | O_CLOEXEC, 0600)) {
  if (descriptor_ < 0) throw_storage(errno);
}

File::~File() { ::close(descriptor_); }

void File::write(std::string_view bytes) const {
  while (!bytes.empty()) {
    const ssize_t put = ::write(descriptor_, bytes.data(), bytes.size());
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) throw_storage(errno);
    bytes.remove_prefix(static_cast<std::size_t>(put));
  }
}

void File::set_time(Time time) const {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(time);
  const timespec stamp{.tv_sec = seconds.time_since_epoch().count(),
                       .tv_nsec = std::chrono::nanoseconds(time - seconds).count()};
  const std::array<timespec, 2> both = {stamp, stamp};
  if (::futimens(descriptor_, both.data()) != 0) throw_storage(errno);
}

void File::sync() const {
  if (::fsync(descriptor_) != 0) throw_storage(errno);  // fdatasync would leave the time out
}

std::optional<Time> file_time(const fs::path& file) {
  struct stat status {};
  if (::stat(file.c_str(), &status) != 0) return std::nullopt;
  return Time(std::chrono::seconds(status.st_mtim.tv_sec) + std::chrono::microseconds(status.st_mtim.tv_nsec / 1000));
}

void write_durably(const fs::path& file, std::string_view bytes, Time time) {
  make_folder(file.parent_path());
  const fs::path draft = fs::path(file).replace_extension(".new");
  {
    const File fresh(draft, O_WRONLY | O_CREAT | O_TRUNC);
    fresh.write(bytes);
    fresh.set_time(time);
    fresh.sync();
  }
  move_durably(draft, file);
}

void move_durably(const fs::path& from, const fs::path& to) {
  make_folder(to.parent_path());
  if (::rename(from.c_str(), to.c_str()) != 0) {
    if (errno == ENOENT) return;
    throw_storage(errno);
  }
  sync_to_disk(to.parent_path());
}

void sync_to_disk(const fs::path& path) { File(path, O_RDONLY).sync(); }

void make_folder(const fs::path& folder) {
  std::error_code failed;
  if (fs::is_directory(folder, failed)) return;
  const fs::path parent = fs::absolute(folder).parent_path();
  make_folder(parent);
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) throw_storage(errno);  // scans are nobody else's business
  sync_to_disk(parent);
}

}  // namespace spherule::server
