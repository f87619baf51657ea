// SPDX-License-Identifier: GPL-3.0-or-later
//
// Servers that end in order, and what the next one finds. Those that are killed: tests/faults.
#include <gtest/gtest.h>

#include <cstring>
#include <memory>

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

TEST(Restart, SaysThatItStopsAndKeepsWhatItCannotFinish) {
  const TemporaryFolder folder;
  auto server = std::make_unique<ServerProcess>(folder.path() / "data", std::vector<std::string>{"--drain", "600s"});
  std::string volume, job;
  {
    const Client client(server->port());
    // Noise: as many boundary points as samples, and more work than there is time.
    std::string noise(100 * 100 * 100, '\0');
    std::uint32_t state = 1;
    for (char& sample : noise) sample = static_cast<char>((state = state * 1664525U + 1013904223U) >> 24);
    volume = client.upload("?format=raw&dims=100,100,100&dtype=uint8", noise);
    const Answer asked = client.post("/v1/models", {.body = Json{{"volume", volume}, {"threshold", 99}}.dump()});
    ASSERT_EQ(asked.status, 202) << asked.body;
    job = asked.header("Location");
    while (client.get(job).json()["state"] != "running") {
    }
    server->ask_to_stop();
    Answer ready = client.get("/readyz");
    while (ready.status == 200) ready = client.get("/readyz");
    EXPECT_EQ(ready.status, 503);
    EXPECT_NE(ready.body.find("is stopping"), std::string::npos) << ready.body;
    // It goes on answering, but takes no more work.
    EXPECT_EQ(client.get("/livez").status, 200);
    EXPECT_EQ(client.get("/v1/volumes/" + volume).status, 200);
    EXPECT_EQ(client.get(job).status, 200);
    const Answer refused = client.post("/v1/models", {.body = Json{{"volume", volume}, {"threshold", 98}}.dump()});
    EXPECT_EQ(refused.status, 503);
    EXPECT_NE(refused.header("Retry-After"), "");
  }
  // A second signal ends its patience.
  server->ask_to_stop();
  EXPECT_EQ(server->await_end(), -1);

  server = std::make_unique<ServerProcess>(folder.path() / "data");
  const Client client(server->port());
  const std::string state = client.get(job).json()["state"];
  EXPECT_TRUE(state == "queued" || state == "running") << state;
  EXPECT_EQ(client.post(job + "/cancel").status, 202);
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

}  // namespace
}  // namespace spherule::test
