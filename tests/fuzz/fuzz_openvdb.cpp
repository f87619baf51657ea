// SPDX-License-Identifier: GPL-3.0-or-later
//
// OpenVDB files. The library takes the length of a compressed block on trust and asks for that much memory before it
// looks whether the file goes on; std::bad_alloc is then the right answer, but the address sanitizer's own operator new
// ends the program instead of throwing it. Hence the ones below.
#include <new>

#include "tests/fuzz/volume_input.h"

void* operator new(std::size_t size) {
  constexpr std::size_t kMost = std::size_t{1} << 28;
  void* p = size <= kMost ? std::malloc(size == 0 ? 1 : size) : nullptr;
  if (!p) throw std::bad_alloc();
  return p;
}
void operator delete(void* p) noexcept { std::free(p); }
void operator delete(void* p, std::size_t) noexcept { std::free(p); }
void* operator new[](std::size_t size) { return operator new(size); }
void operator delete[](void* p) noexcept { std::free(p); }
void operator delete[](void* p, std::size_t) noexcept { std::free(p); }

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
