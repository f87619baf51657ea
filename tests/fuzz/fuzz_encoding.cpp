// SPDX-License-Identifier: GPL-3.0-or-later
//
// Packed bodies (gzip, zstd), in pieces as a network brings them, and the headers about encodings. What unpacks packs
// to something that unpacks to the same.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "core/base/error.h"
#include "server/http/encoding.h"

namespace {

using namespace spherule;
using server::Encoding;

constexpr std::size_t kMost = 1 << 20;

struct Enough {};

std::string unpacked(Encoding encoding, std::string_view packed, std::size_t piece) {
  std::string out;
  const auto unpacker = server::make_unpacker(encoding);
  while (!packed.empty()) {
    const std::string_view next = packed.substr(0, piece);
    packed.remove_prefix(next.size());
    unpacker->feed(next, [&](std::string_view bytes) {
      out += bytes;
      if (out.size() > kMost) throw Enough();
    });
  }
  if (!unpacker->ended()) throw Error(ErrorCode::malformed, "Cut short.");
  return out;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 2) return 0;
  const std::string_view rest(reinterpret_cast<const char*>(data) + 2, size - 2);
  if (data[0] % 4 == 0) {
    static_cast<void>(server::preferred_encoding(rest));
    static_cast<void>(server::plain_tags(std::string(rest)));
    try {
      static_cast<void>(server::content_encoding(rest));
    } catch (const Error&) {
    }
    return 0;
  }
  const Encoding encoding = data[0] % 2 == 0 ? Encoding::gzip : Encoding::zstd;
  const std::size_t piece = std::size_t{data[1]} + 1;
  try {
    const std::string plain = unpacked(encoding, rest, piece);
    const auto packer = server::make_packer(encoding);
    std::string packed = packer->feed(std::string_view(plain).substr(0, plain.size() / 2), false);
    packed += packer->feed(std::string_view(plain).substr(plain.size() / 2), true);
    if (unpacked(encoding, packed, packed.size() + 1) != plain) std::abort();
  } catch (const Error&) {
  } catch (const Enough&) {
  }
  return 0;
}
