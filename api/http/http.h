// SPDX-License-Identifier: GPL-3.0-or-later
//
// One HTTP exchange as plain values. No sockets and no HTTP library: server/http/listener.cpp carries these to and from
// the network, tests make them by hand.
#pragma once

#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>
#include <utility>
#include <variant>
#include <vector>

#include "api/service.h"

namespace spherule::api {

/// The body of a request, read at most once, piece by piece: nothing holds it whole.
class Body {
 public:
  using Take = std::function<void(std::string_view piece)>;
  using BeginPart = std::function<void(std::string_view name, std::string_view filename)>;

  virtual ~Body() = default;
  /// False when the request came without one.
  virtual bool present() const = 0;
  /// Bytes announced by Content-Length, as sent (before decompression); 0 when not announced.
  virtual std::uint64_t announced() const = 0;
  /// Hands the body's bytes on, decompressed when Content-Encoding says gzip. What `take` throws comes out here. Throws
  /// too_large once more than `limit` bytes arrive (before or after decompression), malformed when the body is cut.
  virtual void read(std::uint64_t limit, const Take& take) = 0;
  /// The same for multipart/form-data: `begin` once a part, then `take` for its bytes. `limit` is for all parts.
  virtual void read_parts(std::uint64_t limit, const BeginPart& begin, const Take& take) = 0;
};

struct Request {
  std::string method{};                                      ///< as sent: GET, HEAD, POST …
  std::string path{};                                        ///< percent-decoded, without the query
  std::vector<std::pair<std::string, std::string>> query{};  ///< decoded
  std::vector<std::pair<std::string, std::string>> headers{};
  std::string client{};  ///< who asks: the name of a key; empty when nobody needs one
  std::string id{};      ///< of this request: the X-Request-Id and the `instance` of problems
  Body* body = nullptr;  ///< not owned; null means no body
  Gone gone{};           ///< whether the client has closed its connection

  /// The first header of this name (in any case), or an empty string.
  std::string_view header(std::string_view name) const;
};

/// Server-sent events: each call waits for the next piece of text and appends it to `out`; false ends the stream.
using EventSource = std::function<bool(std::string& out)>;

/// Bytes [offset, offset + length) of a content.
struct ContentPart {
  Content content;
  std::uint64_t offset = 0, length = 0;
};

struct Response {
  int status = 200;
  std::vector<std::pair<std::string, std::string>> headers{};
  std::variant<std::string, ContentPart, EventSource> body{};  ///< for HEAD too: the listener leaves it out
  std::string_view route{};  ///< template of the path that was asked for, for logs; empty when nothing is there

  void set(std::string name, std::string value) { headers.emplace_back(std::move(name), std::move(value)); }
  /// The first header of this name (in any case), or an empty string.
  std::string_view header(std::string_view name) const;
};

}  // namespace spherule::api
