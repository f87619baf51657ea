// SPDX-License-Identifier: GPL-3.0-or-later
//
// Zip archives as uploads: a DICOM series, a header with its data.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>

#include "server/bytes/staging.h"

namespace spherule::server {

struct ArchiveLimits {
  std::uint64_t unpacked_bytes = 0;  ///< of all files together
  std::size_t files = 4096;          ///< folders do not count
  std::uint64_t ratio = 1000;        ///< unpacked to packed, beyond the first 16 MiB: deflate ends at 1032
};

/// Whether bytes that start like this are a zip archive.
bool is_zip(std::string_view first_bytes);

/// Hands on the files of a zip archive, in its order, piece by piece: nothing is held whole. Names come without their
/// folders. Folders, and what operating systems add beside the files (__MACOSX, ._*, .DS_Store, Thumbs.db), are left
/// out. Throws malformed for what is damaged or encrypted, invalid_argument for names that leave the archive's folder
/// ("..", absolute) or are empty, and for what is no plain file (links), too_large over a limit.
void unpack_zip(const Blob& archive, const ArchiveLimits& limits,
                const std::function<void(std::string_view name)>& begin_file,
                const std::function<void(std::string_view piece)>& take);

}  // namespace spherule::server
