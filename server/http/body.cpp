// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/body.h"

#include <memory>
#include <string>

#include "core/base/error.h"
#include "server/http/encoding.h"
#include "server/http/multipart.h"

namespace spherule::server {

namespace {

struct Counted {
  std::uint64_t left;
  const api::Body::Take& take;
  void operator()(std::string_view piece) {
    if (piece.size() > left) {
      throw Error(ErrorCode::too_large, "The body is larger than this server accepts; send less.");
    }
    left -= piece.size();
    take(piece);
  }
};

}  // namespace

void HttpBody::check_announced(std::uint64_t limit) const {
  if (announced() <= limit) return;
  throw Error(ErrorCode::too_large,
              "The body is larger than the " + std::to_string(limit) + " bytes that this server accepts; send less.");
}

void HttpBody::read(std::uint64_t limit, const Take& take) {
  check_announced(limit);
  Counted counted{limit, take};
  const Encoding encoding = content_encoding(connection_.head().field("Content-Encoding"));
  const std::unique_ptr<Unpacker> unpacker = encoding == Encoding::identity ? nullptr : make_unpacker(encoding);
  std::uint64_t packed = 0;
  for (std::string_view piece; !(piece = connection_.read_body()).empty();) {
    if (!unpacker) {
      counted(piece);
      continue;
    }
    packed += piece.size();
    if (packed > limit) throw Error(ErrorCode::too_large, "The body is larger than this server accepts; send less.");
    unpacker->feed(piece, [&](std::string_view unpacked) { counted(unpacked); });
  }
  if (unpacker && !unpacker->ended()) {
    throw Error(ErrorCode::malformed, "The packed body is cut short; send it again whole.");
  }
}

void HttpBody::read_parts(std::uint64_t limit, const BeginPart& begin_part, const Take& take) {
  if (content_encoding(connection_.head().field("Content-Encoding")) != Encoding::identity) {
    throw Error(ErrorCode::unknown_format, "Send multipart bodies without Content-Encoding.");
  }
  check_announced(limit);
  MultipartReader form(connection_.head().field("Content-Type"));
  Counted counted{limit, take};
  std::uint64_t all = 0;
  for (std::string_view piece; !(piece = connection_.read_body()).empty();) {
    // As the announced length does: what is around the parts costs time, too.
    all += piece.size();
    if (all > limit) throw Error(ErrorCode::too_large, "The body is larger than this server accepts; send less.");
    form.feed(piece, begin_part, [&](std::string_view content) { counted(content); });
  }
  if (!form.ended())
    throw Error(ErrorCode::malformed, "The multipart body is cut short or malformed; send it again whole.");
}

}  // namespace spherule::server
