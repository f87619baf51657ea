// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/aside.h"

#include <algorithm>

#include "server/base/disk.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;

fs::path free_place(const fs::path& data, const std::string& name) {
  const fs::path first = place_aside(data, name);
  fs::path place = first;
  for (int i = 1; fs::exists(place); ++i) place = first.native() + "." + std::to_string(i);
  return place;
}

}  // namespace

fs::path place_aside(const fs::path& data, std::string name) {
  std::ranges::replace(name, '/', '_');
  return data / "damaged" / name;
}

fs::path set_aside(const fs::path& data, const fs::path& file, const std::string& name) {
  fs::path place = free_place(data, name);
  move_durably(file, place);
  return place;
}

void set_text_aside(const fs::path& data, std::string_view text, const std::string& name) {
  write_durably(free_place(data, name), text, now());
}

}  // namespace spherule::server
