// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/reply.h"

#include <algorithm>
#include <chrono>
#include <memory>

#include "server/http/connections.h"
#include "server/http/encoding.h"

namespace spherule::server {

using api::Response;

namespace {

constexpr std::size_t kPieceBytes = 1 << 18;
constexpr std::size_t kWorthCompressing = 1024;

// Writes text and, when the connection is to be closed, fails: then the library closes it.
void set_text(httplib::Response& response, std::string text, const std::string& type, const Close& close) {
  if (!close) {
    response.set_content(text, type);
    return;
  }
  const std::size_t size = text.size();
  response.set_content_provider(size, type,
                                [text = std::move(text), close](std::size_t, std::size_t, httplib::DataSink& sink) {
                                  sink.write(text.data(), text.size());
                                  close();
                                  return false;
                                });
}

// A content provider cannot throw. When it fails it is too late to say why: the connection is closed before the end
// that was announced, which tells the client.
template <typename F>
bool succeeds(F&& f) {
  try {
    return f();
  } catch (...) {
    return false;
  }
}

void set_part(httplib::Response& response, api::ContentPart&& given, const std::string& type) {
  const auto part = std::make_shared<const api::ContentPart>(std::move(given));
  response.set_content_provider(part->length, type,
                                [part](std::size_t offset, std::size_t length, httplib::DataSink& sink) {
                                  return succeeds([&] {
                                    Connection* connection = Connection::current();
                                    if (connection != nullptr && part->content.file >= 0) {
                                      connection->take_from_file(part->content.file, part->offset + offset);
                                      return sink.write(nullptr, length);
                                    }
                                    std::string piece(std::min(length, kPieceBytes), '\0');
                                    const std::size_t n = part->content.read_at(part->offset + offset, piece);
                                    return n > 0 && sink.write(piece.data(), n);
                                  });
                                });
}

void set_packed_part(httplib::Response& response, api::ContentPart&& given, const std::string& type,
                     Encoding encoding) {
  struct Stream {
    api::ContentPart part;
    std::unique_ptr<Packer> packer;
    std::uint64_t at = 0;
  };
  const auto stream = std::make_shared<Stream>(std::move(given), make_packer(encoding));
  response.set_chunked_content_provider(type, [stream](std::size_t, httplib::DataSink& sink) {
    return succeeds([&] {
      std::string piece(std::min<std::uint64_t>(kPieceBytes, stream->part.length - stream->at), '\0');
      const std::size_t n = stream->part.content.read_at(stream->part.offset + stream->at, piece);
      if (n == 0) return false;
      stream->at += n;
      const bool last = stream->at == stream->part.length;
      const std::string packed = stream->packer->feed({piece.data(), n}, last);
      const bool good = packed.empty() || sink.write(packed.data(), packed.size());
      if (last) sink.done();
      return good;
    });
  });
}

}  // namespace

// Takes in what the client still sends, for a while: a socket closed with unread bytes makes the client's side drop the
// answer that says why.
Close lingering(const httplib::ContentReader* reader) {
  if (reader == nullptr) return [] {};
  return [reader = *reader] {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(2);
    try {
      reader([end](const char*, std::size_t) { return std::chrono::steady_clock::now() < end; });
    } catch (...) {
      // The connection is closed in any case.
    }
  };
}

void send(Response&& answer, ReplyOptions options, httplib::Response& response) {
  const Close& close = options.close;
  response.status = answer.status;
  const std::string type(answer.header("Content-Type"));
  auto* part = std::get_if<api::ContentPart>(&answer.body);
  auto* text = std::get_if<std::string>(&answer.body);
  const bool whole = answer.status >= 200 && answer.status != 204 && answer.status != 206 && answer.status != 304;
  const bool packable = compressible(type) && whole && !close;
  const bool packed = options.encoding != Encoding::identity && packable &&
                      ((text != nullptr && text->size() >= kWorthCompressing) ||
                       (part != nullptr && part->length >= kWorthCompressing));
  for (auto& [name, value] : answer.headers) {
    if (name == "Content-Type") continue;
    if (name == "ETag") {
      const std::string other = packed_tag(value, options.encoding);
      // What is not modified is what the client has: the form that it would get again.
      if (packed || (answer.status == 304 && options.known_tags.find(other) != std::string::npos)) value = other;
    }
    if (packed && name == "Accept-Ranges") value = "none";
    response.set_header(name, value);
  }
  if (packed) response.set_header("Content-Encoding", std::string(name(options.encoding)));
  if (packable) response.set_header("Vary", "Accept-Encoding");
  if (answer.header("Accept-Ranges").empty()) response.set_header("Accept-Ranges", "none");
  if (close) response.set_header("Connection", "close");

  if (auto* source = std::get_if<api::EventSource>(&answer.body)) {
    response.set_chunked_content_provider(
        type,
        [stopping = std::move(options.stopping), next = std::move(*source)](std::size_t, httplib::DataSink& sink) {
          return succeeds([&] {
            std::string piece;
            const bool more = !stopping() && next(piece);
            const bool good = piece.empty() || sink.write(piece.data(), piece.size());
            if (!more) sink.done();
            return good;
          });
        },
        [streamed = std::move(options.streamed)](bool) { streamed(); });
  } else if (part != nullptr && part->length > 0) {
    packed ? set_packed_part(response, std::move(*part), type, options.encoding)
           : set_part(response, std::move(*part), type);
  } else if (text != nullptr && !text->empty()) {
    set_text(response, packed ? make_packer(options.encoding)->feed(*text, true) : std::move(*text), type, close);
  } else if (!type.empty()) {
    response.set_header("Content-Type", type);
  }
}

}  // namespace spherule::server
