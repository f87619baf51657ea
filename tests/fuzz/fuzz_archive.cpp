// SPDX-License-Identifier: GPL-3.0-or-later
//
// Zip archives: within their limits, and files with plain names only.
#include <sys/mman.h>
#include <unistd.h>

#include <cstdint>
#include <cstdlib>
#include <string>

#include "core/base/error.h"
#include "server/intake/archive.h"

namespace {

void require(bool holds) {
  if (!holds) std::abort();
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace spherule;
  const int descriptor = memfd_create("jane-doe", MFD_CLOEXEC);
  require(descriptor >= 0 && ::write(descriptor, data, size) == static_cast<ssize_t>(size));
  const server::Blob archive(descriptor, "/proc/self/fd/" + std::to_string(descriptor), {});
  const server::ArchiveLimits limits{.unpacked_bytes = 1 << 20, .files = 16, .ratio = 1000};
  std::size_t files = 0, bytes = 0;
  try {
    server::unpack_zip(
        archive, limits,
        [&](std::string_view name) {
          require(!name.empty() && name.find_first_of("/\\") == std::string_view::npos && name != "..");
          ++files;
        },
        [&](std::string_view piece) {
          require(files > 0);
          bytes += piece.size();
        });
    require(files <= limits.files && bytes <= limits.unpacked_bytes);
  } catch (const Error& error) {
    const std::string sentence = error.what();
    require(sentence.ends_with('.') && sentence.find("jane") == std::string::npos &&
            sentence.find("/proc") == std::string::npos);
  }
  return 0;
}
