// SPDX-License-Identifier: GPL-3.0-or-later
//
// Packed bytes for tests.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

namespace spherule::test {

/// One gzip member (RFC 1952), and what one holds.
std::string gzip(const std::string& bytes);
std::string gunzip(const std::string& bytes);

struct ZipEntry {
  std::string name, bytes;
  bool deflated = false;
  std::uint32_t mode = 0100644;  ///< of Unix
  std::uint16_t flags = 0x0800;  ///< names are UTF-8
};
/// A zip archive of these files, in this order.
std::string zip(const std::vector<ZipEntry>& entries);

}  // namespace spherule::test
