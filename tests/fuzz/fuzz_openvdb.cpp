// SPDX-License-Identifier: GPL-3.0-or-later
//
// OpenVDB files: the first scalar grid, and one chosen by name.
#include "tests/fuzz/volume_input.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace spherule;
  static const fuzz::Folder folder;
  const auto files = folder.with(data, size);
  ReadOptions options = fuzz::options();
  fuzz::check_read(files, options);
  options.grid = "b";
  fuzz::check_read(files, options);
  return 0;
}
