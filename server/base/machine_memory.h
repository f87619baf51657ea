// SPDX-License-Identifier: GPL-3.0-or-later
//
// How much memory the process can have: what the machine has, or less where a container or a service limits it.
#pragma once

#include <cstdint>
#include <filesystem>

namespace spherule::server {

/// Bytes: the least of the machine's memory (/proc/meminfo) and the limits of the control groups that the process is in
/// (/proc/self/cgroup), each with all groups above it: memory.max and memory.high of version 2, memory.limit_in_bytes
/// of version 1, at their usual places below /sys/fs/cgroup. "max", 0 and what cannot be read set no limit; 4 GiB when
/// nothing can be read. `root` is where proc/ and sys/ are. Linux, Documentation/admin-guide/cgroup-v2.rst.
std::uint64_t memory_there_is(const std::filesystem::path& root = "/");

}  // namespace spherule::server
