// SPDX-License-Identifier: GPL-3.0-or-later
//
// What holds for all resources: preconditions, idempotency keys, other origins; and uploads in pieces, and metrics.
#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "api/http/cors.h"
#include "api/routes.h"
#include "tests/api/stub.h"
#include "tests/contract/contract.h"

namespace spherule::test {
namespace {

using api::Response;
using Headers = std::vector<std::pair<std::string, std::string>>;

class Semantics : public testing::Test {
 protected:
  static api::Request request(const std::string& method, const std::string& path, Headers headers = {},
                              Headers query = {}) {
    return {.method = method, .path = path, .query = std::move(query), .headers = std::move(headers), .id = "req_1"};
  }
  Response ask(api::Request asked, const std::string& bytes = {}) {
    StubBody body(bytes);
    asked.body = &body;
    Response response = api::handle(service, asked);
    const auto* text = std::get_if<std::string>(&response.body);
    if (asked.method != "OPTIONS" && response.status != 405) {
      for (const std::string& wrong : violations(asked.method, asked.path, response.status,
                                                 response.header("Content-Type"), text ? *text : std::string())) {
        ADD_FAILURE() << wrong;
      }
    }
    return response;
  }
  static const std::string& text(const Response& response) { return std::get<std::string>(response.body); }
  static nlohmann::json json(const Response& response) { return nlohmann::json::parse(text(response)); }

  StubService service;
  const std::string volume = "/v1/volumes/" + kVolume;
};

TEST_F(Semantics, IfMatchGuardsReadingAndDeleting) {
  const std::string tag(ask(request("GET", volume)).header("ETag"));
  ASSERT_FALSE(tag.empty());
  EXPECT_EQ(ask(request("GET", volume, {{"If-Match", tag}})).status, 200);
  EXPECT_EQ(ask(request("GET", volume, {{"If-Match", "\"other\", " + tag}})).status, 200);
  EXPECT_EQ(ask(request("GET", volume, {{"If-Match", "*"}})).status, 200);
  EXPECT_EQ(ask(request("GET", volume, {{"If-Match", "\"other\""}})).status, 412);
  EXPECT_EQ(ask(request("HEAD", volume + "/content", {{"If-Match", "\"other\""}})).status, 412);
  EXPECT_EQ(ask(request("GET", volume + "/content", {{"If-Match", "\"other\""}, {"Range", "bytes=0-1"}})).status, 412);

  EXPECT_EQ(ask(request("DELETE", volume, {{"If-Match", "\"other\""}})).status, 412);
  EXPECT_TRUE(service.deleted.empty());
  EXPECT_EQ(ask(request("DELETE", "/v1/volumes/vol_" + std::string(32, '0'), {{"If-Match", tag}})).status, 404);
  EXPECT_EQ(ask(request("DELETE", volume, {{"If-Match", tag}})).status, 204);
  EXPECT_EQ(service.deleted.size(), 1U);
}

TEST_F(Semantics, SendTheSamePostTwiceWithoutHarm) {
  const std::string wish = R"({"volume": ")" + kVolume + R"(", "threshold": 60.5})";
  const auto post = [&](const std::string& key, const std::string& body, const std::string& path = "/v1/models") {
    return ask(request("POST", path, {{"Idempotency-Key", key}}), body);
  };
  service.finished = false;
  const Response first = post("k1", wish);
  EXPECT_EQ(first.status, 202);
  EXPECT_EQ(first.header("Idempotency-Replayed"), "");
  service.finished = true;
  service.made.reset();
  const Response again = post("k1", wish);
  EXPECT_EQ(again.status, 202) << "the first answer, although the model is finished now";
  EXPECT_EQ(text(again), text(first));
  EXPECT_EQ(again.header("Location"), first.header("Location"));
  EXPECT_EQ(again.header("Idempotency-Replayed"), "true");
  EXPECT_EQ(again.header("X-Request-Id"), "req_1");
  EXPECT_FALSE(service.made) << "nothing was asked of the service";

  EXPECT_EQ(post("k1", wish + " ").status, 422);
  EXPECT_EQ(post("k1", wish, "/v1/volumes").status, 422) << "another path";
  EXPECT_EQ(post("k2", wish).status, 200) << "another key";

  // Refusals are not kept, nor their keys.
  EXPECT_EQ(post("k3", "{}").status, 400);
  EXPECT_EQ(post("k3", wish).status, 200);
  EXPECT_EQ(service.kept.size(), 3U);

  EXPECT_EQ(post("with space", wish).status, 400);
  EXPECT_EQ(post(std::string(256, 'k'), wish).status, 400);
}

TEST_F(Semantics, IdempotencyKeysBelongToTheirClient) {
  const std::string wish = R"({"volume": ")" + kVolume + R"(", "threshold": 60.5})";
  for (const char* client : {"ward", "lab"}) {
    api::Request asked = request("POST", "/v1/models", {{"Idempotency-Key", "k"}});
    asked.client = client;
    EXPECT_EQ(ask(asked, wish).header("Idempotency-Replayed"), "") << client;
  }
}

TEST_F(Semantics, AllowOriginsOfTheList) {
  const api::AllowedOrigins allowed = api::origins_from("https://a.example/, https://b.example");
  const auto answer = [] {
    Response response{.status = 200, .body = "x"};
    response.set("ETag", "\"1\"");
    return response;
  };
  const auto asked = [](const std::string& method, const std::string& origin, bool preflight) {
    api::Request r = request(method, "/v1/models", {{"Origin", origin}});
    if (preflight) r.headers.emplace_back("Access-Control-Request-Method", "POST");
    return r;
  };
  const Response plain = api::with_cors(allowed, asked("GET", "https://b.example", false), answer);
  EXPECT_EQ(plain.header("Access-Control-Allow-Origin"), "https://b.example");
  const std::string exposed = ", " + std::string(plain.header("Access-Control-Expose-Headers")) + ",";
  for (const char* name : {"ETag", "Location", "Link", "Retry-After", "Allow", "Content-Range", "WWW-Authenticate"}) {
    EXPECT_NE(exposed.find(", " + std::string(name) + ","), std::string::npos) << name;
  }
  // All that the contract knows of.
  std::string_view contract = api::contract();
  contract.remove_prefix(contract.find("\ncomponents:\n"));
  contract.remove_prefix(contract.find("\n  headers:\n") + 12);
  std::size_t headers = 0;
  for (std::string_view line; line.empty() || line.starts_with("    ");) {
    if (line.size() > 5 && line[4] != ' ') {
      ++headers;
      EXPECT_NE(exposed.find(", " + std::string(line.substr(4, line.find(':') - 4)) + ","), std::string::npos) << line;
    }
    line = contract.substr(0, contract.find('\n'));
    contract.remove_prefix(std::min(line.size() + 1, contract.size()));
    if (contract.empty()) break;
  }
  EXPECT_GE(headers, 10U);
  EXPECT_EQ(plain.header("Vary"), "Origin");
  const Response preflight = api::with_cors(allowed, asked("OPTIONS", "https://a.example", true), answer);
  EXPECT_EQ(preflight.status, 204);
  EXPECT_NE(preflight.header("Access-Control-Allow-Headers").find("Idempotency-Key"), std::string_view::npos);
  EXPECT_NE(preflight.header("Access-Control-Allow-Methods").find("PATCH"), std::string_view::npos);
  for (const char* origin : {"https://c.example", "https://a.example.evil", "null", ""}) {
    const Response other = api::with_cors(allowed, asked("OPTIONS", origin, true), answer);
    EXPECT_EQ(other.status, 200) << origin;
    EXPECT_EQ(other.header("Access-Control-Allow-Origin"), "") << origin;
    EXPECT_EQ(other.header("Vary"), "Origin") << "caches keep the two apart";
  }
  EXPECT_EQ(
      api::with_cors({"*"}, asked("GET", "https://c.example", false), answer).header("Access-Control-Allow-Origin"),
      "https://c.example");
  EXPECT_EQ(api::with_cors({}, asked("GET", "https://a.example", false), answer).header("Vary"), "");
}

TEST_F(Semantics, UploadInPieces) {
  const std::string path = "/v1/uploads/" + kUpload;
  const Response options = ask(request("OPTIONS", "/v1/uploads"));
  EXPECT_EQ(options.status, 204);
  EXPECT_EQ(options.header("Tus-Version"), "1.0.0");
  EXPECT_EQ(options.header("Tus-Max-Size"), "1000");
  EXPECT_NE(options.header("Tus-Extension").find("creation"), std::string_view::npos);
  EXPECT_EQ(ask(request("GET", "/v1/uploads/upl_0")).status, 404);

  EXPECT_EQ(ask(request("POST", "/v1/uploads")).status, 400) << "no Upload-Length";
  EXPECT_EQ(ask(request("POST", "/v1/uploads", {{"Upload-Length", "-1"}})).status, 400);
  EXPECT_EQ(ask(request("POST", "/v1/uploads", {{"Upload-Length", "10"}, {"Tus-Resumable", "2.0.0"}})).status, 412);
  EXPECT_EQ(ask(request("POST", "/v1/uploads", {{"Upload-Length", "10"}, {"Upload-Metadata", "filename !"}})).status,
            400);
  EXPECT_EQ(ask(request("POST", "/v1/uploads", {{"Upload-Length", "10"}}), "abc").status, 415);

  const Response begun = ask(request("POST", "/v1/uploads",
                                     {{"Upload-Length", "10"},
                                      {"Tus-Resumable", "1.0.0"},
                                      {"Content-Type", "application/offset+octet-stream"},
                                      {"Upload-Metadata", "is_confidential,filename Y3QtaGVhZC5taGQ=,other eA=="}}),
                             "abc");
  EXPECT_EQ(begun.status, 201);
  EXPECT_EQ(begun.header("Location"), path);
  EXPECT_EQ(begun.header("Upload-Offset"), "3") << "creation with upload";
  EXPECT_EQ(begun.header("Upload-Expires"), "Thu, 01 Jan 1970 00:00:00 GMT");
  EXPECT_EQ(service.resumable.filename, "ct-head.mhd");
  EXPECT_EQ(text(begun).find("ct-head"), std::string::npos) << "names of files may tell about a patient";

  const Response head = ask(request("HEAD", path, {{"Tus-Resumable", "1.0.0"}}));
  EXPECT_EQ(head.status, 200);
  EXPECT_EQ(head.header("Upload-Offset"), "3");
  EXPECT_EQ(head.header("Upload-Length"), "10");
  EXPECT_EQ(head.header("Cache-Control"), "no-store");

  const auto patch = [&](const std::string& offset, const std::string& type, const std::string& bytes) {
    return ask(request("PATCH", path, {{"Upload-Offset", offset}, {"Content-Type", type}}), bytes);
  };
  const std::string type = "application/offset+octet-stream";
  EXPECT_EQ(patch("3", "application/octet-stream", "defg").status, 415);
  EXPECT_EQ(patch("", type, "defg").status, 400);
  EXPECT_EQ(patch("4", type, "efg").status, 409);
  const Response more = patch("3", type, "defghij");
  EXPECT_EQ(more.status, 204);
  EXPECT_EQ(more.header("Upload-Offset"), "10");
  EXPECT_EQ(json(ask(request("GET", path)))["links"]["volume"], "/v1/volumes?upload=" + kUpload);

  EXPECT_EQ(ask(request("POST", "/v1/volumes", {}, {{"upload", kUpload}}), "x").status, 400) << "no body beside it";
  EXPECT_EQ(ask(request("POST", "/v1/volumes", {}, {{"upload", ","}})).status, 400);
  EXPECT_EQ(ask(request("POST", "/v1/volumes", {}, {{"upload", "upl_0"}})).status, 404);
  service.failure.emplace(ErrorCode::malformed, "This is no volume.");
  EXPECT_EQ(ask(request("POST", "/v1/volumes", {}, {{"upload", kUpload}})).status, 400);
  EXPECT_TRUE(service.deleted.empty()) << "it stays, to be tried with other parameters";
  service.failure.reset();
  service.files.clear();
  EXPECT_EQ(ask(request("POST", "/v1/volumes", {}, {{"upload", kUpload}})).status, 200);
  EXPECT_EQ(service.files.at(0), std::make_pair(std::string("ct-head.mhd"), std::string("abcdefghij")));
  EXPECT_EQ(service.announced, 10U);
  EXPECT_EQ(service.deleted, std::vector{kUpload}) << "used up";
  EXPECT_EQ(ask(request("DELETE", path, {{"Tus-Resumable", "1.0.0"}})).status, 204);
}

TEST_F(Semantics, ShowMetricsToPrometheus) {
  const Response response =
      ask(request("GET", "/metrics", {{"Accept", "application/openmetrics-text;q=0.9,text/plain;q=0.5,*/*;q=0.1"}}));
  EXPECT_EQ(response.status, 200);
  EXPECT_EQ(response.header("Content-Type"), "text/plain; version=0.0.4; charset=utf-8");
  EXPECT_EQ(text(response),
            "# HELP spherule_test Of the test.\n# TYPE spherule_test gauge\n"
            "spherule_test{of=\"a \\\"b\\\"\\n\"} 0.5\nspherule_test_sum 3\n");
}

}  // namespace
}  // namespace spherule::test
