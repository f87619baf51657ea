// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registrations over HTTP: a lopsided object, and the same one turned a quarter about z and half as large again.
#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <cstring>
#include <sstream>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

constexpr int kSize = 36;

// 255 deep inside, falling to 0 over four voxels at the surface: three balls, none like the others.
double value(double x, double y, double z) {
  const auto ball = [&](double cx, double cy, double cz, double r) { return r - std::hypot(x - cx, y - cy, z - cz); };
  const double depth = std::max({ball(13, 17, 16, 9), ball(24, 22, 15, 6), ball(19, 9, 24, 4.5)});
  return std::clamp(127.5 + 64 * depth, 0.0, 255.0);
}

std::string bytes(bool turned) {
  std::string all;
  for (int k = 0; k < kSize; ++k) {
    for (int j = 0; j < kSize; ++j) {
      // A quarter turn about z: what was at (x, y) is at (size - 1 - y, x).
      for (int i = 0; i < kSize; ++i)
        all += static_cast<char>(static_cast<unsigned char>(turned ? value(j, kSize - 1 - i, k) : value(i, j, k)));
    }
  }
  return all;
}

std::string raw_query(const std::string& spacing, const std::string& origin) {
  return "?format=raw&dims=36,36,36&dtype=uint8&spacing=" + spacing + "&origin=" + origin;
}

class RegistrationsOverHttp : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new TemporaryFolder;
    server = new ServerProcess(folder->path() / "data");
    fixed = model(client().upload(raw_query("1,1,1", "0,0,0"), bytes(false)));
    moving = model(client().upload(raw_query("1.5,1.5,1.5", "100,-50,20"), bytes(true)));
    pair = R"({"fixed": ")" + fixed + R"(", "moving": ")" + moving + R"("})";
  }
  static void TearDownTestSuite() {
    delete server;
    delete folder;
  }
  static Client client() { return Client(server->port()); }
  static std::string model(const std::string& volume) {
    return client().model({{"volume", volume}, {"threshold", 127.5}})["id"];
  }
  static Answer registered(const std::string& wish) {
    return client().post("/v1/registrations", {.headers = {{"Prefer", "wait=60"}}, .body = wish});
  }

  static TemporaryFolder* folder;
  static ServerProcess* server;
  static std::string fixed, moving, pair;
};
TemporaryFolder* RegistrationsOverHttp::folder = nullptr;
ServerProcess* RegistrationsOverHttp::server = nullptr;
std::string RegistrationsOverHttp::fixed, RegistrationsOverHttp::moving, RegistrationsOverHttp::pair;

TEST_F(RegistrationsOverHttp, FindTheTransformAndApplyIt) {
  const Answer made = registered(pair);
  ASSERT_EQ(made.status, 201) << made.body;
  const Json json = made.json();
  const std::string path = "/v1/registrations/" + json["id"].get<std::string>();
  EXPECT_EQ(made.header("location"), path);
  EXPECT_NEAR(json["decomposition"]["scale"].get<double>(), 1 / 1.5, 0.002);
  EXPECT_NEAR(json["decomposition"]["angle_deg"].get<double>(), 90, 0.3);
  EXPECT_NEAR(json["decomposition"]["axis"][2].get<double>(), -1, 0.01);
  // moving index (35 - y, x, z) is fixed index (x, y, z): for a moving point p = origin + 1.5 index.
  const auto at = [&](const Json& matrix, std::array<double, 3> p) {
    std::array<double, 3> q{};
    for (std::size_t r = 0; r < 3; ++r) {
      q[r] = matrix[r][3];
      for (std::size_t c = 0; c < 3; ++c) q[r] += matrix[r][c].get<double>() * p[c];
    }
    return q;
  };
  for (const std::array<double, 3> index : {std::array{13.0, 17.0, 16.0}, {24.0, 22.0, 15.0}, {19.0, 9.0, 24.0}}) {
    const std::array<double, 3> there{100 + 1.5 * (35 - index[1]), -50 + 1.5 * index[0], 20 + 1.5 * index[2]};
    const auto q = at(json["moving_to_fixed"], there), p = at(json["fixed_to_moving"], index);
    for (std::size_t a = 0; a < 3; ++a) {
      EXPECT_NEAR(q[a], index[a], 0.1);
      EXPECT_NEAR(p[a], there[a], 0.15);
    }
  }
  EXPECT_EQ(json["quality"]["poor"], false);
  EXPECT_GT(json["quality"]["overlap"]["dice"], 0.98);
  EXPECT_LT(json["quality"]["surface_distance"]["p95_mm"], 0.5);
  EXPECT_TRUE(json["other_poses"].empty());
  EXPECT_TRUE(json["warnings"].empty());

  EXPECT_EQ(registered(pair).status, 200);
  EXPECT_EQ(client().get(path).body, made.body);
  EXPECT_EQ(client().get("/v1/registrations").json()["registrations"][0]["id"], json["id"]);

  // ITK's file: the map of fixed points to moving ones.
  const Answer itk = client().get(path + "?format=itk");
  std::istringstream lines(itk.body);
  std::string word;
  while (lines >> word && word != "Parameters:") continue;
  for (std::size_t r = 0; r < 3; ++r) {
    for (std::size_t c = 0; c < 3; ++c) {
      double element = 0;
      lines >> element;
      EXPECT_EQ(element, json["fixed_to_moving"][r][c].get<double>());
    }
  }

  // The moving volume on the fixed grid is the fixed volume, but for interpolation.
  const Answer applied = client().post(path + "/apply");
  ASSERT_EQ(applied.status, 200);
  ASSERT_EQ(applied.body.size(), 352U + 4U * kSize * kSize * kSize);
  const std::string truth = bytes(false);
  double sum = 0;
  for (std::size_t n = 0; n < truth.size(); ++n) {
    float sample = 0;
    std::memcpy(&sample, &applied.body[352 + 4 * n], 4);
    sum += std::abs(double(sample) - static_cast<unsigned char>(truth[n]));
  }
  EXPECT_LT(sum / static_cast<double>(truth.size()), 2);
  EXPECT_NE(client().upload("", applied.body), "") << "it is a volume like any other";
  const Answer mask = client().get(path + "/apply?what=model");
  ASSERT_EQ(mask.body.size(), 352U + kSize * kSize * kSize);
  std::size_t differ = 0;
  for (std::size_t n = 0; n < truth.size(); ++n)
    differ += (mask.body[352 + n] == 1) != (static_cast<unsigned char>(truth[n]) >= 127.5);
  EXPECT_LT(differ, 150U) << "of some 4,500 inside";

  const Answer picture = client().get(path + "/render?of=spheres&width=80&height=60");
  EXPECT_EQ(picture.header("content-type"), "image/png");
  EXPECT_NE(client().get(path + "/render?width=80&height=60").body, picture.body);
}

TEST_F(RegistrationsOverHttp, OfImportedSpheres) {
  const Answer imported =
      client().post("/v1/models", {.body = "x,y,z,r\n13,17,16,9\n24,22,15,6\n19,9,24,4.5\n", .type = "text/csv"});
  const std::string id = imported.json()["id"];
  const Answer made = registered(R"({"fixed": ")" + id + R"(", "moving": ")" + moving + R"("})");
  ASSERT_EQ(made.status, 201) << made.body;
  EXPECT_NEAR(made.json()["decomposition"]["scale"].get<double>(), 1 / 1.5, 0.01);
  EXPECT_GT(made.json()["quality"]["overlap"]["dice"], 0.95);
  const std::string path = "/v1/registrations/" + made.json()["id"].get<std::string>();
  EXPECT_EQ(client().post(path + "/apply").status, 422) << "the fixed model has no grid";
  EXPECT_EQ(client().get(path + "/render?style=tetrahedra").status, 422);
  EXPECT_EQ(client().ask("DELETE", "/v1/models/" + id).status, 204);
  EXPECT_EQ(client().get(path).status, 404) << "goes with a model that it is of";
}

TEST_F(RegistrationsOverHttp, RunAsJobs) {
  const Answer started =
      client().post("/v1/registrations", {.body = pair.substr(0, pair.size() - 1) + R"(, "method": "matching"})"});
  ASSERT_EQ(started.status, 202);
  EXPECT_EQ(started.json()["kind"], "registration");
  const Answer events = client().get(started.header("location") + "/events");
  EXPECT_NE(events.body.find("\"stage\":\"register\""), std::string::npos) << events.body;
  const Json over = client().get(started.header("location")).json();
  EXPECT_EQ(over["state"], "succeeded");
  EXPECT_EQ(client().get(over["links"]["result"]).json()["parameters"]["method"], "matching");
  EXPECT_EQ(registered(R"({"fixed": ")" + fixed + R"(", "moving": "mdl_00000000000000000000000000000000"})").status,
            404);
}

}  // namespace
}  // namespace spherule::test
