// SPDX-License-Identifier: GPL-3.0-or-later
//
// A catalogue that is missing, or older than the blobs, as after a restore gone wrong: nothing that is not understood
// is deleted, and all comes back with the right catalogue.
#include <gtest/gtest.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <set>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

const std::string kRaw = "?format=raw&dims=20,20,20&dtype=uint8";

std::string numbered(int number) {
  std::string bytes = ball(20, 9);
  bytes[0] = static_cast<char>(number);
  return bytes;
}

class LostCatalogue : public testing::Test {
 protected:
  TemporaryFolder folder;
  fs::path data = folder.path() / "data", kept = folder.path() / "kept";
  std::unique_ptr<ServerProcess> server;
  std::vector<std::string> volumes;

  Client client() const { return Client(server->port()); }
  void start() { server = std::make_unique<ServerProcess>(data); }
  void stop() { ASSERT_EQ(server->terminate(), 0); }

  void upload(int count) {
    start();
    for (int i = 0; i < count; ++i)
      volumes.push_back(client().upload(kRaw, numbered(static_cast<int>(volumes.size()))));
    stop();
  }

  /// The catalogue, which is one file while no server runs.
  fs::path catalog() const { return data / "catalog.sqlite"; }
  std::set<fs::path> blobs() const {
    std::set<fs::path> all;
    for (const auto& entry : fs::recursive_directory_iterator(data / "blobs"))
      if (entry.is_regular_file()) all.insert(entry.path());
    return all;
  }
  std::size_t aside() const {
    return fs::exists(data / "damaged") ? static_cast<std::size_t>(std::distance(
                                              fs::directory_iterator(data / "damaged"), fs::directory_iterator()))
                                        : 0;
  }

  void expect_refused() const {
    const std::set<fs::path> before = blobs();
    const Ended refused = run_spheruled({"--port", "0", "--data", data.string()});
    EXPECT_NE(refused.status, 0);
    EXPECT_NE(refused.output.find("unknown to the catalogue"), std::string::npos) << refused.output;
    EXPECT_NE(refused.output.find("fsck --repair"), std::string::npos) << refused.output;
    EXPECT_EQ(blobs(), before) << "nothing is changed";
    EXPECT_EQ(aside(), 0U);
  }

  void expect_all_served() {
    start();
    for (std::size_t i = 0; i < volumes.size(); ++i)
      EXPECT_EQ(client().get("/v1/volumes/" + volumes[i] + "/content").body, numbered(static_cast<int>(i))) << i;
    stop();
    EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);
  }
};

TEST_F(LostCatalogue, IsNotServedWithout) {
  upload(3);
  fs::rename(catalog(), kept);
  expect_refused();
  expect_refused();  // nor the second time, with what the first has left
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 2);
  fs::rename(kept, catalog());
  expect_all_served();
}

TEST_F(LostCatalogue, IsNotServedWithAMuchOlderOne) {
  upload(1);
  fs::copy_file(catalog(), kept);
  upload(3);
  const fs::path right = folder.path() / "right";
  fs::rename(catalog(), right);
  fs::copy_file(kept, catalog());
  expect_refused();
  fs::copy_file(right, catalog(), fs::copy_options::overwrite_existing);
  expect_all_served();
}

TEST_F(LostCatalogue, SetsAsideWhatASomewhatOlderOneDoesNotKnow) {
  upload(3);
  fs::copy_file(catalog(), kept);
  upload(2);
  const fs::path right = folder.path() / "right";
  fs::rename(catalog(), right);
  fs::rename(kept, catalog());
  start();
  EXPECT_NE(server->log().find("\"event\":\"set_aside\""), std::string::npos) << server->log();
  EXPECT_EQ(client().get("/v1/volumes").json()["volumes"].size(), 3U);
  stop();
  EXPECT_EQ(aside(), 2U);
  fs::rename(right, catalog());
  const Ended repaired = run_spheruled({"fsck", "--repair", "--data", data.string()});
  EXPECT_NE(repaired.output.find("brought back"), std::string::npos) << repaired.output;
  expect_all_served();
}

TEST_F(LostCatalogue, IsGivenUpByRepairOnly) {
  upload(3);
  fs::rename(catalog(), kept);
  const Ended repaired = run_spheruled({"fsck", "--repair", "--data", data.string()});
  EXPECT_EQ(repaired.status, 2) << repaired.output;
  EXPECT_EQ(aside(), 3U) << "nothing is deleted";
  start();
  EXPECT_TRUE(client().get("/v1/volumes").json()["volumes"].empty());
  stop();
  fs::rename(kept, catalog());
  EXPECT_EQ(run_spheruled({"fsck", "--repair", "--data", data.string()}).status, 2);
  expect_all_served();
}

}  // namespace
}  // namespace spherule::test
