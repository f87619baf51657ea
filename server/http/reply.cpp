// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/reply.h"

#include <algorithm>
#include <array>
#include <memory>

namespace spherule::server {

using api::Response;

namespace {

constexpr std::size_t kPieceBytes = 1 << 18;
constexpr std::size_t kWorthCompressing = 1024;

std::string_view reason(int status) {
  constexpr std::array<std::pair<int, std::string_view>, 28> reasons = {{{200, "OK"},
                                                                         {201, "Created"},
                                                                         {202, "Accepted"},
                                                                         {204, "No Content"},
                                                                         {206, "Partial Content"},
                                                                         {304, "Not Modified"},
                                                                         {400, "Bad Request"},
                                                                         {401, "Unauthorized"},
                                                                         {403, "Forbidden"},
                                                                         {404, "Not Found"},
                                                                         {405, "Method Not Allowed"},
                                                                         {406, "Not Acceptable"},
                                                                         {408, "Request Timeout"},
                                                                         {409, "Conflict"},
                                                                         {410, "Gone"},
                                                                         {411, "Length Required"},
                                                                         {412, "Precondition Failed"},
                                                                         {413, "Content Too Large"},
                                                                         {414, "URI Too Long"},
                                                                         {415, "Unsupported Media Type"},
                                                                         {416, "Range Not Satisfiable"},
                                                                         {417, "Expectation Failed"},
                                                                         {422, "Unprocessable Content"},
                                                                         {429, "Too Many Requests"},
                                                                         {431, "Request Header Fields Too Large"},
                                                                         {500, "Internal Server Error"},
                                                                         {503, "Service Unavailable"},
                                                                         {507, "Insufficient Storage"}}};
  const auto found = std::ranges::find(reasons, status, &std::pair<int, std::string_view>::first);
  return found == reasons.end() ? std::string_view() : found->second;
}

// A body of unknown length: in chunks, or, for who does not know these, until the connection closes.
class Chunks {
 public:
  Chunks(Connection& connection, bool framed) : connection_(connection), framed_(framed) {}
  bool write(std::string_view piece) {
    if (piece.empty()) return true;  // an empty chunk would be the last
    if (!framed_) return connection_.write(piece);
    std::array<char, 20> size{};
    const int digits = std::snprintf(size.data(), size.size(), "%zx\r\n", piece.size());
    connection_.hold(std::string(size.data(), static_cast<std::size_t>(digits)));
    connection_.hold(std::string(piece));
    return connection_.write("\r\n");
  }
  bool end() { return !framed_ || connection_.write("0\r\n\r\n"); }

 private:
  Connection& connection_;
  bool framed_;
};

bool send_part(const api::ContentPart& part, Connection& connection) {
  if (part.content.file >= 0) return connection.write_file(part.content.file, part.offset, part.length);
  std::string piece;
  for (std::uint64_t at = 0; at < part.length; at += piece.size()) {
    piece.resize(std::min<std::uint64_t>(part.length - at, kPieceBytes));
    piece.resize(part.content.read_at(part.offset + at, piece));
    if (piece.empty() || !connection.write(piece)) return false;
  }
  return true;
}

bool send_packed(const api::ContentPart& part, Encoding encoding, Chunks chunks) {
  const std::unique_ptr<Packer> packer = make_packer(encoding);
  std::string piece;
  for (std::uint64_t at = 0; at < part.length; at += piece.size()) {
    piece.resize(std::min<std::uint64_t>(part.length - at, kPieceBytes));
    piece.resize(part.content.read_at(part.offset + at, piece));
    if (piece.empty() || !chunks.write(packer->feed(piece, at + piece.size() == part.length))) return false;
  }
  return chunks.end();
}

bool send_events(const api::EventSource& next, const std::function<bool()>& stopping, Chunks chunks) {
  for (bool more = true; more;) {
    std::string piece;
    more = !stopping() && next(piece);
    if (!chunks.write(piece)) return false;
  }
  return chunks.end();
}

}  // namespace

std::string head_text(int status, const std::vector<std::pair<std::string, std::string>>& fields) {
  std::string text = "HTTP/1.1 " + std::to_string(status) + " " + std::string(reason(status)) + "\r\n";
  for (const auto& [name, value] : fields) text += name + ": " + value + "\r\n";
  return text + "\r\n";
}

bool send(Response&& answer, const ReplyOptions& options, Connection& connection) {
  const std::string type(answer.header("Content-Type"));
  auto* part = std::get_if<api::ContentPart>(&answer.body);
  auto* text = std::get_if<std::string>(&answer.body);
  auto* events = std::get_if<api::EventSource>(&answer.body);
  const bool bodiless = answer.status == 204 || answer.status == 304;
  const bool packable = compressible(type) && answer.status >= 200 && !bodiless && answer.status != 206;
  const bool packed = options.encoding != Encoding::identity && packable &&
                      ((text != nullptr && text->size() >= kWorthCompressing) ||
                       (part != nullptr && part->length >= kWorthCompressing));
  for (auto& [name, value] : answer.headers) {
    if (name == "ETag") {
      const std::string other = packed_tag(value, options.encoding);
      // What is not modified is what the client has: the form that it would get again.
      if (packed || (answer.status == 304 && options.known_tags.find(other) != std::string::npos)) value = other;
    }
    if (packed && name == "Accept-Ranges") value = "none";
  }
  if (packed) answer.set("Content-Encoding", std::string(name(options.encoding)));
  if (packable) answer.set("Vary", "Accept-Encoding");
  if (answer.header("Accept-Ranges").empty()) answer.set("Accept-Ranges", "none");
  if (packed && text != nullptr) *text = make_packer(options.encoding)->feed(*text, true);

  const bool in_chunks = events != nullptr || (packed && part != nullptr);
  const bool framed = in_chunks && !connection.head().version_1_0;
  if (framed) answer.set("Transfer-Encoding", "chunked");
  if (!in_chunks && !bodiless) {
    answer.set("Content-Length", std::to_string(part != nullptr ? part->length : text->size()));
  }
  const bool closes = options.keep_alive.empty() || in_chunks != framed;
  answer.set("Connection", closes ? "close" : "keep-alive");
  if (!closes) answer.set("Keep-Alive", options.keep_alive);
  connection.hold(head_text(answer.status, answer.headers));

  if (connection.head().method == "HEAD" || bodiless) return connection.write({});
  try {
    if (events != nullptr) return send_events(*events, options.stopping, {connection, framed});
    if (part == nullptr) return connection.write(*text);
    return packed ? send_packed(*part, options.encoding, {connection, framed}) : send_part(*part, connection);
  } catch (...) {
    // Too late to say why: a connection that is closed before the end that was announced tells the client.
    return false;
  }
}

}  // namespace spherule::server
