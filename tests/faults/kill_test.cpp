// SPDX-License-Identifier: GPL-3.0-or-later
//
// A server that is killed at random moments while clients upload, compute and fetch. What it had acknowledged must be
// there afterwards, what it had not must be there whole or not at all, and it must start again by itself.
#include <gtest/gtest.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <cstring>
#include <map>
#include <memory>
#include <mutex>
#include <random>
#include <set>
#include <thread>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

const std::string kRaw = "?format=raw&dims=40,40,40&dtype=uint8";

int kills() {
  const char* text = std::getenv("SPHERULE_KILLS");
  return text == nullptr ? 5 : std::atoi(text);
}

// A ball that no other number gives.
std::string numbered(int number) {
  static const std::string same = ball(40, 19);
  std::string bytes = same;
  std::memcpy(bytes.data(), &number, sizeof number);
  return bytes;
}

struct Acknowledged {
  std::mutex mutex;
  std::map<std::string, int> volumes;           // id -> number
  std::map<std::string, Json> models;           // id -> counts
  std::set<std::string> jobs;                   // paths
  std::map<std::string, std::string> measures;  // model -> document
};

/// Uploads, makes models and asks for measures as fast as it can until `done`, and keeps what it is told.
void work(const std::atomic<int>& port, const std::atomic<bool>& done, std::atomic<int>& next,
          std::atomic<int>& uploading, Acknowledged& known) {
  while (!done) {
    const Client client(port);
    const int number = next++;
    ++uploading;
    const Answer stored = client.post("/v1/volumes" + kRaw, {.body = numbered(number), .timeout_s = 10});
    --uploading;
    if (stored.status != 201) continue;
    const std::string volume = stored.json()["id"];
    {
      const std::lock_guard lock(known.mutex);
      known.volumes.emplace(volume, number);
    }
    const bool waits = number % 2 == 0;
    const Json wish{{"volume", volume}, {"threshold", 60.5}};
    const Answer made = client.post(
        "/v1/models", {.headers = {{"Prefer", waits ? "wait=10" : "wait=0"}}, .body = wish.dump(), .timeout_s = 15});
    std::string measures, model;
    if (made.status == 201) {
      model = made.json()["id"];
      const Answer answer = client.get("/v1/models/" + model + "/measures", {.timeout_s = 15});
      if (answer.status == 200) measures = answer.body;
    }
    const std::lock_guard lock(known.mutex);
    if (made.status == 201) known.models.emplace(model, made.json()["counts"]);
    if (made.status == 202) known.jobs.insert(made.header("Location"));
    if (!measures.empty()) known.measures.emplace(model, measures);
  }
}

/// Everything that is listed can be had, whole.
void expect_whole(const Client& client, const Json& volumes, const Json& models) {
  for (const Json& volume : volumes) {
    const Answer content = client.get("/v1/volumes/" + volume["id"].get<std::string>() + "/content");
    ASSERT_EQ(content.status, 200) << volume["id"];
    int number = 0;
    std::memcpy(&number, content.body.data(), sizeof number);
    EXPECT_TRUE(content.body == numbered(number)) << volume["id"];
  }
  for (const Json& model : models) {
    const Answer spheres = client.get("/v1/models/" + model["id"].get<std::string>() + "/spheres?limit=1");
    ASSERT_EQ(spheres.status, 200) << model["id"];
    EXPECT_EQ(spheres.json()["total"], model["counts"]["spheres"]);
  }
}

TEST(Kill, LosesNothingAcknowledgedAndServesNothingHalfWritten) {
  const TemporaryFolder folder;
  const auto data = folder.path() / "data";
  const std::vector<std::string> flags = {"--jobs-at-once", "2", "--queue-per-client", "64"};
  Acknowledged known;
  std::atomic<int> port{0}, next{1}, uploading{0};
  std::atomic<bool> done{false};
  std::mt19937 random(20251122);
  int while_uploading = 0;
  std::map<std::string, int> while_running;  // by the stage of the job

  auto server = std::make_unique<ServerProcess>(data, flags);
  port = server->port();
  std::vector<std::jthread> clients;
  for (int c = 0; c < 4; ++c) clients.emplace_back([&] { work(port, done, next, uploading, known); });
  for (int kill = 0; kill < kills(); ++kill) {
    // The moment of the kill, not a wait for anything.
    std::this_thread::sleep_for(std::chrono::microseconds(std::uniform_int_distribution<int>(0, 600'000)(random)));
    const Json jobs = Client(port).get("/v1/jobs?limit=20").json()["jobs"];
    for (const Json& job : jobs)
      if (job["state"] == "running") ++while_running[job["stage"]];
    while_uploading += uploading > 0;
    server->kill();
    server = std::make_unique<ServerProcess>(data, flags);
    port = server->port();
    const Client client(port);
    expect_whole(client, client.get("/v1/volumes?limit=3").json()["volumes"],
                 client.get("/v1/models?limit=3").json()["models"]);
    if (HasFatalFailure()) break;
  }
  done = true;
  clients.clear();

  const Client client(server->port());
  std::size_t ended = 0, given_up = 0;
  for (const std::string& job : known.jobs) {
    client.get(job + "/events");
    const Json over = client.get(job).json();
    // Work during which the server died twice is not tried again, and says so.
    const std::string reason = over.value("error", Json::object()).value("detail", "");
    if (reason.find("stopped 2 times") != std::string::npos) {
      ++given_up;
      continue;
    }
    EXPECT_EQ(over["state"], "succeeded") << over.dump();
    EXPECT_EQ(client.get(over["links"].value("result", "/")).status, 200) << job;
    ended += over["state"] == "succeeded";
  }
  for (const auto& [id, number] : known.volumes) {
    const Answer content = client.get("/v1/volumes/" + id + "/content");
    EXPECT_EQ(content.status, 200) << id;
    EXPECT_TRUE(content.body == numbered(number)) << id;
  }
  for (const auto& [id, counts] : known.models)
    EXPECT_EQ(client.get("/v1/models/" + id).json()["counts"], counts) << id;
  for (const auto& [id, document] : known.measures)
    EXPECT_EQ(client.get("/v1/models/" + id + "/measures").body, document) << id;
  EXPECT_EQ(server->terminate(), 0);
  const Ended check = run_spheruled({"fsck", "--data", data.string()});
  EXPECT_EQ(check.status, 0) << check.output;
  EXPECT_FALSE(std::filesystem::exists(data / "damaged")) << "what a kill leaves is understood";

  std::printf("%d kills: %d during uploads", kills(), while_uploading);
  for (const auto& [stage, count] : while_running) std::printf(", %d during %s", count, stage.c_str());
  std::printf("\nacknowledged and found: %zu volumes, %zu models, %zu of %zu jobs (%zu given up), %zu measures\n%s",
              known.volumes.size(), known.models.size(), ended, known.jobs.size(), given_up, known.measures.size(),
              check.output.c_str());
  EXPECT_GE(static_cast<int>(known.volumes.size()), kills());
  EXPECT_GE(static_cast<int>(known.models.size() + known.jobs.size()), kills() / 2);
}

}  // namespace
}  // namespace spherule::test
