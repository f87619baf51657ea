// SPDX-License-Identifier: GPL-3.0-or-later
//
// HTTP itself: framing, encodings, limits, and clients that misbehave.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "tests/archives.h"
#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

using Clock = std::chrono::steady_clock;

// RFC 8878, with blocks of type 0 (the bytes as they are) or 1 (one byte, `size` times).
std::string zstd_block(const std::string& content, unsigned type, std::size_t size, bool last) {
  const std::size_t header = size << 3 | type << 1 | (last ? 1 : 0);
  return {std::string{static_cast<char>(header & 0xff), static_cast<char>(header >> 8 & 0xff),
                      static_cast<char>(header >> 16 & 0xff)} +
          content};
}
std::string zstd_frame(std::size_t content_size, const std::vector<std::string>& blocks) {
  std::string frame = "\x28\xb5\x2f\xfd\xa0";  // one segment, whose size follows in four bytes
  for (int i = 0; i < 4; ++i) frame += static_cast<char>(content_size >> (8 * i) & 0xff);
  for (const std::string& block : blocks) frame += block;
  return frame;
}

// Every answer has one.
std::size_t answers(const std::string& text) {
  const std::string part = "X-Request-Id: ";
  std::size_t n = 0;
  for (std::size_t at = 0; (at = text.find(part, at)) != std::string::npos; at += part.size()) ++n;
  return n;
}

class Http : public testing::Test {
 protected:
  TemporaryFolder folder;
  ServerProcess server{folder.path() / "data", {"--max-body-bytes", "4M", "--max-streams", "3", "--max-wait-s", "2"}};
  Client client{server.port()};
  const std::string raw = "/v1/volumes?format=raw&dims=24,24,24&dtype=uint8";
};

TEST_F(Http, SendsSeveralRangesAtOnce) {
  const std::string bytes = ball(24, 11.5);
  const std::string path = "/v1/volumes/" + client.upload(raw.substr(raw.find('?')), bytes) + "/content";
  const Answer whole = client.get(path);
  const Answer parts = client.get(path, {.headers = {{"Range", "bytes=0-9,5000-12999,-1"}}});
  EXPECT_EQ(parts.status, 206);
  const std::string type = parts.header("Content-Type");
  ASSERT_TRUE(type.starts_with("multipart/byteranges; boundary=")) << type;
  const std::string mark = "\r\n--" + type.substr(type.find('=') + 1);
  std::string expected;
  for (const auto& [from, to] : {std::pair(0, 9), {5000, 12999}, {13823, 13823}}) {
    expected += mark + "\r\nContent-Type: application/octet-stream\r\nContent-Range: bytes " + std::to_string(from) +
                "-" + std::to_string(to) + "/13824\r\n\r\n" + bytes.substr(from, to - from + 1);
  }
  EXPECT_EQ(parts.body, expected + mark + "--\r\n");
  EXPECT_EQ(client.get(path, {.headers = {{"Range", "bytes=0-9999,0-9999"}}}).body, whole.body);
  // A method that is none here, with a Range that would fit: the problem comes whole.
  const std::string refused =
      client.raw("TRACE " + path + " HTTP/1.1\r\nHost: localhost\r\nRange: bytes=0-9999\r\n\r\n");
  const std::size_t body = refused.find("\r\n\r\n");
  ASSERT_NE(body, refused.npos) << refused;
  EXPECT_TRUE(refused.starts_with("HTTP/1.1 405 ")) << refused;
  EXPECT_NE(refused.find("Content-Length: " + std::to_string(refused.size() - body - 4) + "\r\n"), refused.npos)
      << refused;
}

TEST_F(Http, UnpacksGzipBodies) {
  const std::string bytes = ball(24, 11.5), packed = gzip(bytes);
  const auto upload = [&](const std::string& body) {
    return client.post(raw, {.headers = {{"Content-Encoding", "gzip"}}, .body = body});
  };
  const Answer answer = upload(packed);
  ASSERT_EQ(answer.status, 201) << answer.body;
  EXPECT_EQ(answer.json()["bytes"], bytes.size());
  EXPECT_EQ(client.post(raw, {.body = bytes}).status, 200) << "the same bytes";
  EXPECT_EQ(upload(gzip(bytes.substr(0, 5000)) + gzip(bytes.substr(5000))).status, 200) << "two members";
  EXPECT_EQ(upload(packed.substr(0, packed.size() - 5)).status, 400) << "cut";
  EXPECT_EQ(upload(bytes).status, 400) << "not gzip";
  EXPECT_EQ(upload(gzip(std::string(64 << 20, '\0'))).status, 413) << "a bomb";
  EXPECT_EQ(client.post(raw, {.headers = {{"Content-Encoding", "br"}}, .body = bytes}).status, 415);
  EXPECT_LT(server.peak_memory(), std::size_t{200} << 20);
}

TEST_F(Http, UnpacksZstdBodies) {
  const std::string bytes = ball(24, 11.5);
  const auto upload = [&](const std::string& body) {
    return client.post(raw, {.headers = {{"Content-Encoding", "zstd"}}, .body = body});
  };
  const std::string packed = zstd_frame(bytes.size(), {zstd_block(bytes, 0, bytes.size(), true)});
  EXPECT_EQ(upload(packed).status, 201);
  EXPECT_EQ(client.post(raw, {.body = bytes}).status, 200) << "the same bytes";
  EXPECT_EQ(upload(packed.substr(0, packed.size() - 5)).status, 400) << "cut";
  EXPECT_EQ(upload(bytes).status, 400) << "not zstd";
  std::vector<std::string> blocks;
  for (int i = 0; i < 4000; ++i) blocks.push_back(zstd_block(std::string(1, '\0'), 1, 1 << 17, i == 3999));
  std::string bomb("\x28\xb5\x2f\xfd\x00\x68", 6);  // of unknown size, with a window of 8 MiB
  for (const std::string& block : blocks) bomb += block;
  EXPECT_LT(bomb.size(), 20'000U);
  EXPECT_EQ(upload(bomb).status, 413) << "16 kB that stand for 500 MB";
  EXPECT_EQ(upload(zstd_frame(std::size_t{1} << 31, {zstd_block("x", 0, 1, true)})).status, 400) << "a huge window";
  EXPECT_LT(server.peak_memory(), std::size_t{200} << 20);
}

TEST_F(Http, PacksTextForThoseWhoTakeIt) {
  const Answer plain = client.get("/openapi.yaml");
  const Answer packed = client.get("/openapi.yaml", {.headers = {{"Accept-Encoding", "br;q=1.0, gzip;q=0.8"}}});
  EXPECT_EQ(plain.header("Content-Encoding"), "");
  EXPECT_EQ(packed.header("Content-Encoding"), "gzip");
  EXPECT_EQ(gunzip(packed.body), plain.body);
  EXPECT_LT(packed.body.size(), plain.body.size() / 2);
  EXPECT_NE(packed.header("ETag"), plain.header("ETag")) << "strong tags are of the encoded bytes";
  EXPECT_EQ(client.get("/openapi.yaml", {.headers = {{"If-None-Match", packed.header("ETag")}}}).status, 304);
  EXPECT_EQ(plain.header("Vary"), "Accept-Encoding");
  EXPECT_EQ(client.get("/openapi.yaml", {.headers = {{"Accept-Encoding", "gzip;q=0"}}}).body, plain.body);
  const Answer modern = client.get("/openapi.yaml", {.headers = {{"Accept-Encoding", "gzip, deflate, br, zstd"}}});
  EXPECT_EQ(modern.header("Content-Encoding"), "zstd");
  EXPECT_EQ(modern.body.substr(0, 4), "\x28\xb5\x2f\xfd");
  EXPECT_NE(modern.header("ETag"), packed.header("ETag"));
  const Answer known =
      client.get("/openapi.yaml", {.headers = {{"Accept-Encoding", "zstd"}, {"if-none-match", modern.header("ETag")}}});
  EXPECT_EQ(known.status, 304);
  EXPECT_EQ(known.header("ETag"), modern.header("ETag"));

  const std::string id = client.upload("?format=raw&dims=24,24,24&dtype=uint8", ball(24, 11.5));
  const std::string csv =
      "/v1/models/" + client.model({{"volume", id}, {"threshold", 99}})["id"].get<std::string>() + "/exports/csv";
  const Answer table = client.get(csv), packed_table = client.get(csv, {.headers = {{"Accept-Encoding", "gzip"}}});
  EXPECT_EQ(packed_table.header("Content-Encoding"), "gzip");
  EXPECT_EQ(gunzip(packed_table.body), table.body);
}

TEST_F(Http, CountsChunkedBodies) {
  const auto chunked = [&](std::size_t bytes) {
    std::string request = "POST " + raw + " HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n";
    const std::string piece = ball(24, 11.5);
    for (std::size_t sent = 0; sent < bytes; sent += piece.size()) request += "3600\r\n" + piece + "\r\n";
    return client.raw(request + "0\r\n\r\n");
  };
  EXPECT_EQ(chunked(13824).substr(0, 12), "HTTP/1.1 201");
  EXPECT_EQ(chunked(6 << 20).substr(0, 12), "HTTP/1.1 413") << "the limit is 4 MiB, and no length was announced";
}

TEST_F(Http, RefusesLargeBodiesBeforeTheyAreSent) {
  const std::string head = "POST " + raw + " HTTP/1.1\r\nHost: localhost\r\nContent-Length: 999999999\r\n";
  const std::string expecting = client.raw(head + "Expect: 100-continue\r\n\r\n");
  EXPECT_EQ(expecting.substr(0, 12), "HTTP/1.1 413");
  EXPECT_NE(expecting.find("application/problem+json"), std::string::npos);
  const auto start = Clock::now();
  const std::string sending = client.raw(head + "\r\n" + std::string(9 << 20, 'x'));
  EXPECT_EQ(sending.substr(0, 12), "HTTP/1.1 413") << "the answer arrives although the client is still sending";
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(10));
  const std::string fine = client.raw("POST " + raw +
                                      " HTTP/1.1\r\nHost: localhost\r\nContent-Length: 4\r\n"
                                      "Expect: 100-continue\r\n\r\nabcd");
  EXPECT_EQ(fine.substr(0, 12), "HTTP/1.1 100");
}

TEST_F(Http, RefusesBodiesOfUnclearLength) {
  for (const char* headers :
       {"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n", "Content-Length: 4\r\nContent-Length: 5\r\n",
        "Content-Length: -1\r\n", "Content-Length: 4x\r\n", "Transfer-Encoding: gzip, chunked\r\n"}) {
    const std::string answer = client.raw("POST " + raw + " HTTP/1.1\r\nHost: localhost\r\n" + headers +
                                          "\r\nGET /livez HTTP/1.1\r\nHost: localhost\r\n\r\n");
    EXPECT_EQ(answer.substr(0, 12), "HTTP/1.1 400") << headers;
    EXPECT_EQ(answers(answer), 1U) << "what follows is not taken for a request: " << answer;
  }
}

TEST_F(Http, ForgetsUploadsThatBreakOff) {
  for (const char* end : {"Content-Length: 13824\r\n\r\nabc", "Transfer-Encoding: chunked\r\n\r\n5\r\nab"}) {
    // This client goes away after a second of silence.
    client.raw("POST " + raw + " HTTP/1.1\r\nHost: localhost\r\n" + end, 1);
  }
  EXPECT_TRUE(client.get("/v1/volumes").json()["volumes"].empty());
  // Its connections end with the server at the latest, and with them what had arrived.
  EXPECT_EQ(server.terminate(), 0);
  std::size_t left = 0;
  for (const auto& entry : std::filesystem::recursive_directory_iterator(folder.path() / "data" / "blobs")) {
    left += entry.is_regular_file() ? 1 : 0;
  }
  EXPECT_EQ(left, 0U);
}

TEST_F(Http, NeverTakesABodyForARequest) {
  const std::string smuggled = "GET /version HTTP/1.1\r\nHost: localhost\r\n\r\n";
  const std::string length = "Content-Length: " + std::to_string(smuggled.size()) + "\r\n";
  for (const std::string line :
       {"GET /livez", "HEAD /livez", "DELETE /v1/models/none", "POST /nothing", "PUT /v1/models"}) {
    const std::string answer = client.raw(line + " HTTP/1.1\r\nHost: localhost\r\n" + length + "\r\n" + smuggled);
    EXPECT_EQ(answers(answer), 1U) << line << "\n" << answer;
  }
}

TEST_F(Http, WaitsForNoBodyThatIsNotAnnounced) {
  const auto start = Clock::now();
  EXPECT_EQ(
      client.raw("POST /v1/jobs/none/cancel HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n").substr(0, 12),
      "HTTP/1.1 404");
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(3));
}

TEST_F(Http, AnswersNonsenseWithProblems) {
  for (const std::string& request :
       {std::string("nonsense\r\n\r\n"), std::string("GET /livez HTTP/9.9\r\n\r\n"),
        std::string("BREW / HTTP/1.1\r\n\r\n"), "GET /" + std::string(9000, 'a') + " HTTP/1.1\r\n\r\n",
        "GET /" + std::string(5000, 'a') + " HTTP/1.1\r\n\r\n",
        std::string("TRACE / HTTP/1.1\r\nHost: localhost\r\n\r\n"), std::string("PRI * HTTP/2.0\r\n\r\nSM\r\n\r\n"),
        std::string("PRI / HTTP/1.1\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\n")}) {
    const std::string answer = client.raw(request);
    EXPECT_EQ(answer.substr(0, 10), "HTTP/1.1 4") << request.substr(0, 40);
    EXPECT_NE(answer.find("Content-Type: application/problem+json"), std::string::npos) << request.substr(0, 40);
    EXPECT_EQ(answers(answer), 1U) << answer;
  }
  EXPECT_EQ(client.raw(""), "");
  EXPECT_EQ(client.get("/livez").status, 200);
}

TEST_F(Http, KeepsConnectionsAliveAfterErrors) {
  const std::string answers =
      client.raw("POST /v1/volumes?x=1 HTTP/1.1\r\nHost: localhost\r\nContent-Length: 5\r\n\r\nhello");
  EXPECT_EQ(answers.substr(0, 12), "HTTP/1.1 400");
  EXPECT_NE(answers.find("Keep-Alive"), std::string::npos) << "the small body was read to its end";
  EXPECT_EQ(answers.find("Connection: close"), std::string::npos);
}

TEST_F(Http, LimitsStreamsWithoutStarvingOthers) {
  const std::string big = client.upload("?format=raw&dims=150,150,150&dtype=uint8", ball(150, 74));
  std::string job;
  {
    const Answer accepted = client.post("/v1/models", {.body = Json{{"volume", big}, {"threshold", 3}}.dump()});
    ASSERT_EQ(accepted.status, 202);
    job = accepted.header("Location");
  }
  std::vector<std::jthread> readers;
  std::atomic<int> streams{0}, refused{0};
  for (int i = 0; i < 8; ++i) {
    readers.emplace_back([&] {
      const Answer answer = client.get(job + "/events");
      (answer.status == 200 ? streams : refused)++;
    });
  }
  const auto start = Clock::now();
  while (refused < 5 && Clock::now() - start < std::chrono::seconds(20)) std::this_thread::yield();
  EXPECT_EQ(client.get("/livez").status, 200);
  EXPECT_EQ(client.post(job + "/cancel").status, 202);
  readers.clear();
  EXPECT_EQ(streams, 3);
  EXPECT_EQ(refused, 5);
  EXPECT_EQ(client.get(job + "/events").status, 200) << "places are given back";
}

TEST_F(Http, CapsWaits) {
  const std::string big = client.upload("?format=raw&dims=150,150,150&dtype=uint8", ball(150, 74));
  const auto start = Clock::now();
  const Answer answer = client.post(
      "/v1/models", {.headers = {{"Prefer", "wait=3600"}}, .body = Json{{"volume", big}, {"threshold", 3}}.dump()});
  EXPECT_EQ(answer.header("Preference-Applied"), "wait=2");
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(20));
  EXPECT_TRUE(answer.status == 202 || answer.status == 201);
  if (answer.status == 202) client.post(answer.header("Location") + "/cancel");
}

TEST_F(Http, AnswersManyClientsAtOnce) {
  std::vector<std::jthread> clients;
  std::atomic<int> good{0};
  for (int i = 0; i < 40; ++i) {
    clients.emplace_back([&, i] {
      for (int k = 0; k < 5; ++k) {
        if (client.get(i % 2 ? "/livez" : "/v1/volumes?limit=1").status == 200) ++good;
      }
    });
  }
  clients.clear();
  EXPECT_EQ(good, 200);
}

TEST_F(Http, StopsGracefully) {
  const std::string big = client.upload("?format=raw&dims=150,150,150&dtype=uint8", ball(150, 74));
  const Answer accepted = client.post("/v1/models", {.body = Json{{"volume", big}, {"threshold", 3}}.dump()});
  std::jthread waiting([&] { client.get(accepted.header("Location") + "/events"); });
  const auto start = Clock::now();
  EXPECT_EQ(server.terminate(), 0);
  EXPECT_LT(Clock::now() - start, std::chrono::seconds(15));
}

}  // namespace
}  // namespace spherule::test
