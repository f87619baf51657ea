// SPDX-License-Identifier: GPL-3.0-or-later
//
// Heads, chunks and forms as strangers send them. What is read does not depend on how the bytes are cut, keeps to its
// budget, and never leaves open where a head ends.
#include <algorithm>
#include <cstdint>
#include <cstdlib>
#include <string>

#include "core/base/error.h"
#include "server/http/framing.h"
#include "server/http/head.h"
#include "server/http/multipart.h"

namespace {

using namespace spherule;
using namespace spherule::server;

void require(bool holds) {
  if (!holds) std::abort();
}

// Heads and bodies of one connection, as text; up to the first refusal, or the end.
std::string read_all(std::string_view bytes, std::size_t piece) {
  std::string seen;
  HeadReader reader({.bytes = 2000, .fields = 10, .target = 500});
  BodyFraming framing;
  while (!bytes.empty()) {
    std::string_view next = bytes.substr(0, piece);
    bytes.remove_prefix(next.size());
    while (!next.empty()) {
      if (!framing.finished()) {
        const BodyFraming::Step step = framing.next(next);
        if (framing.bad()) return seen + "|bad";
        require(step.taken > 0 && step.taken <= next.size());
        seen += step.content;
        next.remove_prefix(step.taken);
        continue;
      }
      next.remove_prefix(reader.feed(next));
      if (reader.refusal()) return seen + "|refused " + std::to_string(reader.refusal()->status);
      if (!reader.complete()) {
        require(next.empty());
        continue;
      }
      const Head head = reader.take();
      seen += head.method + " " + head.target;
      for (const auto& [name, value] : head.fields) {
        require(value.find_first_of(std::string_view("\r\n\0", 3)) == std::string::npos);
        seen += "|" + name + ":" + value;
      }
      require(!(head.chunked && head.length > 0));
      require(head.version_1_0 || host_name(head.field("Host")));
      static_cast<void>(parse_target(head.target));
      framing = BodyFraming(head);
    }
  }
  return seen;
}

std::string read_form(std::string_view bytes, std::size_t piece) {
  std::string seen;
  try {
    MultipartReader reader("multipart/form-data; boundary=b");
    for (; !bytes.empty(); bytes.remove_prefix(std::min(piece, bytes.size()))) {
      reader.feed(
          bytes.substr(0, piece),
          [&](std::string_view name, std::string_view filename) {
            seen += "[" + std::string(name) + "," + std::string(filename) + "]";
          },
          [&](std::string_view content) { seen += content; });
    }
    return seen + (reader.ended() ? "|ended" : "");
  } catch (const Error&) {
    return "|malformed";
  }
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  if (size < 1) return 0;
  const std::string_view bytes(reinterpret_cast<const char*>(data) + 1, size - 1);
  const std::size_t piece = std::size_t{data[0]} % 64 + 1;
  if (data[0] >= 192) {
    require(read_form(bytes, piece) == read_form(bytes, bytes.size() + 1));
  } else {
    require(read_all(bytes, piece) == read_all(bytes, bytes.size() + 1));
  }
  return 0;
}
