// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/machine_memory.h"

#include <algorithm>
#include <fstream>
#include <initializer_list>
#include <limits>
#include <string>
#include <string_view>

namespace spherule::server {

namespace {

namespace fs = std::filesystem;

constexpr std::uint64_t kNone = std::numeric_limits<std::uint64_t>::max();

std::uint64_t limit_in(const fs::path& file) {
  std::uint64_t bytes = 0;
  std::ifstream stream(file);
  return stream >> bytes && bytes > 0 ? bytes : kNone;
}

// The least limit of a group and of all above it. Where the hierarchy is mounted for one container, groups of the path
// that are not there are outside of it, and the mount itself is the container's.
std::uint64_t limit_of(const fs::path& hierarchy, const std::string& group, std::initializer_list<const char*> files) {
  std::uint64_t least = kNone;
  fs::path inside = fs::path(group).lexically_normal().relative_path();
  if (inside.has_relative_path() && *inside.begin() == "..") inside.clear();
  for (;; inside = inside.parent_path()) {
    for (const char* file : files) least = std::min(least, limit_in(hierarchy / inside / file));
    if (inside.empty()) return least;
  }
}

bool names_memory(std::string_view controllers) {
  return ("," + std::string(controllers) + ",").find(",memory,") != std::string::npos;
}

std::uint64_t limit_of_groups(const fs::path& root) {
  const fs::path mounts = root / "sys/fs/cgroup";
  std::uint64_t least = kNone;
  std::ifstream groups(root / "proc/self/cgroup");
  for (std::string line; std::getline(groups, line);) {
    // hierarchy:controllers:group
    const std::size_t first = line.find(':'), second = line.find(':', first + 1);
    if (first == std::string::npos || second == std::string::npos) continue;
    const std::string controllers = line.substr(first + 1, second - first - 1), group = line.substr(second + 1);
    if (controllers.empty()) least = std::min(least, limit_of(mounts, group, {"memory.max", "memory.high"}));
    if (names_memory(controllers))
      least = std::min(least, limit_of(mounts / "memory", group, {"memory.limit_in_bytes"}));
  }
  return least;
}

std::uint64_t memory_of_machine(const fs::path& root) {
  std::ifstream stream(root / "proc/meminfo");
  for (std::string word; stream >> word;) {
    std::uint64_t kib = 0;
    if (word == "MemTotal:" && stream >> kib) return kib << 10;
  }
  return kNone;
}

}  // namespace

std::uint64_t memory_there_is(const fs::path& root) {
  const std::uint64_t least = std::min(memory_of_machine(root), limit_of_groups(root));
  return least == kNone ? std::uint64_t{4} << 30 : least;
}

}  // namespace spherule::server
