// SPDX-License-Identifier: GPL-3.0-or-later
//
// Requests that are none, or two: what a stranger without a key may send to a server, at whatever length.
#include <gtest/gtest.h>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"
#include "tests/long_form.h"
#include "tests/sockets.h"

namespace spherule::test {
namespace {

using namespace std::chrono_literals;

constexpr std::size_t kMiB = 1 << 20;

class Heads : public testing::Test {
 protected:
  // Sends `start`, then `piece` again and again, as much as the server takes; and what it answers.
  std::string flood(const std::string& start, const std::string& piece, std::size_t bytes) const {
    const Socket socket(server.port());
    std::string pieces;
    while (pieces.size() < (1 << 16)) pieces += piece;
    bool open = socket.send(start);
    for (std::size_t sent = 0; open && sent < bytes; sent += pieces.size()) open = socket.send(pieces);
    return socket.receive("<never>", 3s);
  }

  TemporaryFolder folder;
  ServerProcess server{folder.path() / "data"};
  Client client{server.port()};
};

TEST_F(Heads, FloodsCostNoMemory) {
  const std::size_t bytes = (long_form() ? 75 : 24) * kMiB;
  ASSERT_EQ(client.get("/livez").status, 200);
  const std::size_t before = server.peak_memory();
  const std::string post = "POST /v1/volumes HTTP/1.1\r\nHost: localhost\r\n",
                    chunked = post + "Transfer-Encoding: chunked\r\n\r\n";
  const std::string form = post + "Content-Type: multipart/form-data; boundary=b\r\nContent-Length: 999999999\r\n\r\n";
  const std::vector<std::tuple<std::string, std::string, std::string>> floods = {
      {"GET / HTTP/1.1\n", "A:b\n", "400"},
      {"GET / HTTP/1.1\r\n", "A:b\r\n", "431"},
      {"GET /", "a", "414"},
      {"", "\r\n", "400"},
      {"GET / HTTP/1.1\r\nA: ", "a", "431"},
      {chunked, "00", "400"},
      {chunked + "5;", "x", "400"},
      {chunked + "0\r\n", "A: b\r\n", "400"},
      {chunked + "0\r\nA: ", "b", "400"},
      {form, "-", "400"},
      {form + "--b\r\nA: ", "b", "400"},
      {form + "--b", " ", "400"},
  };
  for (const auto& [start, piece, status] : floods) {
    const std::string answer = flood(start, piece, bytes);
    // A client that sends on and on may lose the answer, but not the end.
    EXPECT_TRUE(answer.starts_with("HTTP/1.1 " + status) || answer == "<closed>") << start << piece << answer;
  }
  EXPECT_LT(server.peak_memory(), before + 16 * kMiB) << "twelve floods of " << bytes << " bytes each";
  EXPECT_EQ(client.get("/livez").status, 200);
}

TEST_F(Heads, SmuggleNothing) {
  const std::string raw = "?format=raw&dims=1,1,5&dtype=uint8";
  const std::string start = "POST /v1/volumes" + raw + " HTTP/1.1\r\nHost: localhost\r\n";
  const std::string chunked = start + "Transfer-Encoding: chunked\r\n";
  const std::string second = "GET /version HTTP/1.1\r\nHost: localhost\r\n\r\n";
  const std::vector<std::string> shapes = {
      start + "Content-Length : " + std::to_string(second.size()) + "\r\n\r\n",
      start + "A: b\r\n Content-Length: " + std::to_string(second.size()) + "\r\n\r\n",
      start + "A: b\nContent-Length: 0\n\n",
      start + "A: b\rContent-Length: 0\r\n\r\n",
      start + std::string("A: b\0\r\nContent-Length: 0\r\n\r\n", 29),
      chunked + "\r\n5\r\nhelloXX0\r\n\r\n",
      chunked + "\r\n5\nhello\r\n0\r\n\r\n",
      chunked + "\r\n5\r\nhello\n0\r\n\r\n",
      chunked + "Content-Length: 5\r\n\r\n0\r\n\r\n",
      start + "Content-Length: 0\r\nContent-Length: 0\r\n\r\n",
      start + "Host: localhost\r\nContent-Length: 0\r\n\r\n",
      "GET /livez HTTP/1.1\r\n\r\n",
  };
  for (const std::string& shape : shapes) {
    const Socket socket(server.port());
    ASSERT_TRUE(socket.send(shape + second));
    const std::string all = socket.receive("<never>", 5s);
    EXPECT_TRUE(all.starts_with("HTTP/1.1 400 ")) << shape << "\n" << all;
    EXPECT_NE(all.find("application/problem+json"), all.npos) << shape;
    EXPECT_EQ(all.find("HTTP/1.1 ", 9), all.npos) << "a second answer to " << shape << "\n" << all;
    EXPECT_TRUE(all.ends_with("<closed>")) << shape;
  }
  EXPECT_TRUE(client.get("/v1/volumes").json()["volumes"].empty());
}

TEST_F(Heads, AreNotDecoded) {
  // What looks like an encoded line break or another header stays the value that it is.
  const Answer answer = client.get("/v1/volumes", {.headers = {{"Accept", "application%2Fjson"}}});
  EXPECT_EQ(answer.status, 406);
  EXPECT_EQ(client.get("/v1/volumes", {.headers = {{"Accept", "application/json"}}}).status, 200);
}

}  // namespace
}  // namespace spherule::test
