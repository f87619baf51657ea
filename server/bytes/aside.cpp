// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/aside.h"

#include <sys/stat.h>

#include <algorithm>
#include <array>
#include <fstream>
#include <system_error>

#include "core/base/error.h"
#include "server/base/disk.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;

[[noreturn]] void throw_unwritable() {
  throw Error(ErrorCode::no_space, "The folder cannot be written; check its disk's space and its permissions.");
}

fs::path free_place(const fs::path& data, const std::string& name) {
  const fs::path first = place_aside(data, name);
  fs::path place = first;
  for (int i = 1; fs::exists(place); ++i) place = first.native() + "." + std::to_string(i);
  make_folder(place.parent_path());
  return place;
}

}  // namespace

fs::path place_aside(const fs::path& data, std::string name) {
  std::ranges::replace(name, '/', '_');
  return data / "damaged" / name;
}

fs::path set_aside(const fs::path& data, const fs::path& file, const std::string& name) {
  fs::path place = free_place(data, name);
  std::error_code failed;
  fs::rename(file, place, failed);
  if (failed && failed != std::errc::no_such_file_or_directory) throw_unwritable();
  return place;
}

void set_text_aside(const fs::path& data, std::string_view text, const std::string& name) {
  const fs::path place = free_place(data, name);
  std::ofstream file(place, std::ios::binary);
  file << text;
  file.close();
  if (!file) throw_unwritable();
  fs::permissions(place, fs::perms::owner_read | fs::perms::owner_write);
  sync_to_disk(place);
}

std::optional<Time> file_time(const fs::path& file) {
  struct stat status {};
  if (::stat(file.c_str(), &status) != 0) return std::nullopt;
  return Time(std::chrono::seconds(status.st_mtim.tv_sec) + std::chrono::microseconds(status.st_mtim.tv_nsec / 1000));
}

bool set_file_time(int descriptor, Time time) {
  const auto seconds = std::chrono::floor<std::chrono::seconds>(time);
  const timespec stamp{.tv_sec = seconds.time_since_epoch().count(),
                       .tv_nsec = std::chrono::nanoseconds(time - seconds).count()};
  const std::array<timespec, 2> both = {stamp, stamp};
  return ::futimens(descriptor, both.data()) == 0;
}

}  // namespace spherule::server
