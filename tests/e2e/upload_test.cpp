// SPDX-License-Identifier: GPL-3.0-or-later
//
// Large files: in pieces, over restarts, in archives, within limits.
#include <gtest/gtest.h>

#include <chrono>
#include <memory>

#include "tests/archives.h"
#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

using std::chrono::steady_clock;
using namespace std::chrono_literals;

const std::string kPiece = "application/offset+octet-stream";

class Uploads : public testing::Test {
 protected:
  void start() {
    server.reset();
    server = std::make_unique<ServerProcess>(
        folder.path() / "data", std::vector<std::string>{"--max-body-bytes", "4M", "--max-decompressed-bytes", "16M",
                                                         "--cors-origins", "https://viewer.example"});
  }
  Uploads() { start(); }
  Client client() const { return Client(server->port()); }
  std::string begin(std::size_t length, const std::string& metadata = "filename c2Nhbi5yYXc=") const {
    const Answer begun = client().post("/v1/uploads", {.headers = {{"Upload-Length", std::to_string(length)},
                                                                   {"Upload-Metadata", metadata},
                                                                   {"Tus-Resumable", "1.0.0"}}});
    EXPECT_EQ(begun.status, 201) << begun.body;
    return begun.header("Location");
  }
  Answer patch(const std::string& upload, std::size_t offset, const std::string& bytes) const {
    return client().ask("PATCH", upload,
                        {.headers = {{"Upload-Offset", std::to_string(offset)}}, .body = bytes, .type = kPiece});
  }
  std::size_t offset(const std::string& upload) const {
    return std::stoul(client().ask("HEAD", upload).header("Upload-Offset"));
  }

  TemporaryFolder folder;
  std::unique_ptr<ServerProcess> server;
  const std::string raw = "format=raw&dims=24,24,24&dtype=uint8";
};

TEST_F(Uploads, GoOnAfterBreaksAndRestarts) {
  const std::string bytes = ball(24, 11.5);
  const std::string upload = begin(bytes.size());
  const std::string id = upload.substr(upload.rfind('/') + 1);
  EXPECT_EQ(offset(upload), 0U);
  // The client goes away in the middle of a piece.
  client().raw("PATCH " + upload + " HTTP/1.1\r\nHost: localhost\r\nUpload-Offset: 0\r\nContent-Type: " + kPiece +
                   "\r\nContent-Length: 13824\r\n\r\n" + bytes.substr(0, 5000),
               1);
  // What came is written when the machine gets to it, which nobody has promised the client.
  for (const auto begin = steady_clock::now(); offset(upload) < 5000U && steady_clock::now() - begin < 60s;) continue;
  EXPECT_EQ(client().post("/v1/volumes?" + raw + "&upload=" + id).status, 409) << "bytes are missing";
  server->kill();
  start();
  EXPECT_EQ(offset(upload), 5000U);
  EXPECT_EQ(patch(upload, 4000, bytes.substr(4000)).status, 409);
  EXPECT_EQ(patch(upload, 5000, bytes.substr(5000, 3000)).header("Upload-Offset"), "8000");
  EXPECT_EQ(patch(upload, 8000, bytes.substr(8000) + "x").status, 413) << "more than announced";
  const std::size_t at = offset(upload);
  EXPECT_LE(at, bytes.size());
  if (at < bytes.size()) {
    EXPECT_EQ(patch(upload, at, bytes.substr(at)).status, 204);
  }
  EXPECT_EQ(client().post("/v1/volumes?format=raw&dims=99,99,99&dtype=uint8&upload=" + id).status, 400);
  const Answer made = client().post("/v1/volumes?" + raw + "&upload=" + id);
  EXPECT_EQ(made.status, 201) << made.body;
  EXPECT_EQ(client().get(made.header("Location") + "/content").body, bytes);
  EXPECT_EQ(client().get(upload).status, 404) << "used up";
  EXPECT_EQ(Json(client().upload("?" + raw, bytes)), made.json()["id"]) << "the same volume as by one request";
}

TEST_F(Uploads, MakeAVolumeOfSeveralFiles) {
  const std::string header =
      "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 24 24 24\n"
      "ElementSpacing = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = scan.raw\n";
  const std::string first = begin(header.size(), "filename c2Nhbi5taGQ="), second = begin(ball(24, 11.5).size());
  EXPECT_EQ(patch(first, 0, header).status, 204);
  EXPECT_EQ(patch(second, 0, ball(24, 11.5)).status, 204);
  const Answer made = client().post("/v1/volumes?upload=" + first.substr(12) + "," + second.substr(12));
  EXPECT_EQ(made.status, 201) << made.body;
  EXPECT_EQ(made.json()["format"], "metaimage");
  EXPECT_EQ(client().ask("DELETE", begin(5)).status, 204);
}

TEST_F(Uploads, RefuseWhatIsTooLarge) {
  EXPECT_EQ(client().post("/v1/uploads", {.headers = {{"Upload-Length", "4194305"}}}).status, 413);
}

TEST_F(Uploads, UnpackZipArchives) {
  const std::string header =
      "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 24 24 24\n"
      "ElementSpacing = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = Doe_Jane.raw\n";
  const std::string samples = ball(24, 11.5);
  const std::vector<ZipEntry> files = {{"Doe/Doe_Jane.mhd", header}, {"Doe/Doe_Jane.raw", samples}};
  const Answer made = client().post("/v1/volumes", {.body = zip(files), .type = "application/zip"});
  ASSERT_EQ(made.status, 201) << made.body;
  EXPECT_EQ(made.json()["format"], "metaimage");
  EXPECT_EQ(made.json()["files"].size(), 2U);
  EXPECT_EQ(made.body.find("Doe"), std::string::npos);
  EXPECT_EQ(client().get(made.header("Location") + "/content?file=1").body, samples);
  EXPECT_EQ(
      client().post("/v1/volumes", {.body = zip({{"../Doe_Jane.mhd", header}}), .type = "application/zip"}).status,
      400);
  EXPECT_EQ(client().post("/v1/volumes", {.body = zip(files).substr(0, 9000), .type = "application/zip"}).status, 400);
  EXPECT_EQ(server->log().find("Doe"), std::string::npos);
}

TEST_F(Uploads, RepeatPostsByTheirKey) {
  const Ask ask{.headers = {{"Idempotency-Key", "0b5e-1"}}, .body = ball(24, 11.5)};
  const Answer first = client().post("/v1/volumes?" + raw, ask);
  EXPECT_EQ(first.status, 201);
  server->kill();
  start();
  const Answer again = client().post("/v1/volumes?" + raw, ask);
  EXPECT_EQ(again.status, 201) << "as the first time";
  EXPECT_EQ(again.body, first.body);
  EXPECT_EQ(again.header("Idempotency-Replayed"), "true");
  EXPECT_EQ(client().post("/v1/volumes?" + raw, {.headers = ask.headers, .body = ball(24, 11)}).status, 422);
}

TEST_F(Uploads, OfPagesOfOtherOrigins) {
  const Answer preflight = client().ask("OPTIONS", "/v1/volumes",
                                        {.headers = {{"Origin", "https://viewer.example"},
                                                     {"Access-Control-Request-Method", "POST"},
                                                     {"Access-Control-Request-Headers", "content-type"}}});
  EXPECT_EQ(preflight.status, 204);
  EXPECT_EQ(preflight.header("Access-Control-Allow-Origin"), "https://viewer.example");
  const Answer refused = client().get("/v1/volumes/none", {.headers = {{"Origin", "https://viewer.example"}}});
  EXPECT_EQ(refused.status, 404);
  EXPECT_EQ(refused.header("Access-Control-Allow-Origin"), "https://viewer.example") << "pages read refusals too";
  EXPECT_EQ(client()
                .get("/v1/volumes", {.headers = {{"Origin", "https://else.example"}}})
                .header("Access-Control-Allow-Origin"),
            "");
}

TEST_F(Uploads, AreSeenInTheMetrics) {
  const Answer volume = client().post("/v1/volumes?" + raw, {.body = ball(24, 11.5)});
  client().get("/v1/volumes/none");
  client().model({{"volume", volume.json()["id"]}, {"threshold", 99}});
  const std::string text = client().get("/metrics").body;
  EXPECT_NE(text.find("spherule_http_requests_total{method=\"POST\",route=\"/v1/volumes\",status=\"201\"} 1\n"),
            std::string::npos)
      << text;
  EXPECT_NE(text.find("route=\"/v1/volumes/{volume}\",status=\"404\"} 1\n"), std::string::npos);
  EXPECT_NE(text.find("spherule_http_request_duration_seconds_bucket{route=\"/v1/volumes\",le=\"+Inf\"} 1\n"),
            std::string::npos);
  EXPECT_NE(text.find("spherule_jobs{state=\"running\"} 0\n"), std::string::npos);
  EXPECT_NE(text.find("spherule_jobs_ended_total{kind=\"model\",state=\"succeeded\"} 1\n"), std::string::npos) << text;
  EXPECT_EQ(text.find("vol_"), std::string::npos) << "no ids in labels";
}

}  // namespace
}  // namespace spherule::test
