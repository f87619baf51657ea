// SPDX-License-Identifier: GPL-3.0-or-later
//
// Servers that are killed, and what the next one finds.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <memory>
#include <mutex>
#include <random>
#include <thread>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

const std::string kRaw = "?format=raw&dims=20,20,20&dtype=uint8";

// A ball that no other number gives.
std::string numbered(int number) {
  std::string bytes = ball(20, 9);
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}

TEST(Restart, FindsEverythingAgain) {
  const TemporaryFolder folder;
  auto server = std::make_unique<ServerProcess>(folder.path() / "data");
  const std::string volume = Client(server->port()).upload(kRaw, numbered(1));
  const Json model = Client(server->port()).model({{"volume", volume}, {"threshold", 99}});
  const std::string path = "/v1/models/" + model["id"].get<std::string>();
  const std::string measures = Client(server->port()).get(path + "/measures").body;
  const std::string csv = Client(server->port()).get(path + "/exports/csv").body;
  EXPECT_EQ(server->terminate(), 0);

  server = std::make_unique<ServerProcess>(folder.path() / "data");
  const Client client(server->port());
  EXPECT_EQ(client.get("/v1/volumes/" + volume + "/content").body, numbered(1));
  EXPECT_EQ(client.get(path).json()["counts"], model["counts"]);
  EXPECT_EQ(client.get(path + "/measures").body, measures);
  EXPECT_EQ(client.get(path + "/exports/csv").body, csv);
  // From the stored model, not from stored answers.
  EXPECT_EQ(client.get(path + "/spheres?limit=1").json()["total"], model["counts"]["spheres"]);
  EXPECT_EQ(client.get(path + "/checks").json()["violations"], 0);
}

TEST(Restart, IsRefusedToASecondServer) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data");
  EXPECT_THROW(ServerProcess(folder.path() / "data"), std::runtime_error);
  EXPECT_EQ(Client(server.port()).get("/livez").status, 200);
}

TEST(Restart, MakesTheSameModelOnAnyNumberOfThreads) {
  std::vector<std::string> spheres;
  for (const char* threads : {"1", "4"}) {
    const TemporaryFolder folder;
    const ServerProcess server(folder.path() / "data", {"--threads", threads});
    const Client client(server.port());
    const Json model = client.model({{"volume", client.upload(kRaw, numbered(1))}, {"threshold", 60.5}});
    spheres.push_back(model["id"].get<std::string>() +
                      client.get("/v1/models/" + model["id"].get<std::string>() + "/exports/csv").body);
  }
  EXPECT_EQ(spheres[0], spheres[1]);
}

// Three clients upload and make models as fast as they can and note what was acknowledged; the server is killed at
// random moments. In the end all of it must be there, and every job that was accepted must have come to its end.
TEST(Crash, LosesNothingAcknowledged) {
  const TemporaryFolder folder;
  std::mutex mutex;
  std::set<int> volumes;         // acknowledged by their numbers
  std::set<std::string> models;  // by their ids
  std::set<std::string> jobs;    // paths
  std::atomic<int> port{0}, next{1};
  std::atomic<bool> done{false};
  std::mt19937 random(20251122);
  constexpr int kKills = 20;

  auto server = std::make_unique<ServerProcess>(folder.path() / "data");
  port = server->port();
  std::vector<std::jthread> clients;
  for (int c = 0; c < 3; ++c) {
    clients.emplace_back([&] {
      while (!done) {
        const Client client(port);
        const int number = next++;
        const Answer stored = client.post("/v1/volumes" + kRaw, {.body = numbered(number), .timeout_s = 10});
        if (stored.status != 201) continue;
        {
          const std::lock_guard lock(mutex);
          volumes.insert(number);
        }
        const bool waits = number % 2 == 0;
        const Json wish{{"volume", stored.json()["id"]}, {"threshold", 60.5}};
        const Answer made =
            client.post("/v1/models",
                        {.headers = {{"Prefer", waits ? "wait=10" : "wait=0"}}, .body = wish.dump(), .timeout_s = 15});
        const std::lock_guard lock(mutex);
        if (made.status == 201) models.insert(made.json()["id"]);
        if (made.status == 202) jobs.insert(made.header("Location"));
      }
    });
  }
  for (int kills = 0; kills < kKills; ++kills) {
    std::this_thread::sleep_for(std::chrono::milliseconds(std::uniform_int_distribution<int>(0, 700)(random)));
    server->kill();
    server = std::make_unique<ServerProcess>(folder.path() / "data");
    port = server->port();
  }
  done = true;
  clients.clear();
  EXPECT_GT(volumes.size(), 20U);
  EXPECT_GT(models.size(), 5U);
  EXPECT_GT(jobs.size(), 5U);

  const Client client(server->port());
  for (const int number : volumes) {
    const Answer again = client.post("/v1/volumes" + kRaw, {.body = numbered(number)});
    EXPECT_EQ(again.status, 200) << "volume " << number;
    EXPECT_EQ(client.get("/v1/volumes/" + again.json()["id"].get<std::string>() + "/content").body, numbered(number));
  }
  for (const std::string& job : jobs) {
    client.get(job + "/events");
    const Json over = client.get(job).json();
    EXPECT_EQ(over["state"], "succeeded") << over.dump();
    const std::string result = over["links"].value("result", "");
    EXPECT_EQ(client.get(result).status, 200) << job;
    models.insert(result.substr(result.rfind('/') + 1));
  }
  for (const std::string& model : models) {
    EXPECT_EQ(client.get("/v1/models/" + model).status, 200);
    EXPECT_EQ(client.get("/v1/models/" + model + "/spheres?limit=1").status, 200);
  }
  std::printf("%d kills, %zu volumes, %zu models, %zu jobs\n", kKills, volumes.size(), models.size(), jobs.size());
}

}  // namespace
}  // namespace spherule::test
