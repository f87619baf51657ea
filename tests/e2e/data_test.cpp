// SPDX-License-Identifier: GPL-3.0-or-later
//
// Real scans through the service, and real files that are none.
#include <gtest/gtest.h>

#include <chrono>
#include <filesystem>
#include <fstream>
#include <sstream>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

std::string bytes_of(const std::filesystem::path& file) {
  std::ostringstream bytes;
  bytes << std::ifstream(file, std::ios::binary).rdbuf();
  return bytes.str();
}

class Data : public testing::Test {
 protected:
  void SetUp() override {
    if (!std::filesystem::exists(data)) GTEST_SKIP() << "the test volumes are not at hand";
    server = std::make_unique<ServerProcess>(folder.path() / "data");
    client.emplace(server->port());
  }
  Answer upload(const std::vector<std::string>& files, const std::string& query = {}) const {
    if (files.size() == 1) return client->post("/v1/volumes" + query, {.body = bytes_of(data / files[0])});
    std::string body;
    for (const std::string& file : files) {
      body += "--b7\r\nContent-Disposition: form-data; name=\"file\"; filename=\"" + file + "\"\r\n\r\n" +
              bytes_of(data / file) + "\r\n";
    }
    return client->post("/v1/volumes", {.body = body + "--b7--\r\n", .type = "multipart/form-data; boundary=b7"});
  }

  const std::filesystem::path data = SPHERULE_SHARED_DATA;
  TemporaryFolder folder;
  std::unique_ptr<ServerProcess> server;
  std::optional<Client> client;
};

TEST_F(Data, EveryFormatBecomesAModel) {
  struct Case {
    std::vector<std::string> files;
    std::string query;
    const char* format;
    double threshold;
    double volume_mm3;  // as the voxels were counted by other readers
  };
  const std::vector<Case> cases = {
      {{"mr-small.mhd", "mr-small.raw"}, "", "metaimage", 30, 2.363e6},
      {{"mr-small.raw"}, "?format=raw&dims=48,62,42&dtype=uint8&spacing=4,4,4", "raw", 30, 2.363e6},
      {{"pet.nii"}, "", "nifti", 0.5, 1.8104e6},
      {{"stent.nrrd"}, "", "nrrd", 1000, 6535},
      {{"sphere-fog.vdb"}, "", "openvdb", 0.5, 0},
  };
  for (const Case& c : cases) {
    const Answer stored = upload(c.files, c.query);
    ASSERT_EQ(stored.status, 201) << c.files[0] << stored.body;
    EXPECT_EQ(stored.json()["format"], c.format);
    const Json model = client->model({{"volume", stored.json()["id"]}, {"threshold", c.threshold}});
    const std::string path = "/v1/models/" + model["id"].get<std::string>();
    const Json measures = client->get(path + "/measures").json();
    if (c.volume_mm3 > 0) {
      EXPECT_NEAR(measures["voxels"]["volume_mm3"], c.volume_mm3, 1e-3 * c.volume_mm3) << c.files[0];
    }
    EXPECT_EQ(client->get(path + "/checks").json()["violations"], 0) << c.files[0];
  }
}

TEST_F(Data, LevelSetsAreInsideBelow) {
  const Answer stored = upload({"sphere-levelset.vdb"});
  ASSERT_EQ(stored.status, 201) << stored.body;
  EXPECT_EQ(stored.json()["inside_default"], "below");
  const Json model = client->model({{"volume", stored.json()["id"]}, {"threshold", 0}});
  EXPECT_EQ(model["parameters"]["inside"], "below");
  const Json measures = client->get("/v1/models/" + model["id"].get<std::string>() + "/measures").json();
  EXPECT_NEAR(measures["tetrahedra"]["volume_mm3"], 113.097, 0.5);
  EXPECT_EQ(measures["tetrahedra"]["betti"], Json({1, 0, 0}));
}

TEST_F(Data, MalformedFilesAreRefusedQuickly) {
  std::size_t files = 0;
  for (const auto& entry : std::filesystem::directory_iterator(data / "malformed")) {
    const auto start = std::chrono::steady_clock::now();
    const Answer answer = upload({"malformed/" + entry.path().filename().string()});
    EXPECT_GE(answer.status, 400) << entry.path();
    EXPECT_LT(answer.status, 500) << entry.path() << answer.body;
    EXPECT_LT(std::chrono::steady_clock::now() - start, std::chrono::seconds(5)) << entry.path();
    EXPECT_EQ(answer.body.find(folder.path().string()), std::string::npos) << "no path is shown: " << answer.body;
    ++files;
  }
  EXPECT_GE(files, 12U);
  EXPECT_LT(server->peak_memory(), std::size_t{300} << 20);
  const Answer frame = upload({"malformed/four-d.nii.gz"}, "?frame=1");
  EXPECT_EQ(frame.status, 201) << frame.body;
}

}  // namespace
}  // namespace spherule::test
