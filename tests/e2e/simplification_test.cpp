// SPDX-License-Identifier: GPL-3.0-or-later
//
// Simplified models over HTTP.
#include <gtest/gtest.h>

#include <cmath>
#include <memory>
#include <numbers>
#include <set>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

const std::string kRaw = "?format=raw&dims=36,20,20&dtype=uint8";

// Two balls that fall linearly from 255 to 0 at 9 voxels; at 127.5 they are pieces of radius 4.5, at 60 one piece.
std::string two_balls() {
  std::string bytes;
  for (int k = 0; k < 20; ++k) {
    for (int j = 0; j < 20; ++j) {
      for (int i = 0; i < 36; ++i) {
        const double r = std::min(std::hypot(i - 11.5, j - 9.5, k - 9.5), std::hypot(i - 23.5, j - 9.5, k - 9.5));
        bytes += static_cast<char>(std::max(0.0, 255 * (1 - r / 9)));
      }
    }
  }
  return bytes;
}

class Simplifications : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new TemporaryFolder;
    server = new ServerProcess(folder->path() / "data");
    raw = client().model({{"volume", client().upload(kRaw, two_balls())}, {"threshold", 60}})["id"];
  }
  static void TearDownTestSuite() {
    delete server;
    delete folder;
  }
  static Client client() { return Client(server->port()); }
  static Answer simplify(const std::string& model, const std::string& wish) {
    return client().post("/v1/models/" + model + "/simplifications",
                         {.headers = {{"Prefer", "wait=60"}}, .body = wish, .type = "application/json"});
  }
  static std::string path_of(const Answer& model) { return "/v1/models/" + model.json()["id"].get<std::string>(); }

  static TemporaryFolder* folder;
  static ServerProcess* server;
  static std::string raw;
};
TemporaryFolder* Simplifications::folder = nullptr;
ServerProcess* Simplifications::server = nullptr;
std::string Simplifications::raw;

TEST_F(Simplifications, OfEveryMethodAreModelsThatSayHowNearTheyAre) {
  const std::size_t whole = client().get("/v1/models/" + raw).json()["counts"]["spheres"];
  // Beyond the plane between the two, a cap of each ball of radius 9·(1 − 60/255) is cut off.
  const double r = 9 * (1 - 60.0 / 255), h = r - 6;
  const double volume_of_one = std::numbers::pi * (4.0 / 3 * r * r * r - h * h * (r - h / 3));
  std::set<std::string> ids;
  for (const char* wish :
       {R"({"method": "sphericity", "threshold": 0.6, "limit": 20})", R"({"method": "median", "k": 20})",
        R"({"method": "average", "k": 20, "representative": "volume"})", R"({"method": "prune", "k": 20})",
        R"({"method": "prune", "volume_share": 0.9})", R"({"method": "best", "k": 20})",
        R"({"method": "best", "k": 20, "mode": "inner"})", R"({"method": "best", "k": 20, "mode": "outer"})",
        R"({"method": "best", "iou": 0.9})"}) {
    const Answer created = simplify(raw, wish);
    ASSERT_EQ(created.status, 201) << wish << created.body;
    const Json model = created.json();
    EXPECT_TRUE(ids.insert(model["id"]).second) << wish;
    EXPECT_EQ(model["kind"], "simplified");
    EXPECT_EQ(model["source"], Json({{"model", raw}}));
    const Json achieved = model["achieved"], asked = Json::parse(wish);
    for (const auto& [name, value] : asked.items()) EXPECT_EQ(model["parameters"][name], value) << wish;
    EXPECT_EQ(achieved["k"], model["counts"]["spheres"]);
    EXPECT_LE(achieved["k"], asked.value("k", asked.value("limit", whole)));
    EXPECT_GT(achieved["iou"], 0) << wish;
    EXPECT_LE(achieved["iou"], 1) << wish;
    EXPECT_NEAR(achieved["object_mm3"].get<double>(), 2 * volume_of_one, 0.03 * volume_of_one);
    EXPECT_EQ(achieved["betti_before"], Json({1, 0, 0}));
    EXPECT_EQ(achieved.contains("optimality_gap"), asked.value("mode", "") == "inner");
    if (asked.value("mode", "") == "inner") {
      EXPECT_EQ(achieved["never_spills"], true);
    }
    if (asked.value("mode", "") == "outer") {
      EXPECT_EQ(achieved["covers_all"], true);
    }
    if (asked["method"] == "sphericity") {
      EXPECT_EQ(achieved["covers_all"], true) << "spheres around all members";
    }
    if (asked.contains("iou")) {
      EXPECT_GE(achieved["iou"], asked["iou"]);
    }
    EXPECT_EQ(client().get(path_of(created)).json(), model);
    EXPECT_EQ(simplify(raw, wish).status, 200) << "made already";

    // A model like any other.
    EXPECT_EQ(client().get(path_of(created) + "/measures").json()["spheres"]["count"], achieved["k"]);
    EXPECT_NEAR(client().get(path_of(created) + "/measures").json()["spheres"]["volume_mm3"].get<double>(),
                achieved["volume_mm3"].get<double>(), 1e-9 * achieved["volume_mm3"].get<double>());
    EXPECT_EQ(client().get(path_of(created) + "/render?colour_by=cluster&width=60&height=60").status, 200);
    EXPECT_EQ(client().get(path_of(created) + "/histogram").status, 200);
    EXPECT_EQ(client().get(path_of(created) + "/checks").status, 422) << "only scans can be checked against";
  }
  EXPECT_EQ(
      simplify(raw, R"({"limit": 20, "method": "sphericity", "threshold": 0.6, "representative": "enclosing"})").status,
      200)
      << "defaults are part of the identity";
}

TEST_F(Simplifications, ShowEveryLevel) {
  const Answer created = simplify(raw, R"({"method": "median", "k": 12})");
  const std::string path = path_of(created);
  const Json nodes = client().get(path + "/spheres?rows=nodes").json();
  EXPECT_EQ(nodes["columns"], Json({"x", "y", "z", "r", "node", "parent", "level_from", "level_to", "members"}));
  EXPECT_EQ(nodes["total"], 23) << "a binary tree";
  EXPECT_EQ(nodes["spheres"][0][5], -1);
  for (int k = 1; k <= 12; ++k) {
    const std::string level = "level=" + std::to_string(k);
    const Json page = client().get(path + "/spheres?columns=node,members&members=true&" + level).json();
    ASSERT_EQ(page["total"], k);
    // The same spheres as the listing of all levels has.
    Json shown = Json::array();
    for (const Json& node : nodes["spheres"]) {
      if (node[6] <= k && k <= node[7]) shown.push_back({node[0], node[1], node[2], node[3], node[4], node[8]});
    }
    EXPECT_EQ(page["spheres"], shown);
    std::set<std::size_t> members;
    for (std::size_t i = 0; i < page["members"].size(); ++i) {
      EXPECT_EQ(page["members"][i].size(), page["spheres"][i][5]);
      for (const Json& m : page["members"][i]) EXPECT_TRUE(members.insert(m.get<std::size_t>()).second);
    }
    EXPECT_EQ(members.size(), client().get("/v1/models/" + raw).json()["counts"]["spheres"]) << "each in one cluster";
    EXPECT_NE(client().get(path + "/exports/npy?" + level).body.find("(" + std::to_string(k) + ", 4)"),
              std::string::npos);
  }
  EXPECT_EQ(client().get(path + "/measures?level=3").json()["spheres"]["count"], 3);
  EXPECT_EQ(client().get(path + "/spheres?level=3&order=contribution&columns=rank").json()["total"], 3);
  EXPECT_EQ(client().get(path + "/exports/csv?level=12").body, client().get(path + "/exports/csv").body);
  EXPECT_NE(client().get(path + "/render?level=1&width=60&height=60").body,
            client().get(path + "/render?width=60&height=60").body);

  const Json clusters = client().get(path + "/spheres?rows=members&level=3&limit=100000").json();
  const Json lists = client().get(path + "/spheres?level=3&members=true").json()["members"];
  for (std::size_t c = 0; c < 3; ++c) {
    for (const Json& m : lists[c]) EXPECT_EQ(clusters["spheres"][m.get<std::size_t>()][4], c);
  }
  EXPECT_NE(client().get(path + "/exports/vtp?rows=members").body.find("Name=\"cluster\""), std::string::npos);

  const Json tree = client().get(path + "/tree?levels=1,3,12").json();
  ASSERT_EQ(tree["levels"].size(), 3U);
  EXPECT_EQ(tree["source"], raw);
  EXPECT_EQ(tree["levels"][0]["parents"], Json({nullptr}));
  EXPECT_EQ(tree["levels"][1]["parents"], Json({0, 0, 0}));
  EXPECT_EQ(tree["levels"][2]["spheres"].size(), 12U);
  EXPECT_EQ(tree["members"].size(), 12U);
  EXPECT_EQ(client().get(path + "/tree").json()["levels"].size(), 3U) << "1, 8 and the last";

  EXPECT_EQ(client().get(path + "/spheres?level=13").status, 400);
  EXPECT_EQ(client().get(path + "/exports/csv?level=13").status, 400);
  EXPECT_EQ(client().get(path + "/tree?levels=1,13").status, 400);
  for (const char* needs : {"/spheres?level=1", "/spheres?rows=nodes", "/spheres?members=true", "/tree",
                            "/exports/csv?columns=parent", "/render?level=2"}) {
    const Answer refused = client().get("/v1/models/" + raw + needs);
    EXPECT_EQ(refused.status, 422) << needs;
  }
}

TEST_F(Simplifications, OfImportedAndOfSimplifiedModels) {
  const Answer imported =
      client().post("/v1/models", {.body = "x,y,z,r\n0,0,0,5\n1,0,0,5\n30,0,0,5\n30,1,0,5\n", .type = "text/csv"});
  const std::string id = imported.json()["id"];
  const Answer two = simplify(id, R"({"method": "average", "k": 2})");
  ASSERT_EQ(two.status, 201) << two.body;
  EXPECT_EQ(client().get(path_of(two) + "/spheres?members=true").json()["members"], Json({{0, 1}, {2, 3}}));
  EXPECT_GT(two.json()["achieved"]["iou"], 0.85);
  const Answer one = simplify(two.json()["id"], R"({"method": "sphericity", "limit": 1})");
  ASSERT_EQ(one.status, 201) << one.body;
  EXPECT_EQ(one.json()["achieved"]["object_mm3"], two.json()["achieved"]["object_mm3"]) << "the first of the chain";
  EXPECT_EQ(client().get(path_of(one) + "/spheres?rows=members").json()["total"], 2) << "of its own source";

  EXPECT_EQ(client().ask("DELETE", path_of(two)).status, 204);
  EXPECT_EQ(client().get(path_of(one)).status, 404) << "goes with what it was made from";
  EXPECT_EQ(client().get("/v1/models/" + id).status, 200);
}

TEST_F(Simplifications, AreRefusedInWords) {
  for (const auto& [wish, pointer] : std::vector<std::pair<std::string, std::string>>{
           {R"({"method": "best", "k": 0})", "/k"},
           {R"({"method": "median", "k": 1000000})", "/k"},
           {R"({"method": "sphericity", "threshold": 0})", "/threshold"},
           {R"({"method": "sphericity", "threshold": 1.01})", "/threshold"},
           {R"({"method": "best", "iou": 1.5})", "/iou"},
           {R"({"method": "prune", "volume_share": 0})", "/volume_share"},
           {R"({"method": "prune", "buckets": [40]})", "/buckets"},
           {R"({"method": "prune", "k": 2, "least_radius_mm": 1})", ""},
           {R"({"method": "best", "k": 2, "seed": 1})", "/seed"}}) {
    const Answer refused = simplify(raw, wish);
    EXPECT_EQ(refused.status, 400) << wish;
    EXPECT_EQ(refused.json()["errors"][0]["pointer"], pointer) << refused.body;
  }
  EXPECT_EQ(simplify(raw, R"({"method": "prune", "least_radius_mm": 1000})").status, 422) << "nothing would be left";
  const std::string few = simplify(raw, R"({"method": "median", "k": 3})").json()["id"];
  const Answer unreachable = simplify(few, R"({"method": "best", "mode": "inner", "iou": 1})");
  EXPECT_EQ(unreachable.status, 422);
  EXPECT_EQ(simplify("mdl_" + std::string(32, '0'), R"({"method": "median"})").status, 404);
  EXPECT_EQ(client().get("/v1/models/" + raw).status, 200) << "nothing is lost";
}

TEST_F(Simplifications, RunAsJobsThatCanBeCancelled) {
  const std::string big = client().upload("?format=raw&dims=96,96,96&dtype=uint8", ball(96, 47));
  const std::string id = client().model({{"volume", big}, {"threshold", 20}})["id"];
  const Answer started =
      client().post("/v1/models/" + id + "/simplifications", {.body = R"({"method": "best", "k": 1024})"});
  ASSERT_EQ(started.status, 202);
  EXPECT_EQ(started.json()["kind"], "simplification");
  EXPECT_EQ(client().post(started.header("Location") + "/cancel").status, 202);
  client().get(started.header("Location") + "/events");
  EXPECT_EQ(client().get(started.header("Location")).json()["state"], "cancelled");

  const Answer again = client().post("/v1/models/" + id + "/simplifications", {.body = R"({"method": "median"})"});
  ASSERT_EQ(again.status, 202);
  const Answer events = client().get(again.header("Location") + "/events");
  EXPECT_NE(events.body.find("\"stage\":\"splitting\""), std::string::npos) << events.body;
  const Json over = client().get(again.header("Location")).json();
  EXPECT_EQ(over["state"], "succeeded");
  EXPECT_EQ(client().get(over["links"]["result"]).json()["counts"]["spheres"], 256);
}

TEST(SimplificationsAfterARestart, AreFoundAgain) {
  const TemporaryFolder folder;
  auto server = std::make_unique<ServerProcess>(folder.path() / "data", std::vector<std::string>{"--threads", "1"});
  const Json raw =
      Client(server->port()).model({{"volume", Client(server->port()).upload(kRaw, two_balls())}, {"threshold", 60}});
  const std::string target = "/v1/models/" + raw["id"].get<std::string>() + "/simplifications";
  const Ask ask{.headers = {{"Prefer", "wait=60"}}, .body = R"({"method": "sphericity", "threshold": 0.9})"};
  const Answer made = Client(server->port()).post(target, ask);
  ASSERT_EQ(made.status, 201) << made.body;
  const std::string path = "/v1/models/" + made.json()["id"].get<std::string>();
  const std::string listed = Client(server->port()).get(path + "/spheres?members=true&level=2").body;
  EXPECT_EQ(server->terminate(), 0);

  server = std::make_unique<ServerProcess>(folder.path() / "data", std::vector<std::string>{"--threads", "3"});
  const Client client(server->port());
  EXPECT_EQ(client.get(path).body, made.body);
  EXPECT_EQ(client.get(path + "/spheres?members=true&level=2").body, listed);
  const std::string csv = client.get(path + "/exports/csv?rows=nodes").body;
  EXPECT_EQ(client.ask("DELETE", path).status, 204);
  const Answer again = client.post(target, ask);
  EXPECT_EQ(again.status, 201);
  EXPECT_EQ(again.json()["id"], made.json()["id"]);
  EXPECT_EQ(client.get(path + "/exports/csv?rows=nodes").body, csv) << "the same on any number of threads";
  EXPECT_EQ(client.ask("DELETE", "/v1/models/" + raw["id"].get<std::string>()).status, 204);
  EXPECT_EQ(client.get(path).status, 404);
}

}  // namespace
}  // namespace spherule::test
