// SPDX-License-Identifier: GPL-3.0-or-later
//
// Connections that are idle, slow or too many, on real sockets, with short times.
#include "server/listener.h"

#include <arpa/inet.h>
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <chrono>
#include <latch>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

class Socket {
 public:
  explicit Socket(int port) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
    sockaddr_in address{};
    address.sin_family = AF_INET;
    address.sin_port = htons(static_cast<std::uint16_t>(port));
    address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
    EXPECT_EQ(::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address), 0);
  }
  Socket(Socket&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}
  Socket& operator=(Socket&&) = delete;
  ~Socket() {
    if (socket_ >= 0) ::close(socket_);
  }
  bool send(std::string_view text) const {
    return ::send(socket_, text.data(), text.size(), MSG_NOSIGNAL) == static_cast<ssize_t>(text.size());
  }
  // What comes until `end` is in it, the server closes, or the patience is over.
  std::string receive(std::string_view end, std::chrono::milliseconds patience = 5s) const {
    std::string text;
    const auto last = Clock::now() + patience;
    while (text.find(end) == text.npos) {
      pollfd what{.fd = socket_, .events = POLLIN, .revents = 0};
      const auto left = std::chrono::ceil<std::chrono::milliseconds>(last - Clock::now());
      if (left <= 0ms || ::poll(&what, 1, static_cast<int>(left.count())) <= 0) break;
      std::array<char, 4096> piece{};
      const ssize_t n = ::recv(socket_, piece.data(), piece.size(), 0);
      if (n <= 0) return text + "<closed>";
      text.append(piece.data(), static_cast<std::size_t>(n));
    }
    return text;
  }
  bool closed_within(std::chrono::milliseconds patience) const {
    return receive("<never>", patience).find("<closed>") != std::string::npos;
  }

 private:
  int socket_;
};

const std::string kGet = "GET /short HTTP/1.1\r\nHost: x\r\n\r\n";

class ListenerTest : public testing::Test {
 protected:
  void start(ConnectionLimits limits) {
    ListenerOptions options;
    options.max_body_bytes = 1 << 20;
    options.connections = limits;
    listener.emplace(options, [this](const api::Request& request) {
      if (request.path == "/body") request.body->read(1 << 20, [](std::string_view) {});
      if (request.path == "/block") {
        if (blocked) blocked->count_down();
        if (release) release->wait();
      }
      api::Response response{.status = 200, .body = "answer to " + request.path + "."};
      response.set("Content-Type", "text/plain");
      response.set("X-Request-Id", request.id);
      return response;
    });
    thread = std::jthread([this] { listener->run(); });
  }
  ~ListenerTest() override {
    if (listener) listener->stop();
  }
  Socket connect() const { return Socket(listener->port()); }
  // A whole exchange on a connection of its own: seconds.
  double time_of_get() const {
    const auto start = Clock::now();
    const Socket socket = connect();
    EXPECT_TRUE(socket.send(kGet));
    EXPECT_NE(socket.receive("answer to /short.").find("200 OK"), std::string::npos);
    return std::chrono::duration<double>(Clock::now() - start).count();
  }
  void wait_for_open(std::size_t count) const {
    const auto end = Clock::now() + 5s;
    while (listener->load().connections != count && Clock::now() < end) std::this_thread::yield();
    EXPECT_EQ(listener->load().connections, count);
  }

  std::unique_ptr<std::latch> blocked, release;
  std::optional<Listener> listener;
  std::jthread thread;
};

TEST_F(ListenerTest, AnswersRequestsOfOneConnectionInTurn) {
  start({});
  const Socket socket = connect();
  ASSERT_TRUE(socket.send(kGet + "POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 3\r\n\r\nabc" + kGet));
  const std::string all = socket.receive("answer to /body.HTTP/1.1 200 OK");
  EXPECT_EQ(all.find("answer to /short."), all.rfind("answer to /short.", all.find("answer to /body.")));
  // And byte by byte.
  for (const char c : kGet) ASSERT_TRUE(socket.send(std::string(1, c)));
  EXPECT_NE(socket.receive("answer to /short.").find("answer to /short."), std::string::npos);
}

TEST_F(ListenerTest, IdleAndSlowClientsStopNobody) {
  start({.connections = 2000, .threads = 4});
  std::vector<Socket> idle, slow;
  for (int i = 0; i < 300; ++i) idle.push_back(connect());
  for (int i = 0; i < 200; ++i) {
    slow.push_back(connect());
    ASSERT_TRUE(slow.back().send("GET /short HTTP/1.1\r\nHo"));
  }
  wait_for_open(500);
  for (int i = 0; i < 20; ++i) EXPECT_LT(time_of_get(), 2) << "of 500 connections none costs a thread";
  EXPECT_LE(listener->load().threads, 4U);
  // The slow ones were not forgotten.
  ASSERT_TRUE(slow[137].send("st: x\r\n\r\n"));
  EXPECT_NE(slow[137].receive("/short.").find("200 OK"), std::string::npos);
}

TEST_F(ListenerTest, EndsHeadsThatTakeTooLong) {
  start({.head = 300ms, .idle = 10s});
  const Socket slow = connect(), silent = connect();
  ASSERT_TRUE(slow.send("GET /short HTTP/1.1\r\n"));
  const auto begin = Clock::now();
  std::string answer;
  // A byte now and then does not help.
  while (answer.empty() && Clock::now() - begin < 5s) {
    slow.send("X");
    answer = slow.receive("}", 100ms);
  }
  EXPECT_EQ(answer.substr(0, 12), "HTTP/1.1 408") << answer;
  EXPECT_NE(answer.find("application/problem+json"), std::string::npos);
  EXPECT_TRUE(silent.closed_within(3s)) << "without a word";
}

TEST_F(ListenerTest, RefusesEndlessHeads) {
  start({.head_bytes = 2000});
  const Socket socket = connect();
  ASSERT_TRUE(socket.send("GET /short HTTP/1.1\r\nX: " + std::string(7000, 'x')));
  EXPECT_EQ(socket.receive("}").substr(0, 12), "HTTP/1.1 431");
}

TEST_F(ListenerTest, ClosesWhatHasBeenIdleLongestWhenThereAreTooMany) {
  start({.connections = 3});
  const Socket first = connect();
  wait_for_open(1);
  ASSERT_TRUE(first.send(kGet));
  first.receive("/short.");
  const Socket second = connect();
  ASSERT_TRUE(second.send(kGet));
  second.receive("/short.");
  const Socket third = connect();
  wait_for_open(3);
  EXPECT_LT(time_of_get(), 2);
  EXPECT_TRUE(first.closed_within(3s));
  ASSERT_TRUE(second.send(kGet));
  EXPECT_NE(second.receive("/short.").find("200 OK"), std::string::npos);
}

TEST_F(ListenerTest, ClosesIdleConnectionsInTime) {
  start({.idle = 200ms});
  const Socket socket = connect();
  ASSERT_TRUE(socket.send(kGet));
  socket.receive("/short.");
  EXPECT_TRUE(socket.closed_within(3s));
}

TEST_F(ListenerTest, EndsBodiesThatStopComing) {
  start({.read = 300ms});
  const Socket socket = connect();
  ASSERT_TRUE(socket.send("POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nabc"));
  EXPECT_NE(socket.receive("<never>", 5s).find("<closed>"), std::string::npos);
}

TEST_F(ListenerTest, EndsBodiesThatTrickle) {
  start({.read = 300ms, .slowest_bytes_per_second = 1000});
  const Socket socket = connect();
  ASSERT_TRUE(socket.send("POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 100000\r\n\r\n"));
  const auto begin = Clock::now();
  bool open = true;
  while (open && Clock::now() - begin < 5s) {
    socket.send("x");
    open = !socket.closed_within(50ms);
  }
  EXPECT_FALSE(open) << "every byte came in time, but they are too few";
}

TEST_F(ListenerTest, GrowsThreadsWithRequestsThatBlock) {
  blocked = std::make_unique<std::latch>(30);
  release = std::make_unique<std::latch>(1);
  start({.threads = 40});
  std::vector<Socket> sockets;
  for (int i = 0; i < 30; ++i) {
    sockets.push_back(connect());
    ASSERT_TRUE(sockets.back().send("GET /block HTTP/1.1\r\nHost: x\r\n\r\n"));
  }
  blocked->wait();  // all thirty are being answered
  EXPECT_LT(time_of_get(), 2);
  release->count_down();
  for (const Socket& socket : sockets) {
    EXPECT_NE(socket.receive("/block.").find("200 OK"), std::string::npos);
  }
}

TEST_F(ListenerTest, StopsWithConnectionsOfEveryKind) {
  start({});
  const Socket idle = connect(), slow = connect(), body = connect();
  ASSERT_TRUE(slow.send("GET /"));
  ASSERT_TRUE(body.send("POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 1000\r\n\r\nabc"));
  wait_for_open(3);
  const auto begin = Clock::now();
  listener->stop();
  thread.join();
  EXPECT_LT(Clock::now() - begin, 5s);
  EXPECT_TRUE(idle.closed_within(1s));
}

}  // namespace
}  // namespace spherule::server
