// SPDX-License-Identifier: GPL-3.0-or-later
//
// Any bytes either are refused with an Error or give spheres that survive being written and read again.
#include <cstdint>
#include <cstdlib>

#include "core/base/error.h"
#include "core/write/export.h"

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  using namespace spherule;
  try {
    const auto spheres = spheres_from_npy({reinterpret_cast<const char*>(data), size}, {.max_spheres = 1000});
    if (spheres_from_npy(spheres_to_npy(spheres)) != spheres) std::abort();
  } catch (const Error&) {
  }
  return 0;
}
