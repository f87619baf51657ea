// SPDX-License-Identifier: GPL-3.0-or-later
//
// NIfTI-1/2 headers, extensions and gzip streams, also of one frame of several.
#include "tests/fuzz/volume_input.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace spherule;
  static const fuzz::Folder folder;
  const auto files = folder.with(data, size);
  ReadOptions options = fuzz::options();
  fuzz::check_read(files, options);
  options.frame = 1;
  fuzz::check_read(files, options);
  return 0;
}
