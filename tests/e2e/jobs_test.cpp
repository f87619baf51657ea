// SPDX-License-Identifier: GPL-3.0-or-later
//
// Whose jobs are whose, and when they end.
#include <gtest/gtest.h>

#include <chrono>
#include <thread>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

// Noise: as many boundary points as samples, so that a model of it takes long.
std::string noise(int n) {
  std::string bytes(static_cast<std::size_t>(n) * n * n, '\0');
  std::uint32_t state = 1;
  for (char& sample : bytes) sample = static_cast<char>((state = state * 1664525U + 1013904223U) >> 24);
  return bytes;
}

class Jobs : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new TemporaryFolder;
    ann = make_key("ann", "write");
    ben = make_key("ben", "write");
    ops = make_key("ops", "admin");
    server = new ServerProcess(folder->path() / "data", {"--keys", ann.entry + "," + ben.entry + "," + ops.entry});
  }
  static void TearDownTestSuite() {
    delete server;
    delete folder;
  }
  static Ask as(const Key& key, const std::string& body = {}, const std::string& prefer = "respond-async") {
    return {.headers = {{"Authorization", "Bearer " + key.token}, {"Prefer", prefer}}, .body = body};
  }
  static Client client() { return Client(server->port()); }
  // A volume of its own for each test, and so jobs of its own.
  static std::string volume(char first) {
    std::string bytes = noise(100);
    bytes[0] = first;
    Ask ask = as(ann, bytes);
    ask.type = "application/octet-stream";
    const Answer answer = client().post("/v1/volumes?format=raw&dims=100,100,100&dtype=uint8", ask);
    EXPECT_EQ(answer.status, 201) << answer.body;
    return answer.json()["id"];
  }
  static std::string wish(const std::string& volume, double threshold = 99.5) {
    return Json{{"volume", volume}, {"threshold", threshold}}.dump();
  }
  static std::string await_end(const std::string& job) {
    client().get(job + "/events", as(ann));
    return client().get(job, as(ann)).json()["state"];
  }

  static TemporaryFolder* folder;
  static ServerProcess* server;
  static Key ann, ben, ops;
};
TemporaryFolder* Jobs::folder = nullptr;
ServerProcess* Jobs::server = nullptr;
Key Jobs::ann, Jobs::ben, Jobs::ops;

TEST_F(Jobs, AreCancelledByWhoAskedForThem) {
  const std::string body = wish(volume(1));
  std::string job;
  for (int i = 0; i < 10; ++i) job = client().post("/v1/models", as(ann, body)).header("Location");
  const Answer refused = client().post(job + "/cancel", as(ben));
  EXPECT_EQ(refused.status, 403) << refused.body;
  EXPECT_NE(refused.json()["detail"].get<std::string>().find("admin"), std::string::npos);
  EXPECT_EQ(client().post("/v1/models", as(ben, body)).header("Location"), job);
  EXPECT_NE(client().post(job + "/cancel", as(ben)).json()["state"], "cancelling") << "ann still wants it";
  EXPECT_EQ(client().post(job + "/cancel", as(ben)).status, 403);
  EXPECT_EQ(client().post(job + "/cancel", as(ann)).status, 202);
  EXPECT_EQ(await_end(job), "cancelled") << "ten requests of one client, one cancel";
}

TEST_F(Jobs, AreCancelledByAnAdministrator) {
  const std::string body = wish(volume(2));
  const std::string job = client().post("/v1/models", as(ann, body)).header("Location");
  EXPECT_EQ(client().post("/v1/models", as(ben, body)).header("Location"), job);
  EXPECT_EQ(client().post("/v1/models", as(ops, body)).header("Location"), job);
  EXPECT_NE(client().post(job + "/cancel", as(ops)).json()["state"], "cancelling") << "its own request first";
  EXPECT_EQ(client().post(job + "/cancel", as(ops)).status, 202);
  EXPECT_EQ(await_end(job), "cancelled");
}

TEST_F(Jobs, EndWithWhatTheyWorkOn) {
  const std::string id = volume(3);
  const std::string running = client().post("/v1/models", as(ann, wish(id))).header("Location");
  const std::string queued = client().post("/v1/models", as(ann, wish(id, 120.5))).header("Location");
  ASSERT_NE(queued, running);
  while (client().get(running, as(ann)).json()["state"] == "queued") {
  }
  Answer waiting;
  {
    std::jthread waiter([&] { waiting = client().post("/v1/models", as(ben, wish(id, 120.5), "wait=60")); });
    // It waits, or asks for a volume that is gone.
    EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + id, as(ops)).status, 204);
  }
  EXPECT_TRUE(waiting.status == 409 || waiting.status == 404) << waiting.status;
  for (const std::string& job : {running, queued}) {
    EXPECT_EQ(await_end(job), "failed");
    const Json over = client().get(job, as(ann)).json();
    EXPECT_EQ(over["error"]["status"], 409);
    EXPECT_NE(over["error"]["detail"].get<std::string>().find("was deleted"), std::string::npos) << over;
    EXPECT_LT(over["progress"], 1);
  }
  EXPECT_EQ(client().get("/readyz").status, 200);
}

TEST_F(Jobs, CountValuesOnceAndKeepTheCounts) {
  const std::string id = volume(4), path = "/v1/volumes/" + id + "/histogram?buckets=10";
  // Nothing runs beside it, yet small uploads and readers do not wait for anything.
  const std::string busy = client().post("/v1/models", as(ann, wish(id))).header("Location");
  const Answer queued = client().get(path, as(ann));
  ASSERT_EQ(queued.status, 202) << queued.body;
  EXPECT_EQ(queued.json()["kind"], "histogram");
  volume(5);
  EXPECT_EQ(client().post(busy + "/cancel", as(ann)).status, 202);
  EXPECT_EQ(await_end(queued.header("Location")), "succeeded");
  EXPECT_EQ(client().get(queued.header("Location"), as(ann)).json()["links"]["result"], path);
  const Json jobs = client().get("/v1/jobs", as(ann)).json();
  const Answer first = client().get(path, as(ann)), plot = client().get(path + "&format=svg", as(ben));
  EXPECT_EQ(first.status, 200);
  EXPECT_EQ(plot.status, 200);
  std::uint64_t samples = 0;
  for (const auto& count : first.json()["counts"].get<std::vector<std::uint64_t>>()) samples += count;
  EXPECT_EQ(samples, 1'000'000U);
  EXPECT_EQ(client().get("/v1/jobs", as(ann)).json()["jobs"].size(), jobs["jobs"].size()) << "counted once";
}

TEST_F(Jobs, WaitingPlacesAreShared) {
  const std::string body = wish(volume(6));
  const std::string job = client().post("/v1/models", as(ann, body)).header("Location");
  // More than a half, which is what one client gets.
  constexpr int many = 40;
  std::atomic<int> told_to_poll{0}, waited{0};
  {
    std::vector<std::jthread> waiters;
    for (int i = 0; i < many; ++i)
      waiters.emplace_back([&] {
        const Answer answer = client().post("/v1/models", as(ann, body, "wait=30"));
        if (answer.status == 202 && answer.header("Preference-Applied").empty()) ++told_to_poll;
        if (answer.status == 409) ++waited;
      });
    // Those without a place answer at once.
    while (told_to_poll < many - 32) std::this_thread::yield();
    Answer other;
    std::jthread waiter([&] { other = client().post("/v1/models", as(ben, body, "wait=1")); });
    waiter.join();
    EXPECT_EQ(other.status, 202);
    EXPECT_EQ(other.header("Preference-Applied"), "wait=1") << "somebody else finds a place, and waits";
    EXPECT_EQ(client().post(job + "/cancel", as(ben)).status, 202);
    EXPECT_EQ(client().post(job + "/cancel", as(ann)).status, 202);
  }
  EXPECT_EQ(told_to_poll, many - 32);
  EXPECT_EQ(waited, 32);
  EXPECT_EQ(await_end(job), "cancelled");
}

TEST(JobTime, IsLimited) {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data", {"--max-job-s", "1"});
  const Client client(server.port());
  const std::string id = client.upload("?format=raw&dims=128,128,128&dtype=uint8", noise(128));
  const Answer answer = client.post(
      "/v1/models", {.headers = {{"Prefer", "wait=60"}}, .body = Json{{"volume", id}, {"threshold", 99.5}}.dump()});
  EXPECT_EQ(answer.status, 413) << answer.body;
  EXPECT_NE(answer.json()["detail"].get<std::string>().find("max_job_s"), std::string::npos) << answer.body;
}

// How a stream ends that is open while the server stops: at once, and without going round and round until then.
TEST(JobStreams, EndWhenTheServerStops) {
  const TemporaryFolder folder;
  ServerProcess server(folder.path() / "data", {"--drain", "600s"});
  const Client client(server.port());
  const std::string id = client.upload("?format=raw&dims=100,100,100&dtype=uint8", noise(100));
  const Answer asked = client.post("/v1/models", {.body = Json{{"volume", id}, {"threshold", 99.5}}.dump()});
  ASSERT_EQ(asked.status, 202);
  Answer events;
  std::jthread reader([&] { events = client.get(asked.header("Location") + "/events"); });
  while (client.get("/metrics").body.find("spherule_http_streams 1") == std::string::npos) {
  }
  server.ask_to_stop();
  reader.join();
  EXPECT_EQ(events.status, 200);
  EXPECT_EQ(events.body.find("event: end"), std::string::npos);
  EXPECT_LT(events.body.size(), 100'000U) << "a comment for every turn of a loop";
  EXPECT_EQ(client.get("/livez").status, 200) << "it still drains";
}

}  // namespace
}  // namespace spherule::test
