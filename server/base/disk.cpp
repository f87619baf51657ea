// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/disk.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <sys/statvfs.h>
#include <unistd.h>

#include <cerrno>
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

void sync_to_disk(const fs::path& path) {
  const int descriptor = ::open(path.c_str(), O_RDONLY | O_CLOEXEC);
  if (descriptor < 0) throw_storage(errno);
  const int result = ::fsync(descriptor);
  const int error = errno;
  ::close(descriptor);
  if (result != 0) throw_storage(error);
}

void make_folder(const fs::path& folder) {
  std::error_code failed;
  if (fs::is_directory(folder, failed)) return;
  const fs::path parent = fs::absolute(folder).parent_path();
  make_folder(parent);
  if (::mkdir(folder.c_str(), 0700) != 0 && errno != EEXIST) throw_storage(errno);  // scans are nobody else's business
  sync_to_disk(parent);
}

}  // namespace spherule::server
