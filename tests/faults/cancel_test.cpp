// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every kind of work is started, and cancelled, or the server told to stop, at seeded moments. A stop must be heard
// within 100 ms. That is measured in the server's own processor time, which other programs do not lengthen: from the
// cancel to the end of the job, `threads` threads may use so much each, and a clock tick of the accounting.
#include <gtest/gtest.h>
#include <unistd.h>

#include <chrono>
#include <cmath>
#include <fstream>
#include <iterator>
#include <memory>
#include <random>
#include <sstream>
#include <thread>

#include "tests/e2e/client.h"
#include "tests/e2e/process.h"
#include "tests/long_form.h"

namespace spherule::test {
namespace {

constexpr int threads = 2;
constexpr double heard_s = 0.1, tick_s = 0.02;

// Seconds that a process has computed so far.
double computed(pid_t pid) {
  std::ostringstream text;
  text << std::ifstream("/proc/" + std::to_string(pid) + "/stat").rdbuf();
  // After the name in parentheses: the state, ten numbers, then utime and stime.
  std::istringstream fields(text.str().substr(text.str().rfind(')') + 1));
  std::string word;
  for (int i = 0; i < 11; ++i) fields >> word;
  double user = 0, system = 0;
  fields >> user >> system;
  return (user + system) / static_cast<double>(::sysconf(_SC_CLK_TCK));
}

// A gyroid about the middle of an n³ grid, moved by a part of its period: a rich and smooth surface.
std::string gyroid(int n, double shift) {
  std::string bytes;
  const double step = 2 * 3.14159265358979 / 11;
  for (int k = 0; k < n; ++k)
    for (int j = 0; j < n; ++j)
      for (int i = 0; i < n; ++i) {
        const double x = i * step + shift, y = j * step, z = k * step;
        const double value = std::sin(x) * std::cos(y) + std::sin(y) * std::cos(z) + std::sin(z) * std::cos(x);
        bytes += static_cast<char>(static_cast<unsigned char>(std::lround(127.5 + 80 * value)));
      }
  return bytes;
}

struct Work {
  std::string name, method, target, body{};
};

class Cancel : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new TemporaryFolder;
    start();
    const int n = long_form() ? 96 : 48;
    const std::string raw =
        "?format=raw&dtype=uint8&dims=" + std::to_string(n) + "," + std::to_string(n) + "," + std::to_string(n);
    volume = client().upload(raw, gyroid(n, 0));
    const std::string other = client().upload(raw, gyroid(n, 0.7));
    model = client().model({{"volume", volume}, {"threshold", 130.5}})["id"];
    moving = client().model({{"volume", other}, {"threshold", 130.5}})["id"];
    few = wait_for({"", "POST", "/v1/models/" + model + "/simplifications", R"({"method": "average", "k": 5000})"});
    registration = wait_for({"", "POST", "/v1/registrations", Json{{"fixed", model}, {"moving", moving}}.dump()});
  }
  static void TearDownTestSuite() {
    delete server;
    delete folder;
  }
  static void start() {
    server = new ServerProcess(folder->path() / "data",
                               {"--threads", std::to_string(threads), "--drain", "0", "--max-wait-s", "600"});
  }
  static Client client() { return Client(server->port()); }

  static Answer ask(const Work& work, const std::string& prefer) {
    return client().ask(work.method, work.target,
                        {.headers = {{"Prefer", prefer}}, .body = work.body, .timeout_s = 600});
  }
  // The path of what the work makes.
  static std::string wait_for(const Work& work) {
    const Answer answer = ask(work, "wait=600");
    EXPECT_LT(answer.status, 202) << answer.body;
    return answer.header("Location");
  }

  static std::vector<Work> everything() {
    std::vector<Work> all;
    const std::string at = "/v1/models/" + model, of = "/v1/volumes/" + volume;
    all.push_back({"model", "POST", "/v1/models", Json{{"volume", volume}, {"threshold", 120.5}}.dump()});
    all.push_back({"model of a range", "POST", "/v1/models", Json{{"volume", volume}, {"range", {110, 150}}}.dump()});
    for (const char* method :
         {R"({"method": "best", "k": 256})", R"({"method": "best", "mode": "inner", "k": 100})",
          R"({"method": "best", "mode": "outer", "k": 100})", R"({"method": "sphericity", "threshold": 0.8})",
          R"({"method": "median", "k": 20000})", R"({"method": "average", "k": 20000})",
          R"({"method": "prune", "volume_share": 0.5})", R"({"method": "prune", "least_radius_mm": 1})"}) {
      all.push_back({method, "POST", at + "/simplifications", method});
    }
    for (const char* transform : {"rigid", "similarity", "affine"}) {
      const Json wish{{"fixed", model}, {"moving", moving}, {"transform", transform}, {"k", 100}};
      all.push_back({std::string("registration ") + transform, "POST", "/v1/registrations", wish.dump()});
    }
    all.push_back({"before and after", "GET", registration + "/render?width=600&height=600"});
    all.push_back({"apply to the model", "GET", registration + "/apply?what=model"});
    all.push_back({"apply to the volume", "GET", registration + "/apply?what=volume"});
    for (const char* what : {"/measures", "/checks", "/spheres?order=contribution"})
      all.push_back({what, "GET", at + what});
    for (const char* style : {"spheres", "blobs", "tetrahedra", "surface", "points", "centres"}) {
      all.push_back({style, "GET", at + "/render?width=600&height=600&style=" + style});
    }
    all.push_back({"turntable", "GET", at + "/render?width=400&height=400&turntable=10"});
    for (const char* table : {"csv", "npy", "ply", "vtp"}) all.push_back({table, "GET", at + "/exports/" + table});
    all.push_back({"listed csv", "GET", at + "/exports/csv?columns=share,rank&order=contribution"});
    for (const char* file : {"xyz", "vdb", "nifti"}) {
      all.push_back({file, "GET", at + "/exports/" + file});
    }
    // These have fewer spheres than the model.
    for (const char* file : {"urdf", "srdf", "xrdf", "curobo", "liggghts", "lammps", "yade", "pqr", "glb?style=mesh"}) {
      all.push_back({file, "GET", few + "/exports/" + file});
    }
    all.push_back({"tree", "GET", few + "/tree?levels=1,64,4096"});
    all.push_back({"histogram", "GET", of + "/histogram?buckets=1000"});
    all.push_back({"slice", "GET", of + "/slices/k/20?threshold=127&show=contour,triangles,circles"});
    all.push_back({"slice as numbers", "GET", of + "/slices/j/20?threshold=127&format=json"});
    return all;
  }

  // Waits until the job has come so far, is over, or has run for as long as a moment may take to come: stages that do
  // not know how far they are go on for minutes.
  static Json await(const std::string& job, double progress) {
    const Client one = client();
    for (;; std::this_thread::sleep_for(std::chrono::milliseconds(2))) {
      Json now = one.get(job).json();
      const std::string state = now["state"];
      if (state == "queued") continue;
      if (state != "running" || now["progress"] >= progress || now["elapsed_s"] > 20) return now;
    }
  }

  static TemporaryFolder* folder;
  static ServerProcess* server;
  static std::string volume, model, moving, few, registration;
};
TemporaryFolder* Cancel::folder = nullptr;
ServerProcess* Cancel::server = nullptr;
std::string Cancel::volume, Cancel::model, Cancel::moving, Cancel::few, Cancel::registration;

TEST_F(Cancel, IsHeardByEveryKindOfWork) {
  std::mt19937 random(14);
  int measured = 0;
  for (const Work& work : everything()) {
    double slowest = 0;
    std::string where;
    for (int moment = 0; moment < (long_form() ? 8 : 1); ++moment) {
      const double progress = static_cast<double>(random() % (long_form() ? 1000 : 300)) / 1000;
      const Answer asked = ask(work, "respond-async");
      if (asked.status != 202) {
        EXPECT_LT(asked.status, 300) << work.name << asked.body;
        break;  // made at a moment that came too late
      }
      const std::string job = asked.header("Location");
      const Json now = await(job, progress);
      const double before = computed(server->pid());
      if (client().post(job + "/cancel").status != 202) continue;
      client().get(job + "/events");
      const double spent = computed(server->pid()) - before;
      ++measured;
      if (spent <= slowest) continue;
      slowest = spent;
      where = now["stage"];
    }
    EXPECT_LE(slowest, threads * heard_s + tick_s) << work.name << " at " << where;
    if (!long_form()) continue;
    std::printf("%-45s %.2f s  %s\n", work.name.c_str(), slowest, where.c_str());
    std::fflush(stdout);
  }
  EXPECT_GT(measured, 10) << "the phantom is too light for this machine";
}

TEST_F(Cancel, SoIsAStopOfTheServer) {
  std::mt19937 random(41);
  const std::vector<Work> all = everything();
  for (std::size_t i = 0; i < all.size(); ++i) {
    if (!long_form() && i % 12 != 0) continue;
    const Answer asked = ask(all[i], "respond-async");
    if (asked.status == 202) await(asked.header("Location"), static_cast<double>(random() % 300) / 1000);
    EXPECT_EQ(server->terminate(), 0) << all[i].name;
    EXPECT_EQ(server->log().find("did not stop"), std::string::npos) << all[i].name;
    delete std::exchange(server, nullptr);
    start();
    // It runs again, as if nothing had been; and is not blamed.
    if (asked.status != 202) continue;
    const std::string state = client().get(asked.header("Location")).json()["state"];
    EXPECT_NE(state, "failed") << all[i].name;
    if (state == "queued" || state == "running") client().post(asked.header("Location") + "/cancel");
    client().get(asked.header("Location") + "/events");
  }
}

}  // namespace
}  // namespace spherule::test
