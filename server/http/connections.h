// SPDX-License-Identifier: GPL-3.0-or-later
//
// All connections of a listener. One thread watches them (epoll), accepts new ones, and receives heads and the
// beginnings of bodies; a request costs a thread of its own only while it is answered. So slow clients stop nobody: who
// has not sent a head, or the first of a body, or takes no notice of an answer, costs a socket and some memory. Whoever
// makes a thread wait is cut off when others need it; and two threads are kept for those who ask how the server is.
#pragma once

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>
#include <string_view>

#include "server/http/framing.h"
#include "server/http/head.h"
#include "server/http/limits.h"
#include "server/http/transport.h"

namespace spherule::server {

/// A connection, seen by the thread that answers a request on it.
class Connection {
 public:
  /// Of all connections of a listener.
  struct Common;

  Connection(std::unique_ptr<Transport> transport, std::shared_ptr<Common> common);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Of the request that is answered now.
  const Head& head() const { return head_; }
  /// Whether this is the last one that is answered here.
  bool last() const { return last_; }
  /// Whether as much of the body has arrived as does before a thread takes it up.
  bool body_arrived() const { return framing_.finished() || !fault_.empty() || body_.size() >= most_ahead_; }
  /// Drops what has arrived of the body and was not read. Whether the connection can serve another request: nothing, or
  /// little that is known to come, is left of the body.
  bool drop_body();

  /// Tells a client that waits for it to send the body (100).
  void invite();
  /// The next piece of the body, valid until the next call; empty at its end. Waits for it. Throws malformed when the
  /// body is cut short or is none, busy when the listener stops.
  std::string_view read_body();

  /// Whether the peer has closed its side, so that nobody waits for an answer. From any thread.
  bool is_gone() const;

  /// Keeps the text back, to go with what is written next.
  void hold(std::string_view text);
  /// All of it; false when the client does not take it.
  bool write(std::string_view text);
  /// The same for bytes of a file.
  bool write_file(int file, std::uint64_t offset, std::size_t size);

 private:
  friend class Connections;
  enum class Arrival { part, whole, refused, closed };

  Arrival receive_head();
  Arrival receive_body();
  Arrival receive_for_nothing(bool body);
  ssize_t fetch(std::size_t most);
  void decode_body();
  bool wait(ssize_t want);
  bool send(std::string_view text, bool more);
  template <typename Write>
  bool send_all(std::size_t size, Write&& write);
  bool flush(bool more = false);
  void begin_request();
  void forget();
  // How long a thread has been kept waiting beyond what a fair client makes it wait; less than 0 while it does not
  // wait.
  std::int64_t lag_ms() const;
  void cut_off();

  std::unique_ptr<Transport> transport_;
  std::shared_ptr<Common> common_;
  const std::string address_;  // whose part of all connections this takes; empty: nobody's
  std::uint64_t id_ = 0;       // in the watcher's list

  std::string in_;      // arrived
  std::size_t at_ = 0;  // of it, read
  HeadReader reader_;
  Head head_;
  BodyFraming framing_;
  std::string body_;            // decoded, not read yet
  std::string piece_;           // what read_body() showed last
  std::string_view fault_;      // why no more of the body comes
  std::size_t most_ahead_ = 0;  // of the body, decoded
  bool invited_ = false, last_ = false;
  std::string held_;  // to be written
  ssize_t wants_ = Transport::want_read;
  std::size_t answered_ = 0;

  // Since the request that is answered now began: bytes either way, and how long we waited for them.
  std::atomic<std::uint64_t> moved_{0};
  std::atomic<std::int64_t> waited_ms_{0};
  std::atomic<std::int64_t> waits_since_ms_{0};  // 0: it does not
  // A leaky bucket: waits fill it, bytes empty it. What a socket's buffer swallows at once is no credit for later.
  std::atomic<std::int64_t> lag_before_ms_{0};
  std::uint64_t settled_ = 0;  // of moved_
  std::atomic<bool> cut_off_{false};
};

/// Thread safe.
class Connections {
 public:
  enum class Next {
    again,   ///< the connection may serve another request
    body,    ///< the body is wanted: answer once more when the first of it is there
    close,   ///< after taking in for a while what the client still sends: else it may drop the answer unread
    broken,  ///< close at once; nobody is there any more
  };
  /// Answers one request.
  using Answer = std::function<Next(Connection& connection)>;
  /// The whole text of an answer to what is not a request, or does not arrive in time.
  using Refusal = std::function<std::string(const HeadRefusal& why)>;
  /// Whether a request is about how the server is.
  using IsHealth = std::function<bool(const Head& head)>;

  struct Calls {
    Answer answer;
    Refusal refusal;
    IsHealth is_health;
  };
  Connections(const ConnectionLimits& limits, Calls calls);
  ~Connections();
  Connections(const Connections&) = delete;
  Connections& operator=(const Connections&) = delete;

  /// Accepts connections from a listening socket, which must not block and outlives this, until stop(). Once.
  void accept_from(int socket, MakeTransport make);

  /// Closes what is idle, ends reads that wait, and returns when every request under way is answered.
  void stop();

  struct Load {
    std::size_t open = 0, waiting = 0, answering = 0, threads = 0;
    std::uint64_t received = 0, sent = 0;  ///< bytes
  };
  Load load() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace spherule::server
