// SPDX-License-Identifier: GPL-3.0-or-later
//
// Packed bytes for tests.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

namespace spherule::test {

/// A zlib stream (RFC 1950); one gzip member (RFC 1952), and what one holds.
std::string zlib_stream(std::string_view bytes);
std::string gzip(std::string_view bytes);
std::string gunzip(const std::string& bytes);

/// One bzip2 stream.
std::string bzip2(std::string_view bytes);

struct ZipEntry {
  std::string name, bytes;
  bool deflated = false;
  std::uint32_t mode = 0100644;  ///< of Unix
  std::uint16_t flags = 0x0800;  ///< names are UTF-8
};
/// A zip archive of these files, in this order.
std::string zip(const std::vector<ZipEntry>& entries);

}  // namespace spherule::test
