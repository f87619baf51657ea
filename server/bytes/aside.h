// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where what cannot be used goes: out of service, into the folder damaged/ of the data folder, and never deleted.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <limits>
#include <string>
#include <string_view>

#include "server/base/clock.h"

namespace spherule::server {

/// The path in damaged/ that something of this name would have, taken or not. Slashes become underscores.
std::filesystem::path place_aside(const std::filesystem::path& data, std::string name);

/// Moves a file there (move_durably); a number follows its name where that is taken. Without effect when the file is
/// not there. Returns its new path. Not for two threads with one name.
std::filesystem::path set_aside(const std::filesystem::path& data, const std::filesystem::path& file,
                                const std::string& name);

/// Writes a text there, likewise (write_durably).
void set_text_aside(const std::filesystem::path& data, std::string_view text, const std::string& name);

/// What small stores of files know of the data folder that they are in.
struct Surroundings {
  /// What they count the age of their files by: Catalog::served() where there is a catalogue.
  std::function<Time()> served = now;
  /// What the disk still takes.
  std::function<std::uint64_t()> free_bytes = [] { return std::numeric_limits<std::uint64_t>::max(); };
  /// Takes a damaged file out of the folder, and tells the log.
  std::function<void(const std::filesystem::path& file)> set_aside;
};

}  // namespace spherule::server
