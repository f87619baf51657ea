// SPDX-License-Identifier: GPL-3.0-or-later
//
// Connections that are idle, slow or too many, on real sockets, with short times.
#include "server/http/listener.h"

#include <gtest/gtest.h>

#include <chrono>
#include <latch>
#include <memory>
#include <optional>
#include <thread>
#include <vector>

#include "core/base/error.h"
#include "tests/sockets.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using Clock = std::chrono::steady_clock;

using test::Socket;

const std::string kGet = "GET /short HTTP/1.1\r\nHost: x\r\n\r\n";

class ListenerTest : public testing::Test {
 protected:
  void start(ConnectionLimits limits) {
    ListenerOptions options;
    options.connections = limits;
    const auto admit = [](const api::Request& request) -> std::optional<api::Response> {
      if (request.path != "/refused") return {};
      api::Response refused{.status = 401, .body = "no."};
      refused.set("Content-Type", "text/plain");
      return refused;
    };
    const auto answer = [this](const api::Request& request) {
      if (request.path == "/body") request.body->read(1 << 20, [](std::string_view) {});
      if (request.path == "/block") {
        if (blocked) blocked->count_down();
        if (release) release->wait();
      }
      if (request.path == "/large") return api::Response{.status = 200, .body = std::string(64 << 20, 'x')};
      api::Response response{.status = 200, .body = "answer to " + request.path + "."};
      response.set("Content-Type", "text/plain");
      response.set("X-Request-Id", request.id);
      return response;
    };
    listener.emplace(options, Listener::Handlers{.answer = answer, .admit = admit});
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

  // An answer that has arrived may be an instant older than the end of the work on it.
  void wait_until_none_is_answered() const {
    const auto end = Clock::now() + 5s;
    while (listener->load().answering != 0 && Clock::now() < end) std::this_thread::yield();
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
  start({.head_size = {.bytes = 2000}});
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
  wait_until_none_is_answered();
  const Socket second = connect();
  ASSERT_TRUE(second.send(kGet));
  second.receive("/short.");
  wait_until_none_is_answered();
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

TEST_F(ListenerTest, RefusesBeforeTheBody) {
  start({.threads = 4});
  for (const char* framing : {"Content-Length: 500000\r\n", "Transfer-Encoding: chunked\r\n",
                              "Content-Length: 9\r\nExpect: 100-continue\r\n"}) {
    const Socket socket = connect();
    ASSERT_TRUE(socket.send("POST /refused HTTP/1.1\r\nHost: x\r\n" + std::string(framing) + "\r\n"));
    const std::string answer = socket.receive("no.");
    EXPECT_TRUE(answer.starts_with("HTTP/1.1 401")) << framing << answer;
  }
  // A short body that was announced is dropped, and the connection lives on.
  const Socket socket = connect();
  ASSERT_TRUE(socket.send("POST /refused HTTP/1.1\r\nHost: x\r\nContent-Length: 5\r\n\r\n"));
  EXPECT_NE(socket.receive("no.").find("Keep-Alive"), std::string::npos);
  ASSERT_TRUE(socket.send("hello" + kGet));
  EXPECT_NE(socket.receive("/short.").find("200 OK"), std::string::npos);
}

TEST_F(ListenerTest, BodiesThatDoNotComeCostNoThread) {
  start({.threads = 2});
  std::vector<Socket> slow;
  for (int i = 0; i < 60; ++i) {
    slow.push_back(connect());
    const char* framing = i % 2 == 0 ? "Transfer-Encoding: chunked\r\n\r\n" : "Content-Length: 1000\r\n\r\nabc";
    ASSERT_TRUE(slow.back().send("POST /body HTTP/1.1\r\nHost: x\r\n" + std::string(framing)));
  }
  wait_for_open(60);
  for (int i = 0; i < 10; ++i) EXPECT_LT(time_of_get(), 2);
  wait_until_none_is_answered();
  EXPECT_EQ(listener->load().answering, 0U);
  ASSERT_TRUE(slow[0].send("3\r\nabc\r\n0\r\n\r\n"));
  EXPECT_NE(slow[0].receive("/body.").find("200 OK"), std::string::npos) << "nor are they forgotten";
}

TEST_F(ListenerTest, WhoKeepsThreadsWaitingMakesWayForOthers) {
  start({.threads = 4});
  std::vector<Socket> slow;
  for (int i = 0; i < 12; ++i) {
    slow.push_back(connect());
    // More than arrives before a thread takes it up, and then nothing.
    ASSERT_TRUE(slow.back().send("POST /body HTTP/1.1\r\nHost: x\r\nContent-Length: 500000\r\n\r\n" +
                                 std::string(100'000, 'x')));
  }
  const auto end = Clock::now() + 5s;
  while (listener->load().answering < 4 && Clock::now() < end) std::this_thread::yield();
  for (int i = 0; i < 3; ++i) EXPECT_LT(time_of_get(), 3) << "all threads were waiting for slow bodies";
}

TEST_F(ListenerTest, ReadersThatStopReadingMakeWay) {
  start({.threads = 2});
  std::vector<Socket> slow;
  for (int i = 0; i < 4; ++i) {
    slow.push_back(connect());
    ASSERT_TRUE(slow.back().send("GET /large HTTP/1.1\r\nHost: x\r\n\r\n"));
  }
  const auto end = Clock::now() + 5s;
  while (listener->load().answering < 2 && Clock::now() < end) std::this_thread::yield();
  EXPECT_LT(time_of_get(), 3);
}

TEST_F(ListenerTest, AnswersAboutItsHealthWhenAllThreadsWork) {
  blocked = std::make_unique<std::latch>(2);
  release = std::make_unique<std::latch>(1);
  start({.threads = 2});
  const Socket one = connect(), other = connect(), waiting = connect(), health = connect();
  ASSERT_TRUE(one.send("GET /block HTTP/1.1\r\nHost: x\r\n\r\n"));
  ASSERT_TRUE(other.send("GET /block HTTP/1.1\r\nHost: x\r\n\r\n"));
  blocked->wait();
  ASSERT_TRUE(waiting.send(kGet));
  for (const std::string path : {"/livez", "/readyz", "/metrics?x=1"}) {
    ASSERT_TRUE(health.send("GET " + path + " HTTP/1.1\r\nHost: x\r\n\r\n"));
    EXPECT_NE(health.receive("answer to /").find("200 OK"), std::string::npos) << path;
  }
  EXPECT_EQ(waiting.receive("/short.", 50ms), "") << "others wait for a thread";
  release->count_down();
  EXPECT_NE(waiting.receive("/short.").find("200 OK"), std::string::npos);
}

TEST_F(ListenerTest, SmugglesNoSecondRequest) {
  start({});
  const std::string second = "GET /second HTTP/1.1\r\nHost: x\r\n\r\n";
  const std::string start = "POST /body HTTP/1.1\r\nHost: x\r\n", chunked = start + "Transfer-Encoding: chunked\r\n";
  for (const std::string& first :
       {start + "Content-Length : 0\r\n\r\n", start + "A: b\r\n c: d\r\n\r\n", start + "A: b\n\n",
        start + "A: b\rC: d\r\n\r\n", start + std::string("A: b\0\r\n\r\n", 9), chunked + "\r\n5\nhello\r\n0\r\n\r\n",
        chunked + "\r\n5\r\nhelloXX0\r\n\r\n", chunked + "Content-Length: 3\r\n\r\n0\r\n\r\n",
        start + "Host: y\r\n\r\n", std::string("GET /short HTTP/1.1\r\n\r\n")}) {
    const Socket socket = connect();
    ASSERT_TRUE(socket.send(first + second));
    const std::string all = socket.receive("<never>", 3s);
    EXPECT_EQ(all.find("/second"), std::string::npos) << first << "\n" << all;
    EXPECT_NE(all.find("<closed>"), std::string::npos) << first;
    EXPECT_EQ(all.find("200 OK"), std::string::npos) << first << "\n" << all;
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
