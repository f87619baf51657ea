// SPDX-License-Identifier: GPL-3.0-or-later
//
// What jobs take against what they are admitted by: every kind of job on objects of several shapes, each in a server of
// its own, whose peak is compared with the job's estimate; and what several take at once. SPHERULE_FAULTS=full: all
// kinds and shapes, larger objects, and a table of the figures; else one job of each kind of estimate.
#include <gtest/gtest.h>

#include <cstdlib>
#include <cstring>
#include <filesystem>
#include <fstream>
#include <functional>
#include <iostream>
#include <memory>
#include <set>
#include <sstream>

#include "server/records/catalog.h"
#include "tests/e2e/client.h"
#include "tests/e2e/process.h"
#include "tests/long_form.h"
#include "tests/phantoms.h"

namespace spherule::test {
namespace {

namespace fs = std::filesystem;

constexpr double kMiB = 1 << 20;
// What a first job takes once in a process, whatever it works on: libraries' tables, stacks, arenas.
constexpr double kOnce = 24 * kMiB;
// An estimate is the peak of the worst object of its size, so others take less: most of all where it is that of balls
// side by side, or of blocks all through a box.
double most_of(const std::string& job) {
  if (job == "render blobs" || job == "file vdb") return 10;
  return job.starts_with("simplify") ? 5 : 4;
}

// The short form's.
bool is_usual(const std::string& job) {
  static const std::set<std::string> usual{"slice svg, object",
                                           "model",
                                           "measures",
                                           "render spheres",
                                           "render blobs",
                                           "export csv, all",
                                           "checks",
                                           "simplify sphericity",
                                           "registration",
                                           "register picture",
                                           "apply volume",
                                           "file vdb"};
  return usual.contains(job);
}

// Bytes of a line of /proc/PID/status.
double status_of(pid_t pid, const std::string& name) {
  std::ifstream status("/proc/" + std::to_string(pid) + "/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with(name + ":")) return std::strtod(line.c_str() + name.size() + 1, nullptr) * 1024;
  }
  return 0;
}

struct Request {
  std::string method, target, body;
};

/// A data folder with one object in it, and all that can be made of that.
class Object {
 public:
  std::string name, volume, model, few, registration;  // ids; empty where there is none

  explicit Object(std::string of) : name(std::move(of)) {
    fs::create_directory(folder_.path() / "disk");
    server_ = std::make_unique<ServerProcess>(data());
  }
  Client client() const { return Client(server_->port()); }

  void of_samples(const std::string& query, const std::string& bytes, Json rule) {
    volume = client().upload(query, bytes);
    rule["volume"] = volume;
    rule_ = rule;
    model = client().model(rule)["id"];
  }
  void of_spheres(const std::string& csv) {
    const Answer answer = client().post("/v1/models", {.body = csv, .type = "text/csv"});
    EXPECT_EQ(answer.status, 201) << answer.body;
    model = answer.json().value("id", "");
  }
  void simplify(const Json& method) { few = make({"POST", "/v1/models/" + model + "/simplifications", method.dump()}); }
  void register_with_itself() {
    registration = make({"POST", "/v1/registrations", Json{{"fixed", model}, {"moving", few}}.dump()});
  }
  void ready() { EXPECT_EQ(server_->terminate(), 0); }
  const Json& rule() const { return rule_; }

  /// Does it in a new server on a copy of the folder, and compares.
  void expect_as_estimated(const std::string& job, const Request& request) const;

 private:
  fs::path data() const { return folder_.path() / "disk" / "data"; }
  std::string make(const Request& request) const { return answer_of(client(), request).json().value("id", ""); }
  static Answer answer_of(const Client& client, const Request& request) {
    const Answer answer = client.ask(request.method, request.target,
                                     {.headers = {{"Prefer", "wait=60"}}, .body = request.body, .timeout_s = 300});
    EXPECT_TRUE(answer.status == 200 || answer.status == 201) << request.target << " " << answer.status << answer.body;
    return answer;
  }

  TemporaryFolder folder_;
  std::unique_ptr<ServerProcess> server_;
  Json rule_;
};

void Object::expect_as_estimated(const std::string& job, const Request& request) const {
  if (!long_form() && !is_usual(job)) return;
  const fs::path copy = folder_.path() / "disk" / "copy";
  fs::remove_all(copy);
  fs::copy(data(), copy, fs::copy_options::recursive);
  double peak = 0, rest = 0;
  {
    ServerProcess server(copy);
    const Client client(server.port());
    client.get("/readyz");
    std::ofstream("/proc/" + std::to_string(server.pid()) + "/clear_refs") << 5;
    rest = status_of(server.pid(), "VmRSS");
    answer_of(client, request);
    peak = status_of(server.pid(), "VmHWM") - rest;
    EXPECT_EQ(server.terminate(), 0);
  }
  const server::Catalog catalog(copy / "catalog.sqlite");
  const auto jobs = catalog.list_jobs("", 1).items;
  ASSERT_FALSE(jobs.empty());
  const auto estimate = static_cast<double>(jobs.front().memory_bytes);
  if (long_form()) {
    std::printf("%-14s %-24s %9.1f %9.1f %7.2f\n", name.c_str(), job.c_str(), peak / kMiB, estimate / kMiB,
                estimate / peak);
  }
  EXPECT_LE(peak, 1.1 * estimate + kOnce) << name << " " << job;
  EXPECT_LE(estimate, most_of(job) * peak + kOnce) << name << " " << job;
}

// Bytes of an n³ grid.
std::string samples(int n, const std::function<double(int, int, int)>& value) {
  std::string bytes;
  for (int k = 0; k < n; ++k) {
    for (int j = 0; j < n; ++j) {
      for (int i = 0; i < n; ++i) bytes += static_cast<char>(static_cast<unsigned char>(value(i, j, k)));
    }
  }
  return bytes;
}

std::string raw(int n, const std::string& type = "uint8") {
  const std::string size = std::to_string(n);
  return "?format=raw&dims=" + size + "," + size + "," + size + "&dtype=" + type;
}

std::string csv(std::size_t n, const std::function<std::array<double, 4>(std::size_t)>& ball) {
  std::ostringstream text;
  text << "x,y,z,r\n";
  for (std::size_t i = 0; i < n; ++i) {
    const auto [x, y, z, r] = ball(i);
    text << x << "," << y << "," << z << "," << r << "\n";
  }
  return text.str();
}

// Everything that models have.
void try_all_of_models(const Object& object, const std::string& id, bool raw_model) {
  const std::string path = "/v1/models/" + id;
  const auto get = [&](const std::string& job, const std::string& rest) {
    object.expect_as_estimated(job, {"GET", path + rest, ""});
  };
  get("measures", "/measures");
  get("contributions", "/spheres?columns=volume_mm3&limit=1");
  for (const char* style : {"spheres", "blobs", "centres"})
    get(std::string("render ") + style, std::string("/render?style=") + style);
  get("render by contribution", "/render?colour_by=contribution");
  get("render turn", "/render?turntable=12&width=300&height=300");
  for (const char* format : {"csv", "npy", "ply", "vtp"})
    get(std::string("export ") + format, std::string("/exports/") + format);
  get("export csv, all", "/exports/csv?columns=index,volume_mm3,area_mm2,share,rank,cumulative_share");
  if (raw_model) {
    get("checks", "/checks");
    for (const char* style : {"tetrahedra", "surface", "points"})
      get(std::string("render ") + style, std::string("/render?style=") + style);
  }
}

void try_all_files(const Object& object, const std::string& id, std::initializer_list<const char*> formats) {
  for (const char* format : formats)
    object.expect_as_estimated(std::string("file ") + format, {"GET", "/v1/models/" + id + "/exports/" + format, ""});
}

void try_all_of_volumes(const Object& object) {
  const std::string path = "/v1/volumes/" + object.volume;
  object.expect_as_estimated("slice", {"GET", path + "/slices/k/5", ""});
  object.expect_as_estimated("slice svg, object", {"GET", path + "/slices/k/5?format=svg&threshold=100", ""});
  object.expect_as_estimated("slice json, object", {"GET", path + "/slices/k/5?format=json&threshold=100", ""});
  Json rule = object.rule();
  rule["border"] = "open";
  object.expect_as_estimated("model", {"POST", "/v1/models", rule.dump()});
}

void try_methods(const Object& object, const std::set<std::string>& methods) {
  const std::string target = "/v1/models/" + object.model + "/simplifications";
  for (const auto& [method, k] :
       {std::pair{"median", 200}, {"average", 200}, {"best", 64}, {"prune", 0}, {"sphericity", 0}}) {
    if (!methods.contains(method)) continue;
    Json wish = {{"method", method}};
    if (k > 0) wish["k"] = k;
    if (wish["method"] == "prune") wish["buckets"] = {38, 39};
    object.expect_as_estimated(std::string("simplify ") + method, {"POST", target, wish.dump()});
  }
}

void try_all_methods(const Object& object) {
  try_methods(object, {"median", "average", "best", "prune", "sphericity"});
}

void try_all_of_registrations(const Object& object) {
  object.expect_as_estimated(
      "registration", {"POST", "/v1/registrations", Json{{"fixed", object.few}, {"moving", object.model}}.dump()});
  const std::string path = "/v1/registrations/" + object.registration;
  object.expect_as_estimated("register picture", {"GET", path + "/render?width=300&height=300", ""});
  for (const char* what : {"volume", "model"})
    object.expect_as_estimated(std::string("apply ") + what, {"GET", path + "/apply?what=" + what, ""});
}

void try_all_of_scans(const Object& object) {
  try_all_of_volumes(object);
  try_all_of_models(object, object.model, true);
  try_all_methods(object);
}

TEST(MemoryOfJobs, IsAsEstimatedForASmoothObject) {
  const int n = long_form() ? 160 : 96;
  Object object("smooth");
  object.of_samples(raw(n), ball(n, n / 2.2), {{"threshold", 100}});
  object.simplify({{"method", "median"}, {"k", 400}});
  object.register_with_itself();
  object.ready();
  try_all_of_scans(object);
  try_all_of_registrations(object);
  object.expect_as_estimated("tree", {"GET", "/v1/models/" + object.few + "/tree", ""});
  try_all_files(object, object.model, {"xyz", "nifti"});
  try_all_files(object, object.few,
                {"pqr", "urdf", "srdf", "xrdf", "curobo", "liggghts", "lammps", "yade", "glb", "vdb", "nifti"});
}

// The richest surface that a volume can have: a boundary point on every edge.
TEST(MemoryOfJobs, IsAsEstimatedForACheckerboard) {
  const int n = long_form() ? 56 : 32;
  Object object("checkerboard");
  object.of_samples(raw(n), samples(n, [](int i, int j, int k) { return (i + j + k) % 2 == 0 ? 200 : 10; }),
                    {{"threshold", 100}});
  object.ready();
  try_all_of_volumes(object);
  try_all_of_models(object, object.model, true);
  if (long_form()) try_methods(object, {"median", "average", "prune", "sphericity"});
}

// Many labels, of which one is meant.
TEST(MemoryOfJobs, IsAsEstimatedForALabelMap) {
  if (!long_form()) GTEST_SKIP() << "only of SPHERULE_FAULTS=full";
  const int n = 160;
  Object object("labels");
  object.of_samples(raw(n), samples(n, [](int i, int j, int k) { return (i / 20 + j / 20 + k / 20) % 7; }),
                    {{"labels", {3}}});
  object.ready();
  try_all_of_scans(object);
}

// What is small itself may stand before something large.
TEST(MemoryOfJobs, IsAsEstimatedForAFewSpheresOnALargeScan) {
  const int n = long_form() ? 300 : 160;
  Object object("large scan");
  std::string floats(static_cast<std::size_t>(n) * n * n * 4, '\0');
  for (int k = 0; k < 4; ++k) {
    for (int j = 0; j < 4; ++j) {
      for (int i = 0; i < 4; ++i) {
        const float inside = 200;
        std::memcpy(&floats[((static_cast<std::size_t>(k + 9) * n + j + 9) * n + i + 9) * 4], &inside, 4);
      }
    }
  }
  object.of_samples(raw(n, "float32"), floats, {{"threshold", 100}});
  object.simplify({{"method", "median"}, {"k", 4}});
  object.register_with_itself();
  object.ready();
  try_all_of_scans(object);
  try_all_of_registrations(object);
  try_all_files(object, object.few, {"urdf", "vdb", "nifti"});
}

TEST(MemoryOfJobs, IsAsEstimatedForSpheresInARow) {
  const std::size_t n = long_form() ? 40'000 : 10'000;
  Object object("row");
  object.of_spheres(csv(n, [](std::size_t i) { return std::array{static_cast<double>(i), 0., 0., 1.}; }));
  object.ready();
  try_all_of_models(object, object.model, false);
}

// Overlapping at random, as simplified models do not.
TEST(MemoryOfJobs, IsAsEstimatedForSpheresAtRandom) {
  const std::size_t n = long_form() ? 30'000 : 5'000;
  phantoms::Random random(3);
  Object object("random");
  object.of_spheres(csv(n, [&](std::size_t) {
    return std::array{40 * random.unit(), 40 * random.unit(), 40 * random.unit(), 0.5 + random.unit()};
  }));
  object.simplify({{"method", "median"}, {"k", 400}});
  object.ready();
  try_all_of_models(object, object.model, false);
  try_all_methods(object);
  try_all_files(object, object.model, {"xyz", "glb", "vdb"});
}

// The estimates of what runs at once never pass the budget, also those that become known on the way.
TEST(MemoryOfJobs, AtOnceIsThatOfTheBudget) {
  const int n = long_form() ? 52 : 32, budget_mib = long_form() ? 900 : 250;
  const TemporaryFolder folder;
  ServerProcess server(folder.path() / "data", {"--job-memory-bytes", std::to_string(budget_mib) + "M",
                                                "--jobs-at-once", "4", "--model-cache-bytes", "1M"});
  const Client client(server.port());
  std::vector<std::string> jobs;
  const auto all_done = [&] {
    for (const std::string& job : jobs) {
      client.get("/v1/jobs/" + job + "/events");  // ends with the job
      EXPECT_EQ(client.get("/v1/jobs/" + job).json()["state"], "succeeded") << job;
    }
    jobs.clear();
  };
  const double rest = status_of(server.pid(), "VmRSS");
  std::vector<std::string> volumes;
  for (int v = 0; v < 4; ++v) {
    volumes.push_back(
        client.upload(raw(n), samples(n, [&](int i, int j, int k) { return (i + j + k) % 2 == 0 ? 200 : 10 + v; })));
  }
  for (const std::string& volume : volumes) {
    const Answer made = client.post("/v1/models", {.headers = {{"Prefer", "respond-async"}},
                                                   .body = Json{{"volume", volume}, {"threshold", 100}}.dump()});
    ASSERT_EQ(made.status, 202) << made.body;
    jobs.push_back(made.json()["id"]);
  }
  all_done();
  const Json models = client.get("/v1/models").json();
  for (const Json& model : models["models"]) {
    const Answer asked = client.get("/v1/models/" + model["id"].get<std::string>() + "/measures",
                                    {.headers = {{"Prefer", "respond-async"}}});
    ASSERT_EQ(asked.status, 202) << asked.body;
    jobs.push_back(asked.json()["id"]);
  }
  EXPECT_EQ(jobs.size(), 4U);
  all_done();
  const double peak = status_of(server.pid(), "VmHWM") - rest;
  if (long_form())
    std::printf("%-14s %-24s %9.1f %9.1f\n", "four at once", "", peak / kMiB, static_cast<double>(budget_mib));
  EXPECT_LE(peak, 1.1 * budget_mib * kMiB + 2 * kOnce);
  EXPECT_EQ(server.terminate(), 0);
}

}  // namespace
}  // namespace spherule::test
