// SPDX-License-Identifier: GPL-3.0-or-later
//
// HTTP/1.1 on a socket: carries api::Request and api::Response to and from the network.
//
// All of it is ours, for what matters here is what libraries leave to their users: one strict reading of every request,
// a bound on all that a client may make us keep, and no thread for whoever is slow.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <memory>
#include <optional>
#include <string>

#include "api/http/http.h"
#include "server/http/limits.h"

namespace spherule::server {

struct ListenerOptions {
  std::string host = "127.0.0.1";
  std::uint16_t port = 0;                          ///< 0: any free one
  std::filesystem::path tls_certificate, tls_key;  ///< PEM; empty: plain HTTP
  std::size_t max_streams = 32;                    ///< event streams at once; further ones are refused
  ConnectionLimits connections{};                  ///< how many, how long
};

/// What one answered request was, without anything that a client wrote.
struct AccessRecord {
  std::string request_id;
  std::string method;
  std::string route;  ///< template of the path; empty when nothing is there
  int status = 0;
  double seconds = 0;   ///< until the answer was ready to be sent
  std::string trace{};  ///< 32 hex digits of the request's W3C traceparent, if it had a good one
};

class Listener {
 public:
  /// Called from many threads at once. What they throw is answered as the problem that it is.
  struct Handlers {
    std::function<api::Response(const api::Request&)> answer;
    /// Whether a request whose body has not arrived is refused for its head alone: then the body is not waited for. It
    /// must not be read here. `answer` decides for itself all the same. Empty: none is refused.
    std::function<std::optional<api::Response>(const api::Request&)> admit{};
  };
  using AccessLog = std::function<void(const AccessRecord&)>;

  /// Binds the address. Throws busy when it is taken or none, invalid_argument when certificate and key are no pair.
  Listener(ListenerOptions options, Handlers handlers, AccessLog log = {});
  ~Listener();
  Listener(const Listener&) = delete;
  Listener& operator=(const Listener&) = delete;

  std::uint16_t port() const;

  struct Load {
    std::size_t connections = 0;  ///< open
    std::size_t waiting = 0;      ///< requests that wait for a thread
    std::size_t answering = 0;    ///< requests that are being answered, streams with them
    std::size_t threads = 0, streams = 0;
    std::uint64_t received = 0, sent = 0;  ///< bytes, so far
  };
  Load load() const;

  /// Answers requests until stop(); returns when the last one is answered.
  void run();

  /// Refuses new connections and ends the streams and uploads that are under way. Any thread; before or during run().
  void stop();

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace spherule::server
