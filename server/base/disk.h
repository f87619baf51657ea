// SPDX-License-Identifier: GPL-3.0-or-later
//
// Folders of a disk, and what a power cut leaves of them.
#pragma once

#include <cstdint>
#include <filesystem>

namespace spherule::server {

/// The Error for a disk, or a quota, that has no room.
[[noreturn]] void throw_no_space();
/// The Error for a call of the system that failed on a file or folder of the server's.
[[noreturn]] void throw_storage(int error_number);

/// Makes the folder and its missing parents; they survive a power cut once this returns. Throws no_space.
void make_folder(const std::filesystem::path& folder);

/// Bytes that can still be stored on the disk of this folder, the reserve not counted: what the server leaves for the
/// catalogue, which must be able to delete, and to say that the disk is full. Throws corrupt when the disk cannot tell.
std::uint64_t free_bytes_at(const std::filesystem::path& folder);

/// Returns once what a file or folder holds survives a power cut. Throws no_space.
void sync_to_disk(const std::filesystem::path& path);

}  // namespace spherule::server
