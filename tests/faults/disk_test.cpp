// SPDX-License-Identifier: GPL-3.0-or-later
//
// Disks that are full, read-only or damaged under a server: it says so, goes on with what it can, and is whole again
// when they are.
#include <gtest/gtest.h>
#include <sched.h>
#include <sys/mount.h>
#include <sys/stat.h>
#include <unistd.h>

#include <filesystem>
#include <fstream>
#include <memory>
#include <set>
#include <sstream>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

const std::string kRaw = "?format=raw&dims=40,40,40&dtype=uint8";

std::string numbered(char number) {
  std::string bytes = ball(40, 19);
  bytes[0] = number;
  return bytes;
}

class Disk : public testing::Test {
 protected:
  TemporaryFolder folder;
  fs::path data = folder.path() / "disk" / "data";
  std::unique_ptr<ServerProcess> server;
  std::string volume, model, measures;

  void SetUp() override { fs::create_directory(folder.path() / "disk"); }

  Client client() const { return Client(server->port()); }
  std::string path() const { return "/v1/models/" + model; }

  void start() { server = std::make_unique<ServerProcess>(data); }
  void stop() { EXPECT_EQ(server->terminate(), 0); }

  /// One of everything.
  void fill() {
    volume = client().upload(kRaw, numbered(1));
    model = client().model({{"volume", volume}, {"threshold", 60.5}})["id"];
    measures = client().get(path() + "/measures").body;
  }
  void expect_all_there() {
    EXPECT_EQ(client().get("/v1/volumes/" + volume + "/content").body, numbered(1));
    EXPECT_EQ(client().get(path() + "/spheres?limit=1").status, 200);
    EXPECT_EQ(client().get(path() + "/measures").body, measures);
  }
  static void expect_says(const Answer& answer, int status, const std::string& words) {
    EXPECT_EQ(answer.status, status) << answer.body;
    EXPECT_NE(answer.json().value("detail", "").find(words), std::string::npos) << answer.body;
  }

  /// The one file of a collection.
  fs::path blob(const std::string& collection) const {
    return fs::directory_iterator(data / "blobs" / collection)->path();
  }
  static void damage(const fs::path& file, std::streamoff at, const std::string& bytes) {
    std::fstream stream(file, std::ios::in | std::ios::out | std::ios::binary);
    stream.seekp(at);
    stream << bytes;
  }
};

/// In a mount namespace of its own, which ends with the test's process.
class MountedDisk : public Disk {
 protected:
  void SetUp() override {
    Disk::SetUp();
    const fs::path disk = folder.path() / "disk";
    if (::unshare(CLONE_NEWNS) != 0 || ::mount("none", "/", nullptr, MS_REC | MS_PRIVATE, nullptr) != 0 ||
        ::mount("none", disk.c_str(), "tmpfs", 0, "size=80m") != 0)
      GTEST_SKIP() << "only root may mount the small file system that this needs";
    mounted = true;
  }
  void TearDown() override {
    server.reset();
    if (mounted) ::umount2((folder.path() / "disk").c_str(), MNT_DETACH);
  }
  void take_the_rest() const {
    for (const std::size_t size : {1 << 16, 1 << 12}) {
      std::ofstream filler(folder.path() / "disk" / "filler", std::ios::app);
      for (const std::string piece(size, 'x');
           filler.write(piece.data(), static_cast<std::streamsize>(size)) && filler.flush();) {
      }
    }
  }
  std::uintmax_t free_bytes() const { return fs::space(folder.path() / "disk").available; }

  bool mounted = false;
};

TEST_F(MountedDisk, FullRefusesWhatDoesNotFitAndGoesOn) {
  start();
  fill();
  const std::string large(std::size_t{100} << 20, 'x');
  const std::string query = "?format=raw&dims=100,1024,1024&dtype=uint8";
  expect_says(client().post("/v1/volumes" + query, {.body = large}), 507, "full");
  // The same without saying so beforehand.
  std::string chunked =
      "POST /v1/volumes" + query + " HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n";
  chunked += "6400000\r\n" + large + "\r\n0\r\n\r\n";
  EXPECT_TRUE(client().raw(chunked).starts_with("HTTP/1.1 507"));
  EXPECT_TRUE(fs::is_empty(data / "blobs" / ".tmp")) << "nothing is left of it";
  expect_all_there();
  EXPECT_EQ(client().get("/readyz").status, 200);

  take_the_rest();
  expect_says(client().get("/readyz"), 503, "disk is full");
  expect_says(client().post("/v1/volumes" + kRaw, {.body = numbered(2)}), 507, "full");
  const Answer refused = client().post(
      "/v1/models", {.headers = {{"Prefer", "wait=30"}}, .body = Json{{"volume", volume}, {"threshold", 99}}.dump()});
  EXPECT_EQ(refused.status, 507) << refused.body;
  expect_all_there();

  fs::remove(folder.path() / "disk" / "filler");
  EXPECT_EQ(client().get("/readyz").status, 200);
  client().upload(kRaw, numbered(2));
  client().model({{"volume", volume}, {"threshold", 99}});
  stop();
  const Ended check = run_spheruled({"fsck", "--data", data.string()});
  EXPECT_EQ(check.status, 0) << check.output;
}

// What fills a server's disk is often not the server.
TEST_F(MountedDisk, FullStopsNoDeletionAndNoReading) {
  // Uses are noted, by which reading writes.
  server = std::make_unique<ServerProcess>(data, std::vector<std::string>{"--keep-models", "10m"});
  fill();
  const std::string other = client().upload(kRaw, numbered(2));
  take_the_rest();
  ASSERT_EQ(client().post("/v1/volumes" + kRaw, {.body = numbered(3)}).status, 507);
  EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + volume).status, 204);
  EXPECT_EQ(client().get("/v1/volumes/" + volume).status, 404);
  EXPECT_EQ(client().get(path()).status, 404);
  take_the_rest();  // all that this made free
  EXPECT_EQ(client().get("/v1/volumes/" + other).status, 200);
  stop();
  fs::remove(folder.path() / "disk" / "filler");
  const Ended check = run_spheruled({"fsck", "--data", data.string()});
  EXPECT_EQ(check.status, 0) << check.output;
}

// Uploads in pieces, and bodies that do not say how long they are, stop before the reserve.
TEST_F(MountedDisk, UploadsKeepTheReserve) {
  constexpr std::uintmax_t reserve = std::uintmax_t{64} << 20, slack = std::uintmax_t{1} << 20;
  start();
  fill();
  const auto begin = [&](std::size_t length) {
    return client().post(
        "/v1/uploads",
        {.headers = {{"Upload-Length", std::to_string(length)}, {"Tus-Resumable", "1.0.0"}}, .body = {}});
  };
  const std::size_t room = free_bytes() - reserve;
  const Answer first = begin(room * 6 / 10);
  ASSERT_EQ(first.status, 201) << first.body;
  EXPECT_EQ(begin(room * 6 / 10).status, 507) << "the rest is spoken for";
  // For those that come at once, too, whether they say how long they are or not.
  const std::string scan(room * 5 / 10, 'x');
  EXPECT_EQ(client().post("/v1/volumes" + kRaw, {.body = scan}).status, 507);
  std::ostringstream chunked;
  chunked << "POST /v1/volumes" << kRaw << " HTTP/1.1\r\nHost: localhost\r\nTransfer-Encoding: chunked\r\n\r\n"
          << std::hex << scan.size() << "\r\n"
          << scan << "\r\n0\r\n\r\n";
  EXPECT_TRUE(client().raw(chunked.str()).starts_with("HTTP/1.1 507"));
  const Answer second = begin(room * 3 / 10);
  ASSERT_EQ(second.status, 201);
  const auto append = [&](const Answer& upload, std::size_t bytes) {
    return client().ask("PATCH", upload.header("Location"),
                        {.headers = {{"Upload-Offset", "0"},
                                     {"Tus-Resumable", "1.0.0"},
                                     {"Content-Type", "application/offset+octet-stream"}},
                         .body = std::string(bytes, 'x')});
  };
  EXPECT_EQ(append(first, room * 6 / 10).status, 204);
  {
    std::ofstream other(folder.path() / "disk" / "other");  // another program's
    other << std::string(room * 3 / 10, 'x');
  }
  EXPECT_EQ(append(second, room * 3 / 10).status, 507);
  EXPECT_GE(free_bytes() + slack, reserve);
  EXPECT_EQ(client().ask("DELETE", second.header("Location")).status, 204);
  EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + volume).status, 204);
  stop();
}

TEST_F(MountedDisk, ReadOnlyIsSaidAndStillRead) {
  start();
  fill();
  // New files see the folder read-only from here on; those that are open are written as before.
  ASSERT_EQ(::mount(data.c_str(), data.c_str(), nullptr, MS_BIND, nullptr), 0);
  ASSERT_EQ(::mount(nullptr, data.c_str(), nullptr, MS_REMOUNT | MS_BIND | MS_RDONLY, nullptr), 0);
  expect_says(client().get("/readyz"), 503, "cannot be written");
  expect_says(client().post("/v1/volumes" + kRaw, {.body = numbered(2)}), 500, "check the data folder");
  expect_all_there();
  EXPECT_EQ(client().get("/livez").status, 200);
  EXPECT_THROW(ServerProcess second(data), std::runtime_error);

  ASSERT_EQ(::umount2(data.c_str(), MNT_DETACH), 0);
  EXPECT_EQ(client().get("/readyz").status, 200);
  client().upload(kRaw, numbered(2));
  stop();
}

TEST_F(MountedDisk, ReadOnlyIsSaidAtTheStart) {
  start();
  fill();
  stop();
  ASSERT_EQ(::mount(nullptr, (folder.path() / "disk").c_str(), nullptr, MS_REMOUNT | MS_RDONLY, nullptr), 0);
  const Ended refused = run_spheruled({"--port", "0", "--data", data.string()});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NE(refused.output.find("cannot"), std::string::npos) << refused.output;
  ASSERT_EQ(::mount(nullptr, (folder.path() / "disk").c_str(), nullptr, MS_REMOUNT, nullptr), 0);
  start();
  expect_all_there();
}

TEST_F(Disk, ADamagedAnswerIsMadeAgain) {
  start();
  fill();
  const std::string csv = client().get(path() + "/exports/csv").body;
  stop();
  std::size_t damaged = 0;
  for (const auto& answer : fs::directory_iterator(data / "blobs" / "answers")) {
    damage(answer.path(), 5, "\xff");
    ++damaged;
  }
  EXPECT_GE(damaged, 2U);
  start();
  EXPECT_EQ(client().get(path() + "/exports/csv").body, csv);
  EXPECT_EQ(client().get(path() + "/measures").body, measures);
  EXPECT_NE(server->log().find("\"event\":\"damaged\""), std::string::npos) << server->log();
  stop();
}

TEST_F(Disk, ADamagedRecordIsListedContainedAndRepaired) {
  start();
  fill();
  const std::string other = client().upload(kRaw, numbered(2));
  stop();
  const fs::path catalog = data / "catalog.sqlite";
  std::ifstream stream(catalog, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(stream), {});
  for (std::size_t at = 0; (at = bytes.find("{\"below\":", at)) != std::string::npos; ++at)
    if (bytes.substr(bytes.find("\"id\":", at)).starts_with("\"id\":\"" + volume))
      damage(catalog, static_cast<std::streamoff>(at), "?");
  start();
  const Json list = client().get("/v1/volumes").json();
  ASSERT_EQ(list["volumes"].size(), 1U) << list.dump();
  EXPECT_EQ(list["volumes"][0]["id"], other);
  EXPECT_EQ(list["damaged"], Json::array({volume}));
  expect_says(client().get("/v1/volumes/" + volume), 500, "record of this resource is damaged");
  EXPECT_EQ(client().get("/v1/models").json()["models"].size(), 1U);
  stop();
  const Ended found = run_spheruled({"fsck", "--data", data.string()});
  EXPECT_NE(found.output.find("a record is damaged: " + volume), std::string::npos) << found.output;
  start();
  EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + volume).status, 204);
  EXPECT_EQ(client().upload(kRaw, numbered(1)), volume) << "the same again";
  stop();
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);
}

TEST_F(Disk, AnswersStayWithinTheirBudget) {
  constexpr std::uintmax_t budget = 200'000;
  server =
      std::make_unique<ServerProcess>(data, std::vector<std::string>{"--max-answer-bytes", std::to_string(budget)});
  fill();
  std::set<std::string> met;  // names of answers that were there
  const auto stored = [&] {
    std::uintmax_t sum = 0;
    for (const auto& answer : fs::directory_iterator(data / "blobs" / "answers")) {
      sum += answer.file_size();
      met.insert(answer.path().filename());
    }
    return sum;
  };
  std::uintmax_t made = 0;
  for (int width = 100; width < 112; ++width) {
    const Answer picture = client().ask("HEAD", path() + "/render?width=" + std::to_string(width) + "&height=200",
                                        {.headers = {{"Prefer", "wait=60"}}});
    ASSERT_EQ(picture.status, 200);
    made += std::stoul(picture.header("Content-Length"));
    EXPECT_LE(stored(), budget);
  }
  const std::string csv = client().get(path() + "/exports/csv").body;
  made += csv.size();
  EXPECT_GT(made, budget) << "or nothing had to go";
  std::ostringstream audit;
  audit << std::ifstream(data / "audit.log").rdbuf();
  for (const std::string& name : met) {
    if (fs::exists(data / "blobs" / "answers" / name)) continue;
    const std::string id = name.substr(0, name.find('.'));
    EXPECT_NE(audit.str().find(R"("who":"retention","action":"expire","object":")" + id + '"'), std::string::npos)
        << "gone without a word: " << name;
  }
  EXPECT_GT(stored(), 0U);
  EXPECT_EQ(client().get(path() + "/measures").body, measures) << "made again";
  EXPECT_EQ(client().get(path() + "/exports/csv").body, csv);
  stop();
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);
}

TEST_F(Disk, AllThatItHoldsIsForItsOwnersEyesOnly) {
  const mode_t usual = ::umask(0);
  start();
  fill();
  client().post("/v1/uploads", {.headers = {{"Upload-Length", "10"}, {"Tus-Resumable", "1.0.0"}}, .body = {}});
  client().post("/v1/models", {.headers = {{"Idempotency-Key", "a"}, {"Prefer", "wait=30"}},
                               .body = Json{{"volume", volume}, {"threshold", 60.5}}.dump()});
  const auto expect_private = [&] {
    constexpr auto others = fs::perms::group_all | fs::perms::others_all;
    EXPECT_EQ(fs::status(data).permissions() & others, fs::perms::none);
    for (const auto& entry : fs::recursive_directory_iterator(data))
      EXPECT_EQ(entry.status().permissions() & others, fs::perms::none) << entry.path();
  };
  expect_private();
  stop();
  // As an earlier version left them.
  fs::permissions(data, fs::perms(0755));
  fs::permissions(data / "catalog.sqlite", fs::perms(0644));
  fs::permissions(data / "uploads", fs::perms(0755));
  start();
  expect_private();
  ::umask(usual);
}

TEST_F(Disk, DamagedBlobsAreReportedContainedAndReplaceable) {
  start();
  fill();
  const std::string other = client().upload(kRaw, numbered(2));
  const std::string other_model = client().model({{"volume", other}, {"threshold", 60.5}})["id"];
  stop();
  for (const auto& file : fs::directory_iterator(data / "blobs" / "volumes"))
    if (file.path().filename().string().starts_with(volume)) damage(file.path(), 30'000, "damage");
  for (const auto& file : fs::directory_iterator(data / "blobs" / "models"))
    if (file.path().filename().string().starts_with(model)) damage(file.path(), 3'000, "damage");

  start();
  expect_says(client().get("/v1/volumes/" + volume + "/content"), 500, "damaged");
  expect_says(client().get(path() + "/spheres?limit=1"), 500, "damaged");
  EXPECT_EQ(client().get(path() + "/measures").body, measures) << "what is whole is served";
  EXPECT_EQ(client().get("/v1/volumes/" + other + "/content").body, numbered(2));
  EXPECT_EQ(client().get("/v1/models/" + other_model + "/spheres?limit=1").status, 200);
  stop();

  const Ended found = run_spheruled({"fsck", "--data", data.string()});
  EXPECT_EQ(found.status, 2);
  EXPECT_NE(found.output.find("a blob is damaged: " + volume), std::string::npos) << found.output;
  EXPECT_NE(found.output.find("a blob is damaged: " + model), std::string::npos) << found.output;
  EXPECT_NE(found.output.find("2 findings"), std::string::npos) << found.output;
  EXPECT_EQ(run_spheruled({"fsck", "--repair", "--data", data.string()}).status, 2);
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);

  start();
  EXPECT_EQ(client().get(path()).status, 404);
  EXPECT_EQ(client().get("/v1/models/" + other_model + "/spheres?limit=1").status, 200);
  EXPECT_EQ(client().upload(kRaw, numbered(1)), volume);
  EXPECT_EQ(client().model({{"volume", volume}, {"threshold", 60.5}})["id"], model);
  expect_all_there();
}

TEST_F(Disk, ADamagedPageOfTheCatalogueIsSaidAndRepaired) {
  start();
  fill();
  std::vector<std::string> volumes = {volume};
  for (char number = 2; number < 42; ++number) volumes.push_back(client().upload(kRaw, numbered(number)));
  stop();
  const fs::path catalog = data / "catalog.sqlite";
  // A page of the table of resources, which holds the documents.
  std::ifstream stream(catalog, std::ios::binary);
  const std::string bytes(std::istreambuf_iterator<char>(stream), {});
  const std::size_t at = bytes.find(volumes[20] + "volumes");
  ASSERT_NE(at, std::string::npos);
  damage(catalog, static_cast<std::streamoff>(at / 4096 * 4096), std::string(4096, '\x5a'));

  const Ended refused = run_spheruled({"--port", "0", "--data", data.string()});
  EXPECT_EQ(refused.status, 1);
  EXPECT_NE(refused.output.find("fsck --repair"), std::string::npos) << refused.output;
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 2);
  const Ended repaired = run_spheruled({"fsck", "--repair", "--data", data.string()});
  EXPECT_EQ(repaired.status, 2) << repaired.output;
  start();
  std::size_t there = 0;
  for (const std::string& id : volumes) there += client().get("/v1/volumes/" + id + "/content").status == 200;
  EXPECT_GE(there, volumes.size() / 2) << repaired.output;
  EXPECT_LT(there, volumes.size());
  for (char number = 1; number < 42; ++number) client().upload(kRaw, numbered(number));
  EXPECT_EQ(client().get("/v1/volumes?limit=100").json()["volumes"].size(), volumes.size());
  stop();
  EXPECT_EQ(run_spheruled({"fsck", "--data", data.string()}).status, 0);
}

TEST_F(Disk, ABackupIsMadeWhileServingAndBringsEverythingBack) {
  start();
  fill();
  const fs::path backup = folder.path() / "backup";
  const Ended made = run_spheruled({"backup", backup.string(), "--data", data.string()});
  EXPECT_EQ(made.status, 0) << made.output;
  client().upload(kRaw, numbered(2));  // not in the backup
  server->kill();
  fs::remove_all(data);

  EXPECT_EQ(run_spheruled({"fsck", "--data", backup.string()}).status, 0);
  const Ended restored = run_spheruled({"restore", backup.string(), "--data", data.string()});
  EXPECT_EQ(restored.status, 0) << restored.output;
  EXPECT_EQ(run_spheruled({"restore", backup.string(), "--data", data.string()}).status, 1) << "not over what is there";
  start();
  expect_all_there();
  EXPECT_EQ(client().get("/v1/volumes").json()["volumes"].size(), 1U);
}

}  // namespace
}  // namespace spherule::test
