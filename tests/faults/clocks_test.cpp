// SPDX-License-Identifier: GPL-3.0-or-later
//
// Clocks that are set wrong, while a server runs or between two runs: nothing is deleted by mistake.
#include <gtest/gtest.h>

#include <chrono>
#include <cstdlib>
#include <filesystem>
#include <memory>
#include <thread>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"
#include "tests/long_form.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;
using namespace std::chrono_literals;

const std::string kRaw = "?format=raw&dims=40,40,40&dtype=uint8";
constexpr long kDay = 86'400;

class Clocks : public testing::Test {
 protected:
  TemporaryFolder folder;
  fs::path data = folder.path() / "data";
  std::unique_ptr<ServerProcess> server;
  std::string volume, model, upload;

  void SetUp() override {
#if defined(__SANITIZE_ADDRESS__) || defined(__SANITIZE_THREAD__)
    GTEST_SKIP() << "sanitizers do not bear what is loaded before them";
#endif
    start(0);
    volume = client().upload(kRaw, ball(40, 19));
    model = client().model({{"volume", volume}, {"threshold", 60.5}})["id"];
    upload = client()
                 .post("/v1/uploads", {.headers = {{"Upload-Length", "10"}, {"Tus-Resumable", "1.0.0"}}, .body = {}})
                 .header("Location");
    EXPECT_EQ(client().get(model_path() + "/measures").status, 200);
    ASSERT_EQ(server->terminate(), 0);
  }

  std::string model_path() const { return "/v1/models/" + model; }
  Client client() const { return Client(server->port()); }

  /// A server by whose clock it is `off` seconds later, and which keeps things for a month, answers for two seconds.
  void start(long off) {
    ::setenv("LD_PRELOAD", SPHERULE_WRONG_CLOCK, 1);
    ::setenv("SPHERULE_CLOCK_OFF", std::to_string(off).c_str(), 1);
    server =
        std::make_unique<ServerProcess>(data, std::vector<std::string>{"--keep-volumes", "30d", "--keep-models", "30d",
                                                                       "--keep-jobs", "30d", "--keep-answers", "2s"});
    ::unsetenv("LD_PRELOAD");
  }

  /// Polls for what another process does by itself.
  template <typename Happened>
  static bool await(const Happened& happened) {
    const auto end = std::chrono::steady_clock::now() + 60s;
    while (!happened()) {
      if (std::chrono::steady_clock::now() > end) return false;
      std::this_thread::sleep_for(50ms);
    }
    return true;
  }

  void expect_all_there() const {
    EXPECT_EQ(client().get("/v1/volumes/" + volume).status, 200);
    EXPECT_EQ(client().get(model_path()).status, 200);
    EXPECT_GE(client().get("/v1/jobs").json()["jobs"].size(), 2U);
    EXPECT_EQ(client().get(upload).status, 200);
  }
};

TEST_F(Clocks, ThatAreFortyDaysAheadAtOneStartDeleteNothing) {
  start(40 * kDay);
  EXPECT_TRUE(await([&] { return server->log().find("\"event\":\"clock_moved\"") != std::string::npos; }))
      << server->log();
  expect_all_there();
  // Two seconds of service later, what may go has gone, so rounds are made; and what may not has not.
  EXPECT_TRUE(await([&] { return fs::is_empty(data / "blobs" / "answers"); }));
  expect_all_there();
  ASSERT_EQ(server->terminate(), 0);

  start(0);  // set right again: forty days back
  EXPECT_TRUE(await([&] { return server->log().rfind("\"seconds\":-34") != std::string::npos; })) << server->log();
  expect_all_there();
  EXPECT_EQ(client().get(model_path() + "/measures").status, 200);
  EXPECT_TRUE(await([&] { return fs::is_empty(data / "blobs" / "answers"); }));
  expect_all_there();
  ASSERT_EQ(server->terminate(), 0);
}

TEST_F(Clocks, ThatAreOddDeleteNothing) {
  // Before 1970, far ahead, before the data was made, in 2038, about the time that things are kept, and back.
  std::vector<long> all = {-20'000 * kDay, 30'000 * kDay};
  if (long_form()) all.insert(all.end(), {-1 * kDay, 4'500 * kDay, 29 * kDay, 31 * kDay, 0});
  for (const long off : all) {
    start(off);
    EXPECT_EQ(client().get(model_path() + "/measures").status, 200) << off;
    EXPECT_TRUE(await([&] { return fs::is_empty(data / "blobs" / "answers"); })) << off;
    expect_all_there();
    ASSERT_EQ(server->terminate(), 0) << off;
  }
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);
}

}  // namespace
}  // namespace spherule::test
