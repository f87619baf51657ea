// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/body.h"

#include <algorithm>
#include <charconv>
#include <utility>

#include "core/base/error.h"
#include "server/http/encoding.h"

namespace spherule::server {

namespace {

// What an unread rest of a body may cost before the connection is closed instead.
constexpr std::uint64_t kDrainBytes = 1 << 20;

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

// The library takes everything after "boundary=" for the boundary.
std::string plain_multipart(const std::string& type) {
  std::string boundary;
  if (const std::size_t at = type.find("boundary="); at != std::string::npos) {
    boundary = type.substr(at + 9);
    const bool quoted = boundary.starts_with('"');
    boundary =
        quoted ? boundary.substr(1, boundary.find('"', 1) - 1) : boundary.substr(0, boundary.find_first_of("; "));
  }
  if (boundary.empty()) {
    throw Error(ErrorCode::malformed, "Give the boundary of the multipart body in its Content-Type.");
  }
  return "multipart/form-data; boundary=" + boundary;
}

}  // namespace

Framing framing(const httplib::Request& request) {
  const auto refuse = [] {
    return Error(ErrorCode::malformed, "Send one Content-Length, or Transfer-Encoding: chunked, and not both.");
  };
  const std::size_t lengths = request.get_header_value_count("Content-Length");
  if (request.has_header("Transfer-Encoding")) {
    std::string coding = request.get_header_value("Transfer-Encoding");
    std::ranges::transform(coding, coding.begin(), [](unsigned char c) { return std::tolower(c); });
    // The library does not read the chunked body of a DELETE.
    if (coding != "chunked" || lengths > 0 || request.get_header_value_count("Transfer-Encoding") > 1 ||
        request.method == "DELETE") {
      throw refuse();
    }
    return {true, 0};
  }
  if (lengths == 0) return {};
  const std::string text = request.get_header_value("Content-Length");
  std::uint64_t length = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), length);
  if (lengths > 1 || error != std::errc{} || end != text.data() + text.size()) throw refuse();
  return {length > 0, length};
}

HttpBody::HttpBody(httplib::Request& request, const httplib::ContentReader* reader, const std::atomic<bool>& stopping)
    : request_(request), reader_(reader), stopping_(stopping), framing_(framing(request)) {
  // The library goes by these two to decide how to read.
  encoding_ = request.get_header_value("Content-Encoding");
  type_ = request.get_header_value("Content-Type");
  request.headers.erase("Content-Encoding");
  request.headers.erase("Content-Type");
}

template <typename F>
bool HttpBody::guarded(F&& f) {
  try {
    if (stopping_) throw Error(ErrorCode::busy, "The server is stopping; try again later.");
    f();
    return true;
  } catch (...) {
    error_ = std::current_exception();
    return false;
  }
}

void HttpBody::begin(std::uint64_t limit) {
  if (framing_.announced > limit) {
    throw Error(ErrorCode::too_large,
                "The body is larger than the " + std::to_string(limit) + " bytes that this server accepts; send less.");
  }
  begun_ = true;
}

void HttpBody::conclude(const char* cut) {
  if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
  if (!finished_) throw Error(ErrorCode::malformed, cut);
}

void HttpBody::receive(const Take& take) {
  if (!framing_.present) return;
  finished_ = (*reader_)([&](const char* data, std::size_t size) { return guarded([&] { take({data, size}); }); });
  conclude("The body is cut short; send it again whole.");
}

void HttpBody::read(std::uint64_t limit, const Take& take) {
  begin(limit);
  Counted counted{limit, take};
  const Encoding encoding = content_encoding(encoding_);
  if (encoding == Encoding::identity) {
    receive([&](std::string_view piece) { counted(piece); });
    return;
  }
  const std::unique_ptr<Unpacker> unpacker = make_unpacker(encoding);
  Counted packed{limit, [&](std::string_view piece) {
                   unpacker->feed(piece, [&](std::string_view unpacked) { counted(unpacked); });
                 }};
  receive([&](std::string_view piece) { packed(piece); });
  if (!unpacker->ended()) {
    throw Error(ErrorCode::malformed, "The packed body is cut short; send it again whole.");
  }
}

void HttpBody::read_parts(std::uint64_t limit, const BeginPart& begin_part, const Take& take) {
  if (content_encoding(encoding_) != Encoding::identity) {
    throw Error(ErrorCode::unknown_format, "Send multipart bodies without Content-Encoding.");
  }
  begin(limit);
  request_.headers.emplace("Content-Type", plain_multipart(type_));
  Counted counted{limit, take};
  finished_ = (*reader_)(
      [&](const httplib::MultipartFormData& part) { return guarded([&] { begin_part(part.name, part.filename); }); },
      [&](const char* data, std::size_t size) { return guarded([&] {
                                                  counted({data, size});
                                                }); });
  request_.headers.erase("Content-Type");
  conclude("The multipart body is cut short or malformed; send it again whole.");
}

void HttpBody::drain() {
  if (finished() || begun_ || reader_ == nullptr || framing_.announced > kDrainBytes) return;
  std::uint64_t rest = kDrainBytes;
  begun_ = true;
  finished_ = (*reader_)([&](const char*, std::size_t size) {
    if (size > rest || stopping_) return false;
    rest -= size;
    return true;
  });
}

}  // namespace spherule::server
