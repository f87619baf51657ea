// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/routes.h"

#include <gtest/gtest.h>

#include <nlohmann/json.hpp>

#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "core/base/ranges.h"
#include "tests/api/stub.h"
#include "tests/contract/contract.h"

namespace spherule::test {
namespace {

using api::Response;
using Json = nlohmann::json;

const std::string kWish = R"({"volume": ")" + kVolume + R"(", "threshold": 60.5})";

struct Extra {
  std::vector<std::pair<std::string, std::string>> headers{};
  std::string body{};
};

class Routes : public testing::Test {
 protected:
  // Asks, and holds every answer against the contract.
  Response ask(const std::string& method, const std::string& target, Extra extra = {}) {
    StubBody body(extra.body);
    return ask_with(method, target, std::move(extra.headers), &body);
  }
  Response ask_with(const std::string& method, const std::string& target,
                    std::vector<std::pair<std::string, std::string>> headers, api::Body* body) {
    api::Request request{.method = method, .path = target.substr(0, target.find('?')), .id = "req_1", .body = body};
    request.headers = std::move(headers);
    if (const std::size_t at = target.find('?'); at != std::string::npos) {
      std::string_view query = std::string_view(target).substr(at + 1);
      while (!query.empty()) {
        const std::string_view pair = query.substr(0, query.find('&'));
        const std::size_t equals = std::min(pair.find('='), pair.size());
        request.query.emplace_back(pair.substr(0, equals), pair.substr(std::min(equals + 1, pair.size())));
        query.remove_prefix(std::min(pair.size() + 1, query.size()));
      }
    }
    Response response = api::handle(service, request);
    EXPECT_EQ(response.header("X-Request-Id"), "req_1");
    if (!template_of(request.path).empty() && response.status != 405 && method != "OPTIONS") {
      std::string text;
      if (const auto* whole = std::get_if<std::string>(&response.body)) text = *whole;
      if (const auto* part = std::get_if<api::ContentPart>(&response.body)) {
        text.resize(part->length);
        part->content.read_at(part->offset, text);
      }
      for (const std::string& wrong :
           violations(method, request.path, response.status, response.header("Content-Type"), text)) {
        ADD_FAILURE() << wrong;
      }
    }
    if (response.status >= 400) {
      EXPECT_EQ(response.header("Content-Type"), "application/problem+json");
      const Json json = body_of(response);
      EXPECT_EQ(json["status"], response.status);
      EXPECT_EQ(json["instance"], "req_1");
      EXPECT_EQ(json["detail"].get<std::string>().back(), '.');
    }
    return response;
  }
  static Json body_of(const Response& response) { return Json::parse(std::get<std::string>(response.body)); }
  static std::string pointers(const Response& response) {
    std::string list;
    const Json json = body_of(response);
    for (const Json& error : json.value("errors", Json::array())) list += error["pointer"].get<std::string>() + " ";
    return list;
  }

  StubService service;
};

TEST_F(Routes, AreTheOperationsOfTheContractInItsOrder) {
  std::vector<std::pair<std::string, std::string>> table;
  for (const api::Operation& operation : api::operations()) table.emplace_back(operation.method, operation.path);
  EXPECT_EQ(table, contract_operations());
  EXPECT_FALSE(table.empty());
}

TEST_F(Routes, ContractKeepsToItsOwnSchemas) {
  for (const std::string& wrong : example_violations()) ADD_FAILURE() << wrong;
}

// What a job ends with, its answer ends with.
TEST_F(Routes, ContractListsWhatJobsEndWith) {
  int by_job = 0;
  for (const auto& [method, path] : contract_operations()) {
    const std::set<std::string> listed = listed_statuses(method, path);
    EXPECT_TRUE(listed.contains("default")) << method << " " << path;
    if (!listed.contains("200") || !listed.contains("202")) continue;
    ++by_job;
    for (const char* status : {"404", "409", "413", "422", "429", "500", "503", "507"})
      EXPECT_TRUE(listed.contains(status)) << method << " " << path << " " << status;
  }
  EXPECT_GE(by_job, 14);
}

TEST_F(Routes, TellLittleOfHoweverManyUnknownFields) {
  std::string many = "{", nested = R"({"weights": {)", longest(840'000, 'x'), parameters;
  for (int n = 0; many.size() < 840'000; ++n) many += "\"k" + std::to_string(n) + "\":1,";
  nested += many.substr(1) + R"("z": 1}})";
  many += R"("z": 1})";
  for (int n = 0; n < 5000; ++n) parameters += (n == 0 ? "?k" : "&k") + std::to_string(n) + "=1";
  for (const std::string& path : {std::string("/v1/models"), "/v1/models/" + kModel + "/simplifications",
                                  std::string("/v1/registrations"), "/v1/registrations/" + kRegistration + "/apply"}) {
    for (const std::string& body : {many, nested, R"({")" + longest + R"(": 1})"}) {
      const Response response = ask("POST", path, {.body = body});
      EXPECT_GE(response.status, 400) << path;
      EXPECT_LT(std::get<std::string>(response.body).size(), 8192U) << path;
    }
  }
  const Response response = ask("GET", "/v1/models/" + kModel + "/render" + parameters);
  EXPECT_EQ(response.status, 400);
  EXPECT_LT(std::get<std::string>(response.body).size(), 8192U);
}

TEST_F(Routes, AnswerEveryGetAndHead) {
  service.image_pixels = 2'000'000;  // registrations draw two pictures
  for (const api::Operation& operation : api::operations()) {
    if (operation.method != "GET" || operation.path.ends_with("/events")) continue;
    std::string path(operation.path);
    const auto fill = [&](const std::string& name, const std::string& value) {
      if (const std::size_t at = path.find(name); at != std::string::npos) path.replace(at, name.size(), value);
    };
    fill("{volume}", kVolume);
    fill("{model}", kModel);
    fill("{job}", kJob);
    fill("{upload}", kUpload);
    fill("{registration}", kRegistration);
    fill("{format}", "ply");
    fill("{axis}/{index}", "k/9");
    EXPECT_EQ(ask("GET", path).status, 200) << path;
    const Response head = ask("HEAD", path);
    EXPECT_EQ(head.status, 200) << path;
    EXPECT_FALSE(head.header("ETag").empty()) << path;
    const Response again = ask("GET", path, {.headers = {{"If-None-Match", std::string(head.header("ETag"))}}});
    EXPECT_EQ(again.status, 304) << path;
    EXPECT_EQ(std::get<std::string>(again.body), "") << path;
    EXPECT_EQ(ask("GET", path, {.headers = {{"If-None-Match", "\"other\", W/\"stale\""}}}).status, 200) << path;
  }
}

TEST_F(Routes, RefuseWhatIsNotThere) {
  EXPECT_EQ(ask("GET", "/").status, 404);
  EXPECT_EQ(ask("GET", "/v1/volumes/").status, 404);
  EXPECT_EQ(ask("GET", "/v1/volumes/" + kVolume + "/").status, 404);
  EXPECT_EQ(ask("GET", "/v1/volumes/" + kVolume + "/nothing").status, 404);
  EXPECT_EQ(ask("GET", "v1/volumes").status, 404);
  EXPECT_EQ(ask("GET", "").status, 404);
  EXPECT_EQ(ask("GET", "/v1/volumes/vol_0").status, 404);
  EXPECT_EQ(ask("GET", "/v1/models/" + kModel + "/exports/stl").status, 404);
  EXPECT_EQ(ask("GET", "/v1/volumes/" + kVolume + "/content?file=2").status, 404);
}

TEST_F(Routes, RefuseOtherMethodsSayingWhichThereAre) {
  const Response response = ask("PUT", "/v1/volumes");
  EXPECT_EQ(response.status, 405);
  EXPECT_EQ(response.header("Allow"), "GET, HEAD, POST, OPTIONS");
  EXPECT_EQ(ask("POST", "/v1/volumes/" + kVolume).header("Allow"), "GET, HEAD, DELETE, OPTIONS");
  const Response options = ask("OPTIONS", "/v1/jobs/" + kJob + "/cancel");
  EXPECT_EQ(options.status, 204);
  EXPECT_EQ(options.header("Allow"), "POST, OPTIONS");
}

TEST_F(Routes, RefuseUnknownParametersByName) {
  EXPECT_EQ(pointers(ask("GET", "/v1/volumes?limit=5&page=2&sort=x")), "page sort ");
  EXPECT_EQ(pointers(ask("GET", "/v1/volumes?limit=5&limit=6")), "limit ");
  EXPECT_EQ(pointers(ask("GET", "/v1/models/" + kModel + "?x=1")), "x ");
  EXPECT_EQ(pointers(ask("GET", "/v1/volumes?cursor=\xff")), "cursor ");
  for (const char* limit : {"0", "1001", "-1", "1.5", "", "ten", "99999999999999999999"}) {
    EXPECT_EQ(pointers(ask("GET", std::string("/v1/volumes?limit=") + limit)), "limit ") << limit;
  }
}

TEST_F(Routes, ListInPages) {
  const Response first = ask("GET", "/v1/volumes?limit=1");
  EXPECT_EQ(service.page.limit, 1U);
  EXPECT_EQ(first.header("Link"), "</v1/volumes?limit=1&cursor=next%2F1%2B>; rel=\"next\"");
  EXPECT_EQ(body_of(first)["next_cursor"], "next/1+");
  const Response last = ask("GET", "/v1/models?cursor=abc");
  EXPECT_EQ(service.page.cursor, "abc");
  EXPECT_EQ(service.page.limit, 100U);
  EXPECT_EQ(last.header("Link"), "");
  EXPECT_TRUE(body_of(last)["next_cursor"].is_null());
}

TEST_F(Routes, NeverShowNamesOfFiles) {
  for (const std::string path : {"/v1/volumes", "/v1/volumes/"}) {
    const Response response = ask("GET", path == "/v1/volumes" ? path : path + kVolume);
    EXPECT_EQ(std::get<std::string>(response.body).find("Doe"), std::string::npos);
  }
}

TEST_F(Routes, TakeUploadsOfOneFile) {
  service.already_stored = false;
  Response response = ask("POST", "/v1/volumes?frame=3&grid=density", {.body = "some bytes"});
  EXPECT_EQ(response.status, 201);
  EXPECT_EQ(response.header("Location"), "/v1/volumes/" + kVolume);
  EXPECT_EQ(body_of(response)["already_stored"], false);
  EXPECT_EQ(service.files, (std::vector<std::pair<std::string, std::string>>{{"", "some bytes"}}));
  EXPECT_EQ(service.announced, 10U);
  EXPECT_EQ(service.parameters.frame, 3);
  EXPECT_EQ(service.parameters.grid, "density");
  service.already_stored = true;
  response = ask("POST", "/v1/volumes", {.body = "some bytes"});
  EXPECT_EQ(response.status, 200);
  EXPECT_EQ(body_of(response)["already_stored"], true);
}

TEST_F(Routes, TakeUploadsOfSeveralFiles) {
  StubBody body({{"file", "a.mhd", "header"}, {"file", "a.raw", "data"}});
  const Response response =
      ask_with("POST", "/v1/volumes", {{"content-type", "Multipart/Form-Data; boundary=x"}}, &body);
  EXPECT_EQ(response.status, 200);
  EXPECT_EQ(service.files, (std::vector<std::pair<std::string, std::string>>{{"a.mhd", "header"}, {"a.raw", "data"}}));
  StubBody latin({{"file", "B\xe4r.mhd", "header"}});
  EXPECT_EQ(ask_with("POST", "/v1/volumes", {{"Content-Type", "multipart/form-data; boundary=x"}}, &latin).status, 400);
  StubBody wrong({{"scan", "a.mhd", "header"}});
  EXPECT_EQ(ask_with("POST", "/v1/volumes", {{"Content-Type", "multipart/form-data; boundary=x"}}, &wrong).status, 400);
}

TEST_F(Routes, DescribeRawSamples) {
  ask("POST", "/v1/volumes?format=raw&dims=4,5,6&dtype=int16&spacing=1,2.5,3e0&origin=-1,0,1&endian=big",
      {.body = "x"});
  ASSERT_TRUE(service.parameters.raw);
  const RawLayout& raw = *service.parameters.raw;
  EXPECT_EQ(raw.dims, (std::array<std::int32_t, 3>{4, 5, 6}));
  EXPECT_EQ(raw.type, VoxelType::int16);
  EXPECT_EQ(raw.spacing, (Vec3{1, 2.5, 3}));
  EXPECT_EQ(raw.origin, (Vec3{-1, 0, 1}));
  EXPECT_TRUE(raw.big_endian);
}

TEST_F(Routes, RefuseWrongDescriptionsOfRawSamples) {
  const std::string good = "/v1/volumes?format=raw&dims=4,5,6&dtype=int16";
  EXPECT_EQ(ask("POST", good, {.body = "x"}).status, 200);
  const std::vector<std::pair<std::string, std::string>> cases = {
      {"/v1/volumes?format=nifti", "format "},
      {"/v1/volumes?format=raw&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,6,7&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,6,&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,0&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,-6&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,1.5&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,1e300&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,nan&dtype=uint8", "dims "},
      {"/v1/volumes?format=raw&dims=4,5,6", "dtype "},
      {"/v1/volumes?format=raw&dims=4,5,6&dtype=short", "dtype "},
      {good + "&spacing=1,1,0", "spacing "},
      {good + "&spacing=1,1,-1", "spacing "},
      {good + "&spacing=1,1,inf", "spacing "},
      {good + "&spacing=1", "spacing "},
      {good + "&origin=a,b,c", "origin "},
      {good + "&endian=middle", "endian "},
      {good + "&frame=1", "frame "},
      {good + "&grid=x", "grid "},
      {"/v1/volumes?dims=4,5,6", "dims "},
      {"/v1/volumes?frame=-1", "frame "},
  };
  for (const auto& [target, expected] : cases) {
    const Response response = ask("POST", target, {.body = "x"});
    EXPECT_EQ(response.status, 400) << target;
    EXPECT_EQ(pointers(response), expected) << target;
  }
}

TEST_F(Routes, RefuseUploadsWithoutBodyOrOverTheLimit) {
  EXPECT_EQ(ask("POST", "/v1/volumes").status, 400);
  EXPECT_EQ(ask_with("POST", "/v1/volumes", {}, nullptr).status, 400);
  EXPECT_EQ(ask("POST", "/v1/volumes", {.body = std::string(1001, 'x')}).status, 413);
}

TEST_F(Routes, MapEveryErrorToItsStatus) {
  const std::vector<std::pair<ErrorCode, int>> table = {
      {ErrorCode::invalid_argument, 400}, {ErrorCode::malformed, 400}, {ErrorCode::unknown_format, 415},
      {ErrorCode::unusable, 422},         {ErrorCode::too_large, 413}, {ErrorCode::not_found, 404},
      {ErrorCode::conflict, 409},         {ErrorCode::no_space, 507},  {ErrorCode::busy, 503},
      {ErrorCode::throttled, 429},        {ErrorCode::cancelled, 409}};
  for (const auto& [code, status] : table) {
    service.failure.emplace(code, "Do this instead.");
    const Response response = ask("POST", "/v1/models", {.body = R"({"volume": "v", "range": [1, 2]})"});
    EXPECT_EQ(response.status, status);
    EXPECT_EQ(body_of(response)["detail"], "Do this instead.");
    EXPECT_EQ(response.header("Retry-After").empty(), status != 503 && status != 429);
  }
  EXPECT_EQ(api::status_of(ErrorCode::corrupt), 500);
}

TEST_F(Routes, HideDefects) {
  service.defect = true;
  const api::Request request{.method = "GET", .path = "/v1/volumes/" + kVolume, .id = "req_1", .body = nullptr};
  const Response response = api::handle(service, request);
  EXPECT_EQ(response.status, 500);
  EXPECT_EQ(std::get<std::string>(response.body).find("secret"), std::string::npos);
}

TEST_F(Routes, MakeModels) {
  service.already_stored = false;
  const Response created = ask("POST", "/v1/models", {.headers = {{"Prefer", "wait=10"}}, .body = kWish});
  EXPECT_EQ(created.status, 201);
  EXPECT_EQ(created.header("Location"), "/v1/models/" + kModel);
  EXPECT_EQ(created.header("Preference-Applied"), "wait=10");
  EXPECT_EQ(service.waited, 10);
  ASSERT_TRUE(service.made);
  EXPECT_EQ(service.made->volume, kVolume);
  EXPECT_EQ(service.made->rule.lo, 60.5);
  EXPECT_EQ(service.made->rule.side, Side::below) << "the volume's natural side";
  EXPECT_EQ(service.made->rule.border, Border::closed);
  const Json json = body_of(created);
  EXPECT_EQ(json["counts"]["boundary_points"], 100);
  EXPECT_EQ(json["counts"]["tetrahedra"], 600);
  EXPECT_EQ(json["bounds_mm"]["max"], Json({1, 2, 3}));

  service.already_stored = true;
  EXPECT_EQ(ask("POST", "/v1/models", {.body = kWish}).status, 200);
  EXPECT_EQ(service.waited, 0);
}

TEST_F(Routes, GiveTheJobOfAModelThatIsNotDone) {
  service.finished = false;
  const Response response = ask("POST", "/v1/models", {.headers = {{"prefer", "foo, wait=\"999999\""}}, .body = kWish});
  EXPECT_EQ(response.status, 202);
  EXPECT_EQ(response.header("Location"), "/v1/jobs/" + kJob);
  EXPECT_EQ(response.header("Preference-Applied"), "wait=60") << "the cap";
  service.awaited = false;
  const auto applied = [&](const char* preference) {
    const Response answer = ask("POST", "/v1/models", {.headers = {{"Prefer", preference}}, .body = kWish});
    EXPECT_EQ(answer.status, 202);
    return std::string(answer.header("Preference-Applied"));
  };
  EXPECT_EQ(applied("wait=10"), "") << "it did not wait";
  EXPECT_EQ(applied("respond-async"), "wait=0");
  // The range that the contract states; what is none is as if it were not there.
  service.awaited = true;
  EXPECT_EQ(applied("wait=0"), "wait=0");
  EXPECT_EQ(applied(("wait=" + std::to_string(ranges::wait_s.most)).c_str()), "wait=60");
  for (const std::string& none : {std::to_string(ranges::wait_s.most + 1), std::string("-1"), std::string("1.5"),
                                  std::string(), std::string("1e3"), std::string(30, '9')})
    EXPECT_EQ(applied(("wait=" + none).c_str()), "") << none;
  EXPECT_FALSE(response.header("Retry-After").empty());
  const Json job = body_of(response);
  EXPECT_EQ(job["state"], "running");
  EXPECT_EQ(job["links"]["cancel"], "/v1/jobs/" + kJob + "/cancel");
}

TEST_F(Routes, UnderstandEveryKindOfObject) {
  ask("POST", "/v1/models", {.body = R"({"volume": "v", "range": [-1, 2.5], "inside": "below", "border": "open"})"});
  EXPECT_EQ(service.made->rule.kind, ObjectRule::Kind::range);
  EXPECT_EQ(service.made->rule.lo, -1);
  EXPECT_EQ(service.made->rule.hi, 2.5);
  EXPECT_EQ(service.made->rule.side, Side::below);
  EXPECT_EQ(service.made->rule.border, Border::open);
  ask("POST", "/v1/models", {.body = R"({"volume": "v", "labels": [7, -3, 7]})"});
  EXPECT_EQ(service.made->rule.kind, ObjectRule::Kind::labels);
  EXPECT_EQ(service.made->rule.labels, (std::vector<Label>{-3, 7}));
  EXPECT_EQ(service.made->rule.side, Side::above) << "natural sides are of thresholds";
  // Beyond 2^53 strings keep what a client's numbers would round; both mean the same, and so have the same id.
  ask("POST", "/v1/models",
      {.body =
           R"({"volume": "v", "labels": ["9223372036854775813", "-9007199254740993", 9223372036854775813, "7", 7]})"});
  EXPECT_EQ(service.made->rule.labels, (std::vector<Label>{-9007199254740993, 7, (Label{1} << 63) + 5}));
}

TEST_F(Routes, RefuseWrongModelRequestsByField) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {R"({"volume": "v"})", " "},
      {R"({"threshold": 1})", "/volume "},
      {R"({"volume": 1, "threshold": 1})", "/volume "},
      {R"({"volume": "v", "threshold": "1"})", "/threshold "},
      {R"({"volume": "v", "threshold": null})", "/threshold "},
      {R"({"volume": "v", "threshold": 1, "range": [1, 2]})", " "},
      {R"({"volume": "v", "range": [2, 1]})", "/range "},
      {R"({"volume": "v", "range": [1]})", "/range "},
      {R"({"volume": "v", "range": {"0": 1, "1": 2}})", "/range "},
      {R"({"volume": "v", "labels": []})", "/labels "},
      {R"({"volume": "v", "labels": [1.5]})", "/labels "},
      {R"({"volume": "v", "labels": [18446744073709551616]})", "/labels "},
      {R"({"volume": "v", "labels": ["18446744073709551616"]})", "/labels "},
      {R"({"volume": "v", "labels": ["1.5"]})", "/labels "},
      {R"({"volume": "v", "labels": [""]})", "/labels "},
      {R"({"volume": "v", "threshold": 1, "inside": "up"})", "/inside "},
      {R"({"volume": "v", "threshold": 1, "border": true})", "/border "},
      {R"({"volume": "v", "treshold": 1, "a/b~c": 2})", "/a~1b~0c /treshold  "},
  };
  for (const auto& [body, expected] : cases) {
    const Response response = ask("POST", "/v1/models", {.body = body});
    EXPECT_EQ(response.status, 400) << body;
    EXPECT_EQ(pointers(response), expected) << body;
  }
  std::string deep;
  for (int i = 0; i < 100'000; ++i) deep += '[';
  for (const std::string& body : {std::string("{"), std::string("nonsense"), std::string("[]"), std::string("1e999"),
                                  std::string("\"\xff\""), std::string(R"({"volume": "v", "threshold": NaN})"), deep}) {
    EXPECT_EQ(ask("POST", "/v1/models", {.body = body}).status, 400) << body.substr(0, 50);
  }
  EXPECT_EQ(ask("POST", "/v1/models", {.body = std::string(2 << 20, ' ')}).status, 413);
  EXPECT_EQ(ask("POST", "/v1/models").status, 400);
  EXPECT_FALSE(service.made);
}

TEST_F(Routes, ImportSpheresByTypeOrFormat) {
  service.already_stored = false;
  Response response =
      ask("POST", "/v1/models", {.headers = {{"Content-Type", "text/csv; charset=utf-8"}}, .body = "x,y"});
  EXPECT_EQ(response.status, 201);
  EXPECT_EQ(body_of(response)["kind"], "imported");
  EXPECT_EQ(service.imported, api::SphereFormat::csv);
  EXPECT_EQ(service.files.back().second, "x,y");
  ask("POST", "/v1/models", {.headers = {{"Content-Type", "application/x-npy"}}, .body = "n"});
  EXPECT_EQ(service.imported, api::SphereFormat::npy);
  ask("POST", "/v1/models?format=csv",
      {.headers = {{"Content-Type", "application/x-www-form-urlencoded"}}, .body = "x"});
  EXPECT_EQ(service.imported, api::SphereFormat::csv);
  EXPECT_EQ(pointers(ask("POST", "/v1/models?format=vtp", {.body = "x"})), "format ");
  response = ask("POST", "/v1/models", {.headers = {{"Content-Type", "image/png"}}, .body = "x"});
  EXPECT_EQ(response.status, 415);
  EXPECT_FALSE(response.header("Accept-Post").empty());
}

TEST_F(Routes, PageSpheres) {
  const std::string path = "/v1/models/" + kModel + "/spheres";
  Response response = ask("GET", path + "?offset=340&limit=7");
  EXPECT_EQ(body_of(response)["spheres"].size(), 7U);
  EXPECT_EQ(body_of(response)["spheres"][0], Json({340.0, 0.0, 0.0, 1.5}));
  EXPECT_EQ(response.header("Link"), "<" + path + "?format=json&offset=347&limit=7>; rel=\"next\"");
  response = ask("GET", path + "?offset=347&limit=7");
  EXPECT_EQ(body_of(response)["spheres"].size(), 3U);
  EXPECT_EQ(response.header("Link"), "");
  response = ask("GET", path + "?offset=400");
  EXPECT_EQ(response.status, 200);
  EXPECT_EQ(body_of(response)["spheres"].size(), 0U);
  EXPECT_EQ(pointers(ask("GET", path + "?limit=0")), "limit ");
  EXPECT_EQ(pointers(ask("GET", path + "?format=csv&offset=1")), "offset ");
}

TEST_F(Routes, ListSpheresWithTheirContributions) {
  const std::string path = "/v1/models/" + kModel + "/spheres";
  Response response = ask("GET", path + "?columns=volume_mm3,rank,index&order=contribution&limit=2");
  EXPECT_TRUE(std::holds_alternative<api::ContributionsRequest>(service.derived->what)) << "measured first";
  EXPECT_EQ(service.listing.order, api::SphereOrder::contribution);
  EXPECT_EQ(body_of(response)["columns"], Json({"x", "y", "z", "r", "volume_mm3", "rank", "index"}));
  EXPECT_EQ(body_of(response)["spheres"][1], Json({1.0, 0.0, 0.0, 1.5, 0.25, 0.25, 0.25}));
  EXPECT_EQ(response.header("Link"),
            "<" + path +
                "?format=json&columns=volume_mm3,rank,index&order=contribution&offset=2&limit=2>; "
                "rel=\"next\"");
  service.derived.reset();
  EXPECT_EQ(ask("GET", path + "?columns=index").status, 200);
  EXPECT_FALSE(service.derived) << "a number needs no measures";

  ask("GET", path + "?format=npy&columns=area_mm2,share&order=contribution");
  const auto wanted = std::get<api::ExportRequest>(service.derived->what);
  EXPECT_EQ(wanted.listing.columns, (std::vector{api::SphereFigure::area_mm2, api::SphereFigure::share}));
  EXPECT_EQ(wanted.listing.order, api::SphereOrder::contribution);
  ask("GET", "/v1/models/" + kModel + "/exports/vtp?columns=cumulative_share");
  EXPECT_EQ(std::get<api::ExportRequest>(service.derived->what).listing.columns,
            std::vector{api::SphereFigure::cumulative_share});

  for (const char* bad : {"volume", "volume_mm3,volume_mm3", "x", "volume_mm3;area_mm2"}) {
    EXPECT_EQ(pointers(ask("GET", path + "?columns=" + bad)), "columns ") << bad;
  }
  EXPECT_EQ(pointers(ask("GET", path + "?order=radius")), "order ");
  service.finished = false;
  EXPECT_EQ(ask("GET", path + "?order=contribution", {.headers = {{"Prefer", "wait=3"}}}).status, 202);
  EXPECT_EQ(service.waited, 3);
}

TEST_F(Routes, Simplify) {
  const std::string path = "/v1/models/" + kModel + "/simplifications";
  service.already_stored = false;
  const Response created =
      ask("POST", path, {.headers = {{"Prefer", "wait=5"}}, .body = R"({"method": "best", "mode": "inner", "k": 3})"});
  EXPECT_EQ(created.status, 201);
  EXPECT_EQ(created.header("Location"), "/v1/models/" + kSimplified);
  EXPECT_EQ(service.waited, 5);
  ASSERT_TRUE(service.simplified);
  EXPECT_EQ(service.simplified->model, kModel);
  const auto& best = std::get<BestOptions>(service.simplified->method);
  EXPECT_EQ(best.mode, BestOptions::Mode::inner);
  EXPECT_EQ(best.k, 3U);
  const Json json = body_of(created);
  EXPECT_EQ(json["kind"], "simplified");
  EXPECT_EQ(json["source"], Json({{"model", kModel}}));
  EXPECT_EQ(json["parameters"], Json({{"method", "best"}, {"mode", "inner"}, {"k", 3}}));
  EXPECT_EQ(json["counts"], Json({{"spheres", 3}, {"levels", 3}, {"nodes", 5}}));
  EXPECT_EQ(json["achieved"]["optimality_gap"], 0.25);
  EXPECT_EQ(json["achieved"]["never_spills"], true);
  EXPECT_EQ(json["achieved"]["betti_before"], Json({1, 2, 0}));
  EXPECT_EQ(json["links"]["tree"], "/v1/models/" + kSimplified + "/tree");

  service.already_stored = true;
  EXPECT_EQ(ask("POST", path, {.body = R"({"method": "prune", "buckets": [3, 1, 3], "bucket_count": 5})"}).status, 200);
  const auto& prune = std::get<PruneOptions>(service.simplified->method);
  EXPECT_EQ(prune.buckets, (std::vector<std::uint32_t>{1, 3}));
  EXPECT_EQ(prune.bucket_count, 5U);
  service.finished = false;
  EXPECT_EQ(ask("POST", path, {.body = R"({"method": "median"})"}).status, 202);
  EXPECT_EQ(ask("POST", "/v1/models/mdl_0/simplifications", {.body = R"({"method": "median"})"}).status, 404);
  EXPECT_EQ(ask("POST", path, {.headers = {{"Content-Type", "text/csv"}}, .body = "x,y,z,r"}).status, 415);
}

TEST_F(Routes, RefuseWrongSimplificationsByField) {
  const std::vector<std::pair<std::string, std::string>> cases = {
      {R"({})", "/method "},
      {R"({"method": "bset", "k": 3})", "/method "},
      {R"({"method": 5})", "/method "},
      {R"({"method": "median", "k": "64"})", "/k "},
      {R"({"method": "median", "k": 1.5})", "/k "},
      {R"({"method": "median", "k": -1})", "/k "},
      {R"({"method": "median", "limit": 3, "colour": "red"})", "/colour /limit "},
      {R"({"method": "best", "k": 3, "mode": "outside"})", "/mode "},
      {R"({"method": "best", "k": 3, "representative": "mean"})", "/representative "},
      {R"({"method": "sphericity", "threshold": null})", "/threshold "},
      {R"({"method": "sphericity", "representative": 1})", "/representative "},
      {R"({"method": "prune", "buckets": []})", "/buckets "},
      {R"({"method": "prune", "buckets": [-1]})", "/buckets "},
      {R"({"method": "prune", "buckets": "1,2"})", "/buckets "},
      {R"({"method": "prune", "k": 4, "bucket_count": 7})", "/bucket_count "},
  };
  const std::string path = "/v1/models/" + kModel + "/simplifications";
  for (const auto& [body, expected] : cases) {
    const Response response = ask("POST", path, {.body = body});
    EXPECT_EQ(response.status, 400) << body;
    EXPECT_EQ(pointers(response), expected) << body;
  }
  for (const char* body : {"", "nonsense", "[]", R"({"method": "sphericity", "threshold": 1e999})"}) {
    EXPECT_EQ(ask("POST", path, {.body = body}).status, 400) << body;
  }
  EXPECT_EQ(pointers(ask("POST", path + "?k=3", {.body = R"({"method": "median"})"})), "k ");
  EXPECT_FALSE(service.simplified);
}

TEST_F(Routes, ListLevelsAndMembers) {
  const std::string path = "/v1/models/" + kModel + "/spheres";
  Response response = ask("GET", path + "?level=7&members=true&columns=node,level_to&limit=2");
  EXPECT_EQ(service.level, 7U);
  EXPECT_TRUE(service.members);
  EXPECT_EQ(body_of(response)["members"], Json({{4, 9}, {4, 9}}));
  EXPECT_EQ(response.header("Link"), "<" + path +
                                         "?format=json&level=7&columns=node,level_to&members=true&offset=2&limit=2>; "
                                         "rel=\"next\"");
  ask("GET", path + "?rows=nodes");
  EXPECT_EQ(service.listing.rows, api::SphereRows::nodes);
  EXPECT_EQ(service.listing.columns.size(), 5U) << "what nodes are asked for";
  EXPECT_FALSE(service.members);
  ask("GET", "/v1/models/" + kModel + "/exports/vtp?rows=members&level=7");
  const auto wanted = std::get<api::ExportRequest>(service.derived->what);
  EXPECT_EQ(service.derived->level, 7U);
  EXPECT_EQ(wanted.listing.rows, api::SphereRows::members);
  EXPECT_EQ(wanted.listing.columns, std::vector{api::SphereFigure::cluster});
  for (const char* what : {"render?level=9&view=l", "measures?level=9", "spheres?order=contribution&level=9"}) {
    EXPECT_EQ(ask("GET", "/v1/models/" + kModel + "/" + what).status, 200) << what;
    EXPECT_EQ(service.derived->level, 9U) << what;
  }
  response = ask("GET", "/v1/models/" + kModel + "/tree?levels=1,2");
  EXPECT_EQ(std::get<api::TreeRequest>(service.derived->what).levels, (std::vector<std::uint32_t>{1, 2}));

  EXPECT_EQ(pointers(ask("GET", path + "?level=0")), "level ");
  EXPECT_EQ(pointers(ask("GET", path + "?rows=all")), "rows ");
  EXPECT_EQ(pointers(ask("GET", path + "?rows=nodes&level=3")), "level ");
  EXPECT_EQ(pointers(ask("GET", path + "?rows=members&order=contribution")), "order ");
  for (const char* bad : {"columns=cluster", "rows=members&columns=share", "rows=nodes&columns=rank"}) {
    EXPECT_EQ(pointers(ask("GET", path + "?" + bad)), "columns ") << bad;
  }
  EXPECT_EQ(pointers(ask("GET", path + "?format=csv&members=true")), "members ");
  EXPECT_EQ(pointers(ask("GET", path + "?rows=nodes&members=true")), "members ");
  for (const char* bad : {"", "0", "2,1", "1,1", "1;2", "x"}) {
    EXPECT_EQ(pointers(ask("GET", "/v1/models/" + kModel + "/tree?levels=" + bad)), "levels ") << bad;
  }
}

TEST_F(Routes, GiveFilesForOtherPrograms) {
  const std::string path = "/v1/models/" + kModel + "/exports/";
  for (std::size_t i = 0; i < file_format_count; ++i) {
    const FileFormatInfo& about = info(static_cast<FileFormat>(i));
    const std::string format(about.name);
    const Response response = ask("GET", path + format);
    EXPECT_EQ(response.status, 200) << format;
    EXPECT_EQ(response.header("Content-Type"), about.media_type);
    EXPECT_EQ(response.header("Spherule-Unit"), about.unit);
    EXPECT_EQ(response.header("Spherule-Frame"), about.frame);
    EXPECT_EQ(response.header("Content-Disposition"),
              "attachment; filename=\"" + kModel + "." + std::string(about.extension) + "\"");
    EXPECT_EQ(std::get<api::FileRequest>(service.derived->what).format, static_cast<FileFormat>(i));
    EXPECT_EQ(pointers(ask("GET", path + format + "?columns=rank")), "columns ") << "for tables only";
    EXPECT_EQ(body_of(ask("GET", "/v1/models/" + kModel))["links"]["exports"][format], path + format);
  }
  ask("GET", path + "lammps?level=16&density=3");
  EXPECT_EQ(service.derived->level, 16U);
  ask("GET", path + "urdf?density=2500&link=femur&origin=centre");
  const auto wanted = std::get<api::FileRequest>(service.derived->what).options;
  EXPECT_EQ(wanted.density_kg_m3, 2500);
  EXPECT_EQ(wanted.link, "femur");
  EXPECT_EQ(wanted.origin, BodyOrigin::centre);
  for (const auto& [target, pointer] :
       {std::pair{"urdf?density=0", "density "}, std::pair{"urdf?link=2", "link "},
        std::pair{"urdf?style=mesh&voxel_mm=1", "style voxel_mm "}, std::pair{"lammps?origin=here", "origin "},
        std::pair{"glb?detail=9", "detail "}, std::pair{"vdb?voxel_mm=-1", "voxel_mm "},
        std::pair{"csv?density=1", "density "}}) {
    const Response response = ask("GET", path + target);
    EXPECT_EQ(response.status, 400) << target;
    EXPECT_EQ(pointers(response), pointer);
  }
  const Json problem = body_of(ask("GET", path + "stl"));
  EXPECT_NE(problem["detail"].get<std::string>().find("csv, npy, ply, vtp, urdf"), std::string::npos);
}

TEST_F(Routes, ListAsManyComponentsAsAsked) {
  const std::string path = "/v1/models/" + kModel + "/measures";
  for (const auto& [query, expected] :
       {std::pair{"", 10}, std::pair{"?components=0", 0}, std::pair{"?components=1000", 1000}}) {
    const Json json = body_of(ask("GET", path + query));
    EXPECT_EQ(json["components"]["items"].size(), static_cast<std::size_t>(expected));
    EXPECT_EQ(json["components"]["count"], 1200);
  }
  EXPECT_EQ(pointers(ask("GET", path + "?components=1001")), "components ");
  EXPECT_EQ(pointers(ask("GET", path + "?components=-1")), "components ");
}

TEST_F(Routes, BucketRadiiOnEitherScale) {
  const std::string path = "/v1/models/" + kModel + "/histogram";
  EXPECT_EQ(body_of(ask("GET", path))["scale"], "linear");
  const Json json = body_of(ask("GET", path + "?scale=log&buckets=7"));
  EXPECT_EQ(json["scale"], "log");
  EXPECT_EQ(json["counts"].size(), 7U);
  EXPECT_EQ(json["zero_radius"], 0);
  EXPECT_EQ(pointers(ask("GET", path + "?scale=square")), "scale ");
}

TEST_F(Routes, NegotiateSpheres) {
  const std::string path = "/v1/models/" + kModel + "/spheres";
  const auto type = [&](const char* accept) {
    return std::string(ask("GET", path, {.headers = {{"Accept", accept}}}).header("Content-Type"));
  };
  EXPECT_EQ(type("*/*"), "application/json");
  EXPECT_EQ(type("text/csv"), "text/csv");
  EXPECT_EQ(type("application/json;q=0.5, text/*"), "text/csv");
  EXPECT_EQ(type("application/json;q=0, */*;q=0.1"), "text/csv");
  EXPECT_EQ(type("application/x-vtk-polydata, text/csv;q=0.9"), "application/x-vtk-polydata");
  EXPECT_EQ(ask("GET", path, {.headers = {{"Accept", "image/png"}}}).status, 406);
  const Response npy = ask("GET", path + "?format=npy", {.headers = {{"Accept", "application/x-npy"}}});
  EXPECT_EQ(npy.header("Spherule-Frame"), "LPS");
  EXPECT_EQ(npy.header("Spherule-Unit"), "mm");
  EXPECT_EQ(std::get<api::ExportRequest>(service.derived->what).format, api::SphereFormat::npy);
  EXPECT_EQ(service.waited, 60) << "what is derived is waited for unless the client prefers otherwise";
}

TEST_F(Routes, RenderAsAsked) {
  const std::string path = "/v1/models/" + kModel + "/render";
  EXPECT_EQ(ask("GET", path + "?view=h&width=300&height=200").header("Content-Type"), "image/png");
  const auto render = std::get<api::RenderRequest>(service.derived->what);
  EXPECT_EQ(render.options.views, std::vector<View>{View::head});
  EXPECT_EQ(render.options.width, 300);
  EXPECT_EQ(render.options.height, 200);
  EXPECT_EQ(render.with, "");
  EXPECT_EQ(pointers(ask("GET", path + "?view=x")), "view ");
  EXPECT_EQ(pointers(ask("GET", path + "?width=0")), "width ");
  EXPECT_EQ(pointers(ask("GET", path + "?height=8193")), "height ");
  EXPECT_EQ(pointers(ask("GET", path + "?colour_map=rainbow&colour_by=radius")), "colour_map ");
  EXPECT_EQ(pointers(ask("GET", path + "?position=0,0,0&look_at=0,0")), "look_at ");
  EXPECT_EQ(pointers(ask("GET", path + "?layout=overlaid")), "layout ");
  EXPECT_EQ(pointers(ask("GET", path + "?colour=red")), "colour ");
  EXPECT_EQ(ask("GET", path + "?width=1001&height=1000").status, 413);
  EXPECT_EQ(ask("GET", path + "?width=1000&height=1000&views=a,l").status, 413);
  EXPECT_EQ(ask("GET", path + "?width=1000&height=600&with=" + kImported).status, 413);
  EXPECT_EQ(ask("GET", path + "?width=1000&height=600&layout=overlaid&opacity=0.5&with=" + kImported).status, 200);
  EXPECT_EQ(std::get<api::RenderRequest>(service.derived->what).with, kImported);
  EXPECT_EQ(ask("GET", path + "?turntable=20&width=100&height=100").header("Content-Type"), "image/gif");
  EXPECT_EQ(ask("GET", path + "?turntable=20&width=1000&height=100").status, 413);
  EXPECT_EQ(ask("GET", path + "?turntable=20&width=100&height=100", {.headers = {{"Accept", "image/png"}}}).status,
            406);
  EXPECT_EQ(ask("GET", path, {.headers = {{"Accept", "text/html"}}}).status, 406);
}

TEST_F(Routes, DrawSlicesAsAsked) {
  const std::string path = "/v1/volumes/" + kVolume + "/slices/j/7";
  const Response plain = ask("GET", path);
  EXPECT_EQ(plain.header("Content-Type"), "image/png");
  EXPECT_EQ(plain.header("Vary"), "Accept");
  auto slice = std::get<api::SliceRequest>(service.derived->what);
  EXPECT_EQ(service.derived->source, kVolume);
  EXPECT_EQ(slice.axis, 1);
  EXPECT_EQ(slice.index, 7);
  EXPECT_FALSE(slice.object);
  EXPECT_EQ(ask("GET", path + "?threshold=5&show=circles,points&width=300&window=9&level=4").status, 200);
  slice = std::get<api::SliceRequest>(service.derived->what);
  ASSERT_TRUE(slice.object);
  EXPECT_EQ(slice.object->lo, 5);
  EXPECT_EQ(slice.object->side, Side::below) << "as is natural to this volume";
  EXPECT_EQ(slice.options.show, (std::vector<Overlay>{Overlay::points, Overlay::circles}));
  EXPECT_EQ(slice.options.width, 300);
  EXPECT_EQ(slice.options.window, (Window{9, 4}));
  EXPECT_EQ(ask("GET", path + "?labels=7,-3,7&inside=below&border=open&format=svg").header("Content-Type"),
            "image/svg+xml");
  slice = std::get<api::SliceRequest>(service.derived->what);
  EXPECT_EQ(slice.object->labels, (std::vector<Label>{-3, 7}));
  EXPECT_EQ(slice.object->border, Border::open);
}

TEST_F(Routes, TellSlicesAsNumbers) {
  const std::string path = "/v1/volumes/" + kVolume + "/slices/i/0?range=1,2";
  const std::vector<std::pair<std::string, std::string>> json{{"Accept", "application/json"}};
  const Response response = ask("GET", path + "&width=50", {.headers = json});
  EXPECT_EQ(response.header("Content-Type"), "application/json");
  EXPECT_EQ(std::get<api::SliceRequest>(service.derived->what).options, SliceOptions{}) << "are the same at any size";
  std::string text(std::get<api::ContentPart>(response.body).length, 0);
  std::get<api::ContentPart>(response.body).content.read_at(0, text);
  const Json slice = Json::parse(text);
  EXPECT_EQ(slice["axes"][0]["axis"], "j");
  EXPECT_EQ(slice["axes"][1]["axis"], "k");
  EXPECT_EQ(slice["boundary_points"].size(), 4U);
  EXPECT_EQ(slice["contour"].size(), 4U);
  EXPECT_EQ(slice["circles"].size(), slice["inside_triangles"]);
  EXPECT_EQ(slice["object"]["range"], Json({1, 2}));
  const std::string self = slice["links"]["self"];
  EXPECT_EQ(self, path.substr(0, path.find('?')) + "?format=json&range=1,2&inside=above");
  EXPECT_EQ(ask("GET", self).status, 200);
}

TEST_F(Routes, RefuseSlicesThatMakeNoSense) {
  const std::string slices = "/v1/volumes/" + kVolume + "/slices/";
  for (const char* nowhere : {"k/10", "k/-1", "k/x", "k/1.5", "x/0", "ij/0", "K/0"})
    EXPECT_EQ(ask("GET", slices + nowhere).status, 404) << nowhere;
  EXPECT_EQ(ask("GET", "/v1/volumes/vol_0/slices/k/1").status, 404);
  const std::vector<std::pair<std::string, std::string>> wrong{{"width=0", "width "},
                                                               {"height=8193", "height "},
                                                               {"window=0&level=1", "window "},
                                                               {"window=1", "level "},
                                                               {"level=1", "window "},
                                                               {"threshold=x", "threshold "},
                                                               {"range=5,1", "range "},
                                                               {"labels=", "labels "},
                                                               {"labels=1.5", "labels "},
                                                               {"labels=18446744073709551616", "labels "},
                                                               {"threshold=1&labels=1", "threshold "},
                                                               {"inside=above", "inside "},
                                                               {"show=points", "show "},
                                                               {"threshold=1&show=dots", "show "},
                                                               {"threshold=1&image=false&smooth=false", "smooth "},
                                                               {"image=false", "image "},
                                                               {"region=3,3,3,4", "region "},
                                                               {"region=1,2,3", "region "},
                                                               {"zoom=2", "zoom "}};
  for (const auto& [query, names] : wrong) EXPECT_EQ(pointers(ask("GET", slices + "k/1?" + query)), names) << query;
  EXPECT_EQ(ask("GET", slices + "k/1?width=1001&height=1000").status, 413);
  EXPECT_EQ(ask("GET", slices + "k/1", {.headers = {{"Accept", "image/jpeg"}}}).status, 406);
  EXPECT_EQ(ask("GET", slices + "k/1?format=png", {.headers = {{"Accept", "image/svg+xml"}}}).status, 406);
}

TEST_F(Routes, PlotHistograms) {
  const std::string values = "/v1/volumes/" + kVolume + "/histogram", radii = "/v1/models/" + kModel + "/histogram";
  for (const std::string& path : {values, radii}) {
    EXPECT_EQ(ask("GET", path).header("Content-Type"), "application/json");
    const Response png = ask("GET", path + "?format=png&width=200&height=150");
    EXPECT_EQ(png.header("Content-Type"), "image/png");
    EXPECT_EQ(std::get<std::string>(png.body).substr(16, 8), std::string("\0\0\0\xc8\0\0\0\x96", 8)) << "200 x 150";
    const Response svg = ask("GET", path, {.headers = {{"Accept", "image/svg+xml"}}});
    EXPECT_EQ(svg.header("Content-Type"), "image/svg+xml");
    EXPECT_EQ(std::get<std::string>(svg.body).substr(0, 4), "<svg");
    EXPECT_EQ(pointers(ask("GET", path + "?width=300")), "width ");
    EXPECT_EQ(pointers(ask("GET", path + "?format=png&height=99")), "height ");
    EXPECT_EQ(ask("GET", path + "?format=png&width=1001&height=1000").status, 413);
    EXPECT_EQ(ask("GET", path, {.headers = {{"Accept", "text/html"}}}).status, 406);
  }
  const std::string sizes = std::get<std::string>(ask("GET", values + "?format=svg&plot=sizes&mark=100.5").body);
  EXPECT_NE(sizes.find("threshold"), std::string::npos);
  EXPECT_NE(sizes.find(">100.5<"), std::string::npos);
  EXPECT_EQ(pointers(ask("GET", values + "?plot=sizes")), "plot ");
  EXPECT_EQ(pointers(ask("GET", values + "?mark=1")), "mark ");
  EXPECT_EQ(pointers(ask("GET", values + "?format=png&plot=pie")), "plot ");
}

TEST_F(Routes, GiveTheJobOfAnAnswerThatIsNotDone) {
  service.finished = false;
  EXPECT_EQ(ask("GET", "/v1/volumes/" + kVolume + "/slices/k/0").status, 202);
  for (const char* what :
       {"measures", "checks", "render", "exports/vtp", "tree", "spheres?format=ply", "spheres?order=contribution"}) {
    const Response response =
        ask("GET", "/v1/models/" + kModel + "/" + what, {.headers = {{"Prefer", "respond-async"}}});
    EXPECT_EQ(response.status, 202) << what;
    EXPECT_EQ(response.header("Location"), "/v1/jobs/" + kJob) << what;
    EXPECT_EQ(service.waited, 0) << what;
  }
}

TEST_F(Routes, ServeRangesOfContent) {
  const std::string path = "/v1/volumes/" + kVolume + "/content";
  const auto part = [&](const std::string& range, int status, std::uint64_t offset, std::uint64_t length) {
    const Response response = ask("GET", path, {.headers = {{"Range", range}}});
    EXPECT_EQ(response.status, status) << range;
    const auto& content = std::get<api::ContentPart>(response.body);
    EXPECT_EQ(content.offset, offset) << range;
    EXPECT_EQ(content.length, length) << range;
    return std::string(response.header("Content-Range"));
  };
  EXPECT_EQ(part("bytes=0-3", 206, 0, 4), "bytes 0-3/10");
  EXPECT_EQ(part("bytes=4-", 206, 4, 6), "bytes 4-9/10");
  EXPECT_EQ(part("bytes=-3", 206, 7, 3), "bytes 7-9/10");
  EXPECT_EQ(part("bytes=-99", 206, 0, 10), "bytes 0-9/10");
  EXPECT_EQ(part("bytes=9-18446744073709551615", 206, 9, 1), "bytes 9-9/10");
  EXPECT_EQ(part("bytes=0-3,,", 206, 0, 4), "bytes 0-3/10");
  EXPECT_EQ(part("bytes=12-, 9-", 206, 9, 1), "bytes 9-9/10");
  for (const char* ignored :
       {"items=0-3", "bytes=0-7,3-", "bytes=0-1,x", "bytes=5-2", "bytes=x-", "bytes=-", "bytes", "bytes="}) {
    EXPECT_EQ(part(ignored, 200, 0, 10), "") << ignored;
  }
  for (const char* outside : {"bytes=10-", "bytes=10-11", "bytes=-0", "bytes=18446744073709551615-"}) {
    const Response response = ask("GET", path, {.headers = {{"Range", outside}}});
    EXPECT_EQ(response.status, 416) << outside;
    EXPECT_EQ(response.header("Content-Range"), "bytes */10") << outside;
  }
  const std::string etag = "\"" + std::string(64, 'e') + "\"";
  EXPECT_EQ(ask("GET", path, {.headers = {{"Range", "bytes=0-3"}, {"If-Range", etag}}}).status, 206);
  EXPECT_EQ(ask("GET", path, {.headers = {{"Range", "bytes=0-3"}, {"If-Range", "\"old\""}}}).status, 200);
}

TEST_F(Routes, ServeSeveralRangesAsMultipart) {
  const std::string path = "/v1/volumes/" + kVolume + "/content";
  const std::string boundary(64, 'e');
  const Response response = ask("GET", path, {.headers = {{"Range", "bytes=0-1, 4-6,20-,-1"}}});
  EXPECT_EQ(response.status, 206);
  EXPECT_EQ(response.header("Content-Type"), "multipart/byteranges; boundary=" + boundary);
  EXPECT_EQ(response.header("Content-Range"), "");
  std::string expected;
  for (const auto& [range, bytes] : {std::pair("0-1", "01"), {"4-6", "456"}, {"9-9", "9"}}) {
    expected += "\r\n--" + boundary + "\r\nContent-Type: application/octet-stream\r\nContent-Range: bytes " + range +
                "/10\r\n\r\n" + bytes;
  }
  expected += "\r\n--" + boundary + "--\r\n";
  const auto& content = std::get<api::ContentPart>(response.body);
  EXPECT_EQ(content.offset, 0U);
  ASSERT_EQ(content.length, expected.size());
  // Whatever the pieces in which it is fetched.
  for (const std::size_t step : {std::size_t{1}, std::size_t{7}, std::size_t{64}, expected.size() + 9}) {
    std::string all, piece(step, '\0');
    while (const std::size_t n = content.content.read_at(all.size(), piece)) all.append(piece, 0, n);
    EXPECT_EQ(all, expected) << step;
  }
  // One more than is answered so.
  std::string many = "bytes=0-0";
  for (std::size_t i = 1; i < api::kMostRanges; ++i) many += ",100-";
  EXPECT_EQ(ask("GET", path, {.headers = {{"Range", many}}}).status, 206);
  EXPECT_EQ(ask("GET", path, {.headers = {{"Range", many + ",1-1"}}}).status, 200);
}

TEST_F(Routes, RefuseZeroBytesInNames) {
  const std::vector<std::pair<std::string, std::string>> requests = {
      {"/v1/models/" + kModel + "/simplifications", R"({"method": "median", "\u0000": "x"})"},
      {"/v1/models", R"({"volume": "x", "a\u0000b": 1})"}};
  for (const auto& [path, body] : requests) {
    const Response response = ask("POST", path, {.body = body});
    EXPECT_EQ(response.status, 400) << path;
    EXPECT_NE(
        std::get<std::string>(response.body).find("has a field with a zero byte in its name; send no such field."),
        std::string::npos)
        << path;
  }
}

TEST_F(Routes, Delete) {
  EXPECT_EQ(ask("DELETE", "/v1/volumes/" + kVolume).status, 204);
  EXPECT_EQ(ask("DELETE", "/v1/models/" + kModel).status, 204);
  EXPECT_EQ(service.deleted, (std::vector<std::string>{kVolume, kModel}));
  EXPECT_EQ(ask("DELETE", "/v1/models/" + kVolume).status, 404);
}

TEST_F(Routes, GiveTheJobOfAHistogramThatIsNotCounted) {
  service.finished = false;
  for (const char* query : {"", "?format=png", "?format=svg&plot=sizes"}) {
    const Response response = ask("GET", "/v1/volumes/" + kVolume + "/histogram" + query);
    EXPECT_EQ(response.status, 202) << query;
    EXPECT_EQ(response.header("Location"), "/v1/jobs/" + kJob);
    EXPECT_EQ(service.waited, 60) << "like everything that is derived";
  }
}

TEST_F(Routes, CancelJobsOfOnesOwn) {
  service.may_cancel = false;
  const Response refused = ask("POST", "/v1/jobs/" + kJob + "/cancel");
  EXPECT_EQ(refused.status, 403);
  EXPECT_EQ(body_of(refused)["type"], "urn:spherule:problem:forbidden");
}

TEST_F(Routes, CancelJobs) {
  EXPECT_EQ(ask("POST", "/v1/jobs/" + kJob + "/cancel").status, 202);
  service.failure.emplace(ErrorCode::conflict, "The job is over.");
  EXPECT_EQ(ask("POST", "/v1/jobs/" + kJob + "/cancel").status, 409);
}

TEST_F(Routes, StreamEvents) {
  using Type = api::JobEvent::Type;
  service.events.events = {
      {.number = 3, .type = Type::state, .state = api::JobState::running},
      {.number = 5, .type = Type::warning, .state = api::JobState::running, .warning = "Odd\nscan."},
      {.number = 9, .type = Type::end, .state = api::JobState::succeeded, .stage = "store", .progress = 1}};
  service.events.over = true;
  const auto stream = [&](Extra extra) {
    const Response response = ask("GET", "/v1/jobs/" + kJob + "/events", std::move(extra));
    EXPECT_EQ(response.header("Content-Type"), "text/event-stream");
    std::string out;
    while (std::get<api::EventSource>(response.body)(out)) {
    }
    return out;
  };
  EXPECT_EQ(stream({}),
            "retry: 2000\n\n"
            "id: 3\nevent: state\ndata: {\"state\":\"running\",\"progress\":0.0}\n\n"
            "id: 5\nevent: warning\ndata: {\"state\":\"running\",\"warning\":\"Odd\\nscan.\"}\n\n"
            "id: 9\nevent: end\ndata: {\"state\":\"succeeded\",\"stage\":\"store\",\"progress\":1.0}\n\n");
  EXPECT_EQ(stream({.headers = {{"Last-Event-ID", "5"}}}),
            "retry: 2000\n\nid: 9\nevent: end\ndata: "
            "{\"state\":\"succeeded\",\"stage\":\"store\",\"progress\":1.0}\n\n");
  EXPECT_EQ(ask("GET", "/v1/jobs/" + kJob + "/events", {.headers = {{"Last-Event-ID", "9"}}}).status, 204);
  EXPECT_EQ(ask("GET", "/v1/jobs/" + kJob + "/events", {.headers = {{"Last-Event-ID", "last"}}}).status, 400);
  EXPECT_EQ(ask("GET", "/v1/jobs/job_0/events").status, 404);
}

TEST_F(Routes, EndAStreamWhenTheServerStops) {
  service.events.events = {{.number = 3, .type = api::JobEvent::Type::state, .state = api::JobState::running}};
  const Response response = ask("GET", "/v1/jobs/" + kJob + "/events");
  const auto& next = std::get<api::EventSource>(response.body);
  std::string out;
  EXPECT_TRUE(next(out));
  service.events.stopping = true;
  EXPECT_FALSE(next(out)) << "or it asks again and again";
  EXPECT_EQ(out.find("event: end"), out.npos) << "the job has not ended";
}

TEST_F(Routes, KeepAStreamAliveWithComments) {
  const Response response = ask("GET", "/v1/jobs/" + kJob + "/events");
  const auto& next = std::get<api::EventSource>(response.body);
  std::string out;
  EXPECT_TRUE(next(out));
  out.clear();
  EXPECT_TRUE(next(out));
  EXPECT_EQ(out, ":\n\n");
}

TEST_F(Routes, ReportReadiness) {
  EXPECT_EQ(ask("GET", "/readyz").status, 200);
  service.failure.emplace(ErrorCode::busy, "x");
  EXPECT_EQ(ask("GET", "/readyz").status, 503);
  EXPECT_EQ(ask("GET", "/livez").status, 200);
}

TEST_F(Routes, ShowEveryOperationOnTheDocsPage) {
  const Response response = ask("GET", "/docs");
  const std::string page = std::get<std::string>(response.body);
  std::size_t entries = 0;
  for (std::size_t at = 0; (at = page.find("<details>", at)) != std::string::npos; ++at) ++entries;
  EXPECT_EQ(entries, api::operations().size());
  EXPECT_NE(page.find("Upload a volume"), std::string::npos);
  EXPECT_EQ(page.find("<pre></pre>"), std::string::npos) << "every entry has its text";
  EXPECT_EQ(page.find("http://"), page.find("http://127.0.0.1")) << "nothing is fetched from elsewhere";
  EXPECT_EQ(page.find("https://"), std::string::npos);
}

}  // namespace
}  // namespace spherule::test
