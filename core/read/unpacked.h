// SPDX-License-Identifier: GPL-3.0-or-later
//
// The bytes of a file, unpacked by zlib or libbz2 or read from digits. Private to core/read; ByteReader (read_bytes.h)
// says what is thrown.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>

#include "core/base/context.h"
#include "core/volume.h"

namespace spherule {

/// How the bytes of a file stand for others.
enum class Packing : std::uint8_t {
  none,
  deflate,  ///< gzip (one or more members) or one zlib stream; checksums are verified
  bzip2,    ///< one or more streams; checksums are verified
  hex,      ///< two digits a byte, blanks anywhere
  text      ///< decimal numbers with blanks or commas between; unpacks to samples in native byte order
};

/// Where a reader's bytes come from. One thread at a time.
class ByteSource {
 public:
  ByteSource() = default;
  virtual ~ByteSource() = default;
  ByteSource(const ByteSource&) = delete;
  ByteSource& operator=(const ByteSource&) = delete;
  /// Fills `into`; the number of bytes read, which is smaller only at the end.
  virtual std::size_t read(std::span<std::byte> into) = 0;
  /// Passes over `count` bytes; the number passed, which is smaller only at the end. Polls cancellation.
  virtual std::uint64_t skip(std::uint64_t count, const Context& context);
};

/// Size of a file. Throws not_found when it is missing or not a regular file.
std::uint64_t size_of_file(const std::filesystem::path& file);

/// From byte `offset` of the file itself; `type` is that of samples in text.
std::unique_ptr<ByteSource> open_unpacked(const std::filesystem::path& file, Packing packing, std::uint64_t offset,
                                          VoxelType type);

}  // namespace spherule
