// SPDX-License-Identifier: GPL-3.0-or-later
//
// All connections of a listener. One that is idle, or whose next request has not wholly arrived up to the end of its
// head, is watched by one thread for all (epoll) and costs no thread of its own; so slow clients stop nobody. A request
// whose head is there is answered by a thread of a pool that grows as far as it must.
#pragma once

#include <httplib.h>

#include <atomic>
#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>
#include <string>

#include "server/http/limits.h"
#include "server/http/transport.h"

namespace spherule::server {

/// A connection as the HTTP library sees it, while one request on it is answered.
class Connection final : public httplib::Stream {
 public:
  /// Of all connections of a listener.
  struct Common {
    ConnectionLimits limits;
    std::atomic<bool> stopping{false};
    std::atomic<std::uint64_t> received{0}, sent{0};  ///< bytes
  };

  Connection(std::unique_ptr<Transport> transport, Common& common)
      : transport_(std::move(transport)), common_(common) {}

  /// The one whose request this thread answers; null elsewhere. The library gives handlers no way to their stream.
  static Connection* current();

  /// Whether the peer has closed its side, so that nobody waits for an answer. From any thread.
  bool is_gone() const;

  /// Lets the next write() take its bytes from `file` at `offset`, whatever its pointer; null will do.
  void take_from_file(int file, std::uint64_t offset);

  bool is_readable() const override { return true; }
  bool is_writable() const override { return true; }
  /// What has arrived already, else what arrives in time; 0 at the end, -1 when it takes too long.
  ssize_t read(char* into, std::size_t size) override;
  /// All of it, or -1.
  ssize_t write(const char* from, std::size_t size) override;
  void get_remote_ip_and_port(std::string& ip, int& port) const override;
  void get_local_ip_and_port(std::string&, int&) const override {}
  /// None: the library would only refuse high numbers, since it could not select() them.
  socket_t socket() const override { return -1; }

 private:
  friend class Connections;
  enum class Arrival { head, part, too_long, closed };

  // Reads what is there, up to the end of a head.
  Arrival receive(std::size_t head_bytes);
  // Waits for what `want` says. False when that takes too long, or the listener stops.
  bool wait(ssize_t want);
  bool send(const char* from, std::size_t size, bool more);
  bool send_file(int file, std::uint64_t offset, std::size_t size);
  template <typename Write>
  bool send_all(std::size_t size, Write&& write);
  bool flush(bool more = false);

  std::unique_ptr<Transport> transport_;
  Common& common_;
  std::string in_;      // arrived
  std::size_t at_ = 0;  // of it, read
  std::string held_;    // the head of an answer, to go with the first of its body
  bool begun_ = false;  // an answer
  int file_ = -1;
  std::uint64_t file_offset_ = 0;
  std::uint64_t id_ = 0;  // in the watcher's list
  ssize_t wants_ = Transport::want_read;
  std::size_t answered_ = 0;
  // Since the request that is answered now began: bytes either way, and how long we waited for them.
  std::uint64_t moved_ = 0;
  std::chrono::steady_clock::duration waited_{};
};

/// Thread safe.
class Connections {
 public:
  /// Answers one request; false when the connection is to be closed. `last` says that it will be in any case.
  using Answer = std::function<bool(Connection& connection, bool last)>;
  /// The whole text of an answer to a head that is not one: 408 or 431.
  using Refusal = std::function<std::string(int status)>;

  Connections(const ConnectionLimits& limits, Answer answer, Refusal refusal);
  ~Connections();
  Connections(const Connections&) = delete;
  Connections& operator=(const Connections&) = delete;

  void add(std::unique_ptr<Transport> transport);

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
