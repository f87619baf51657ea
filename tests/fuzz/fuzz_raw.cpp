// SPDX-License-Identifier: GPL-3.0-or-later
//
// Headerless samples: the first 64 bytes are the layout, the rest the file, gzip'ed or not.
#include <cstring>

#include "tests/fuzz/volume_input.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace spherule;
  static const fuzz::Folder folder;
  constexpr std::size_t kLayout = 64;
  if (size < kLayout) return 0;
  RawLayout layout;
  std::memcpy(layout.dims.data(), data, 12);
  layout.type = static_cast<VoxelType>(data[12] % 10);
  layout.big_endian = data[13] & 1;
  double numbers[6];
  std::memcpy(numbers, data + 16, sizeof numbers);
  layout.spacing = {numbers[0], numbers[1], numbers[2]};
  layout.origin = {numbers[3], numbers[4], numbers[5]};
  ReadOptions options = fuzz::options();
  options.raw = layout;
  fuzz::check_read({folder.with(data + kLayout, size - kLayout)[0]}, options);
  return 0;
}
