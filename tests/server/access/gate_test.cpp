// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/access/gate.h"

#include <gtest/gtest.h>

#include <fstream>
#include <sstream>

#include "server/base/digest.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

const std::string volume = "vol_" + std::string(32, '1'), model = "mdl_" + std::string(32, '2');

class GateTest : public testing::Test {
 protected:
  test::TemporaryFolder folder;
  AppendLog audit{folder.path() / "audit.log"};
  std::string token = new_token();
  std::vector<std::string> passed;  // clients

  api::Response pass(const Gate& gate, api::Request request, int status = 200, const std::string& location = {}) {
    request.id = "req_1";
    return gate.pass(request, [&](const std::string& client) {
      passed.push_back(client);
      api::Response response{.status = status};
      if (!location.empty()) response.set("Location", location);
      response.route = "/the/{route}";
      return response;
    });
  }
  Gate with(Scope scope) { return {{.keys = {{"ward", scope, sha256_hex(token)}}}, audit}; }
  api::Request request(const std::string& method, const std::string& path) const {
    api::Request r;
    r.method = method;
    r.path = path;
    r.headers = {{"authorization", "Bearer " + token}};
    return r;
  }
  std::string events() const {
    std::ostringstream text;
    text << std::ifstream(folder.path() / "audit.log").rdbuf();
    return text.str();
  }
};

TEST_F(GateTest, WithoutKeysEverybodyPasses) {
  const Gate open({}, audit);
  EXPECT_EQ(pass(open, {.method = "DELETE", .path = "/v1/volumes/" + volume}, 204).status, 204);
  EXPECT_EQ(passed, std::vector<std::string>{"local"});
  EXPECT_NE(events().find("\"who\":\"local\",\"action\":\"DELETE /the/{route}\",\"object\":\"" + volume +
                          "\",\"outcome\":\"allowed\",\"status\":204,\"request\":\"req_1\""),
            std::string::npos)
      << events();
}

TEST_F(GateTest, AsksForAKey) {
  const Gate gate = with(Scope::read);
  for (const std::string& shown : {std::string(), std::string("Bearer x"), "Basic " + token}) {
    api::Request asked = request("GET", "/v1/volumes");
    asked.headers = {{"Authorization", shown}};
    const api::Response refused = pass(gate, asked);
    EXPECT_EQ(refused.status, 401);
    EXPECT_EQ(refused.header("WWW-Authenticate"), "Bearer realm=\"spherule\"");
    EXPECT_EQ(refused.header("Content-Type"), "application/problem+json");
    EXPECT_EQ(refused.header("X-Request-Id"), "req_1");
  }
  EXPECT_TRUE(passed.empty());
  EXPECT_EQ(pass(gate, {.method = "GET", .path = "/livez"}).status, 200);
  EXPECT_EQ(pass(gate, request("GET", "/v1/volumes")).status, 200);
  EXPECT_EQ(passed, (std::vector<std::string>{"local", "ward"}));
}

TEST_F(GateTest, AsksForTheScope) {
  const api::Response refused = pass(with(Scope::read), request("POST", "/v1/models"));
  EXPECT_EQ(refused.status, 403);
  EXPECT_EQ(refused.header("WWW-Authenticate"),
            "Bearer realm=\"spherule\", error=\"insufficient_scope\", scope=\"write\"");
  EXPECT_EQ(pass(with(Scope::write), request("DELETE", "/v1/models/" + model)).status, 403);
  EXPECT_TRUE(passed.empty());
  EXPECT_EQ(pass(with(Scope::write), request("POST", "/v1/models")).status, 200);
  EXPECT_EQ(pass(with(Scope::admin), request("DELETE", "/v1/models/" + model)).status, 200);
  EXPECT_EQ(pass(with(Scope::admin), request("GET", "/v1/models/" + model)).status, 200);
}

TEST_F(GateTest, WritesDownWhoDidWhatToWhat) {
  const Gate gate = with(Scope::write);
  pass(gate, request("POST", "/v1/models"), 201, "/v1/models/" + model);
  EXPECT_NE(events().find("\"who\":\"ward\",\"action\":\"POST /the/{route}\",\"object\":\"" + model +
                          "\",\"outcome\":\"allowed\",\"status\":201"),
            std::string::npos)
      << events();
  pass(gate, request("GET", "/v1/volumes/" + volume + "/content"));
  EXPECT_NE(events().find("\"action\":\"GET /the/{route}\",\"object\":\"" + volume + "\""), std::string::npos);
  pass(gate, request("POST", "/v1/volumes"), 507);
  EXPECT_NE(events().find("\"outcome\":\"failed\",\"status\":507"), std::string::npos);
  pass(gate, request("DELETE", "/v1/volumes/" + volume));
  EXPECT_NE(events().find("\"who\":\"ward\",\"action\":\"DELETE /v1/volumes/{volume}\",\"object\":\"" + volume +
                          "\",\"outcome\":\"denied\",\"status\":403"),
            std::string::npos)
      << events();
}

TEST_F(GateTest, WritesDownUploadsAndRoutesOfTheDenied) {
  const Gate gate = with(Scope::write);
  const std::string upload = "upl_" + std::string(32, '4'), registration = "reg_" + std::string(32, '5');
  pass(gate, request("POST", "/v1/uploads"), 201, "/v1/uploads/" + upload);
  pass(gate, request("DELETE", "/v1/registrations/" + registration));
  api::Request stranger = request("PATCH", "/v1/uploads/" + upload);
  stranger.headers.clear();
  EXPECT_TRUE(gate.refusal(stranger));
  EXPECT_FALSE(gate.refusal(request("PATCH", "/v1/uploads/" + upload)));
  EXPECT_NE(events().find("\"object\":\"" + upload + "\",\"outcome\":\"allowed\",\"status\":201"), std::string::npos)
      << events();
  EXPECT_NE(events().find("\"action\":\"DELETE /v1/registrations/{registration}\",\"object\":\"" + registration +
                          "\",\"outcome\":\"denied\",\"status\":403"),
            std::string::npos)
      << events();
  EXPECT_NE(events().find("\"action\":\"PATCH /v1/uploads/{upload}\",\"object\":\"" + upload +
                          "\",\"outcome\":\"denied\",\"status\":401"),
            std::string::npos)
      << events();
}

TEST_F(GateTest, AnswersToItsOwnNamesOnly) {
  const auto status = [&](const Gate& gate, const std::string& host) {
    return pass(gate, {.method = "GET", .path = "/v1/volumes", .headers = {{"Host", host}}}).status;
  };
  const Gate open({.hosts = {"scans.example"}}, audit);
  for (const char* own : {"localhost", "localhost:8080", "LOCALHOST", "a.localhost:1", "127.0.0.1:8080", "127.9.9.9",
                          "[::1]", "[::1]:8080", "scans.example", "Scans.Example:443", ""}) {
    EXPECT_EQ(status(open, own), 200) << own;
  }
  for (const char* other : {"evil.example", "evil.example:8080", "localhost.evil.example", "127.0.0.1.evil.example",
                            "0.0.0.0", "192.168.0.1", "[::]", "[::2]:80", "notlocalhost", "127.0.0.1x"}) {
    EXPECT_EQ(status(open, other), 403) << other;
  }
  const Gate keyed({.keys = {{"ward", Scope::read, sha256_hex(token)}}}, audit);
  api::Request named = request("GET", "/v1/volumes");
  named.headers.emplace_back("Host", "any.example");
  EXPECT_EQ(pass(keyed, named).status, 200) << "a page has no key that it was not given";
  const Gate both({.keys = {{"ward", Scope::read, sha256_hex(token)}}, .hosts = {"scans.example"}}, audit);
  EXPECT_EQ(pass(both, named).status, 403) << "but names that are listed are meant";
}

TEST_F(GateTest, LetsPagesOfOthersChangeNothing) {
  const Gate gate({.origins = {"https://viewer.example"}}, audit);
  using Headers = std::vector<std::pair<std::string, std::string>>;
  const auto status = [&](const std::string& method, Headers headers) {
    headers.emplace_back("Host", "localhost:8080");
    return pass(gate, {.method = method, .path = "/v1/volumes", .headers = headers}).status;
  };
  const std::vector<std::pair<Headers, int>> cases = {
      {{}, 200},  // what is no browser
      {{{"Origin", "http://localhost:8080"}, {"Sec-Fetch-Site", "same-origin"}}, 200},
      {{{"Origin", "HTTPS://LOCALHOST:8080"}}, 200},
      {{{"Sec-Fetch-Site", "none"}}, 200},
      {{{"Origin", "https://viewer.example"}, {"Sec-Fetch-Site", "cross-site"}}, 200},
      {{{"Origin", "https://evil.example"}}, 403},
      {{{"Origin", "https://evil.example"}, {"Sec-Fetch-Site", "same-origin"}}, 403},
      {{{"Origin", "http://localhost:3000"}, {"Sec-Fetch-Site", "same-site"}}, 403},
      {{{"Origin", "null"}}, 403},
      {{{"Sec-Fetch-Site", "cross-site"}}, 403},
      {{{"Sec-Fetch-Site", "same-site"}}, 403},
  };
  for (const auto& [headers, expected] : cases) {
    for (const char* method : {"POST", "PATCH", "DELETE", "PUT"}) {
      EXPECT_EQ(status(method, headers), expected) << method << (headers.empty() ? "" : headers[0].second);
    }
    EXPECT_EQ(status("GET", headers), 200) << "which pages of others cannot read the answers of";
  }
}

TEST_F(GateTest, SharesStreamsOut) {
  const Gate gate({.streams_of_client = 2}, audit);
  const auto open = [&] {
    return gate.pass({.method = "GET", .path = "/v1/jobs/job_1/events"}, [](const std::string&) {
      return api::Response{.body = api::EventSource([](std::string& out) {
                             out += "x";
                             return true;
                           })};
    });
  };
  const api::Response first = open();
  std::optional<api::Response> second = open();
  EXPECT_EQ(second->status, 200);
  EXPECT_EQ(open().status, 429);
  std::string out;
  EXPECT_TRUE(std::get<api::EventSource>(first.body)(out));
  EXPECT_EQ(out, "x");
  second.reset();
  EXPECT_EQ(open().status, 200) << "places are given back";
}

TEST_F(GateTest, LeavesOutWhatTellsNothing) {
  const Gate gate = with(Scope::read);
  for (const std::string& path : {std::string("/v1/jobs/job_") + std::string(32, '3'), std::string("/version"),
                                  std::string("/v1/volumes"), std::string("/livez")})
    pass(gate, request("GET", path));
  EXPECT_EQ(events(), "");
}

TEST_F(GateTest, RepeatsNothingThatAClientWrote) {
  const Gate gate = with(Scope::write);
  api::Request telling = request("POST", "/v1/volumes/DOE^JOHN^19620401");
  telling.query = {{"name", "DOE"}};
  telling.headers.emplace_back("traceparent", "00-DOE^JOHN");
  telling.headers.emplace_back("User-Agent", "DOE");
  pass(gate, telling);
  telling.headers[0].second = "Bearer DOE";
  pass(gate, telling);
  EXPECT_EQ(events().find("DOE"), std::string::npos) << events();
  EXPECT_EQ(events().find(token), std::string::npos);
}

}  // namespace
}  // namespace spherule::server
