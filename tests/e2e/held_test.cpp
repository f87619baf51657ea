// SPDX-License-Identifier: GPL-3.0-or-later
//
// What callers have been given stays what they are given: ids and digests of volumes, models, simplifications,
// registrations and answers, held in held.txt. A change of the program that changes none of them is one that no caller
// sees. Where a result is meant to change, its edition changes with it, and the line here is replaced by what the
// failing test prints.
#include <gtest/gtest.h>

#include <cmath>
#include <cstring>
#include <fstream>
#include <sstream>

#include "server/base/digest.h"
#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

constexpr int kSide = 20;

// One sample for each (i, j, k), x fastest.
template <typename T, typename Sample>
std::string samples(Sample sample) {
  std::string bytes;
  for (int k = 0; k < kSide; ++k) {
    for (int j = 0; j < kSide; ++j) {
      for (int i = 0; i < kSide; ++i) {
        const T value = static_cast<T>(sample(i, j, k));
        char raw[sizeof value];
        std::memcpy(raw, &value, sizeof value);
        bytes.append(raw, sizeof value);
      }
    }
  }
  return bytes;
}

// An ellipsoid with a bump and whole-number samples: exact wherever it is computed.
int solid(int i, int j, int k) {
  const int x = 2 * i - 19, y = 2 * j - 17, z = 2 * k - 21;
  const int body = 250 - (x * x + 2 * y * y + 3 * z * z) / 3;
  const int bump = 250 - ((x - 12) * (x - 12) + y * y + (z - 4) * (z - 4));
  return std::max({0, body, bump});
}

// Three labels, two of them beyond what a double counts exactly.
std::int64_t organ(int i, int j, int k) {
  constexpr std::int64_t kFar = (std::int64_t{1} << 53) + 1;
  if (k < 3 || k > 16 || j < 3 || j > 16) return 0;
  return i < 7 ? 5 : i < 12 ? kFar : i < 17 ? kFar + 2 : 0;
}

std::string metaimage() {
  return "NDims = 3\nDimSize = 20 20 20\nElementType = MET_SHORT\nElementSpacing = 0.5 0.75 2\nOffset = 10 -20 30\n"
         "TransformMatrix = 0 1 0 -1 0 0 0 0 1\nElementDataFile = LOCAL\n" +
         samples<std::int16_t>([](int i, int j, int k) { return 10 * solid(i, j, k) - 1000; });
}
std::string nrrd() {
  return "NRRD0004\ntype: float\ndimension: 3\nsizes: 20 20 20\nspace: left-posterior-superior\nencoding: raw\n"
         "endian: little\nspace directions: (1,0,0) (0,1.5,0) (0,0,-1)\nspace origin: (0,0,0)\n\n" +
         samples<float>([](int i, int j, int k) { return solid(j, i, k) / 8.0; });
}

// What differs from run to run and is no part of a result.
void forget_times(Json& json) {
  for (const char* name : {"created", "expires", "timings_s", "seconds"}) {
    if (json.is_object()) json.erase(name);
  }
  for (Json& member : json) {
    if (member.is_structured()) forget_times(member);
  }
}

class Held {
 public:
  explicit Held(int port) : client_(port) {}

  std::string volume(const std::string& name, const std::string& query, const std::string& bytes) {
    const std::string id = client_.upload(query, bytes);
    note(name, id);
    answer(name + " document", "/v1/volumes/" + id);
    return id;
  }
  std::string made(const std::string& name, const std::string& target, const Json& request) {
    return made(name, client_.post(target, {.headers = {{"Prefer", "wait=60"}}, .body = request.dump()}));
  }
  std::string imported(const std::string& name, const std::string& csv) {
    return made(name,
                client_.post("/v1/models", {.headers = {{"Prefer", "wait=60"}}, .body = csv, .type = "text/csv"}));
  }
  void answer(const std::string& name, const std::string& target) {
    const Answer answer = client_.get(target, {.headers = {{"Prefer", "wait=60"}}});
    EXPECT_EQ(answer.status, 200) << target << answer.body.substr(0, 500);
    std::string body = answer.body;
    if (answer.header("Content-Type") == "application/json") {
      Json json = answer.json();
      forget_times(json);
      body = json.dump();
    }
    note(name, server::sha256_hex(body).substr(0, 32));
  }
  const std::string& text() const { return text_; }

 private:
  std::string made(const std::string& name, const Answer& answer) {
    EXPECT_EQ(answer.status, 201) << name << answer.body;
    Json json = answer.json();
    if (!json.contains("id")) return "";
    note(name, json["id"]);
    forget_times(json);
    note(name + " document", server::sha256_hex(json.dump()).substr(0, 32));
    return json["id"];
  }
  void note(const std::string& name, const std::string& value) { text_ += name + ": " + value + "\n"; }

  Client client_;
  std::string text_;
};

void hold_models(Held& held) {
  const std::string bytes = held.volume("volume of bytes", "?format=raw&dims=20,20,20&dtype=uint8&spacing=1,1,2",
                                        samples<std::uint8_t>(solid));
  const std::string scan = held.volume("volume in MetaImage", "", metaimage());
  const std::string field = held.volume("volume in NRRD", "", nrrd());
  const std::string labels =
      held.volume("volume of labels", "?format=raw&dims=20,20,20&dtype=int64", samples<std::int64_t>(organ));
  held.answer("histogram of a volume", "/v1/volumes/" + scan + "/histogram");
  held.answer("slice", "/v1/volumes/" + scan + "/slices/k/9?threshold=250.5&format=json");

  const std::string above = held.made("model above", "/v1/models", {{"volume", bytes}, {"threshold", 100}});
  held.made("model below", "/v1/models",
            {{"volume", scan}, {"threshold", 250.5}, {"inside", "below"}, {"border", "open"}});
  const std::string band = held.made("model of a range", "/v1/models", {{"volume", field}, {"range", {8.25, 20}}});
  held.made("model of labels", "/v1/models", {{"volume", labels}, {"labels", {5, "9007199254740993"}}});
  const std::string balls = held.imported("model of balls", "x,y,z,r\n0,0,0,10\n12,0,0,5\n12,9,1,3\n-40,2,0,0.5\n");

  const std::string model = "/v1/models/" + above;
  for (const char* part : {"/measures", "/checks", "/histogram", "/histogram?format=svg&scale=log", "/spheres?limit=50",
                           "/spheres?format=csv&columns=volume_mm3,area_mm2,rank&order=contribution"}) {
    held.answer(std::string("model above") + part, model + part);
  }
  for (const char* style : {"spheres", "blobs", "tetrahedra", "surface", "points", "centres"}) {
    held.answer(std::string("picture of ") + style, model + "/render?width=64&height=48&style=" + style);
  }
  for (const char* format : {"csv", "npy", "ply", "vtp", "urdf", "srdf", "xrdf", "curobo", "liggghts", "lammps", "yade",
                             "xyz", "pqr", "glb", "vdb", "nifti"}) {
    held.answer(std::string("balls as ") + format,
                "/v1/models/" + balls + "/exports/" + format + (format == std::string("nifti") ? "?voxel_mm=1" : ""));
  }
  held.answer("mask", "/v1/models/" + band + "/exports/nifti");
  held.answer("measures of balls", "/v1/models/" + balls + "/measures");

  std::string few;
  for (const char* request :
       {R"({"method": "sphericity", "threshold": 0.6, "limit": 20})", R"({"method": "median", "k": 8})",
        R"({"method": "average", "k": 8, "representative": "volume"})", R"({"method": "prune", "volume_share": 0.9})",
        R"({"method": "best", "k": 8})", R"({"method": "best", "k": 6, "mode": "outer"})"}) {
    few = held.made(std::string("simplification ") + request, model + "/simplifications", Json::parse(request));
  }
  held.answer("tree", "/v1/models/" + few + "/tree");
  held.answer("level", "/v1/models/" + few + "/spheres?level=2");

  for (const char* kind : {"rigid", "similarity"}) {
    const std::string registration = held.made(std::string("registration ") + kind, "/v1/registrations",
                                               {{"fixed", above}, {"moving", band}, {"transform", kind}});
    held.answer(std::string("picture of registration ") + kind,
                "/v1/registrations/" + registration + "/render?width=64&height=48");
    held.answer(std::string("applied ") + kind, "/v1/registrations/" + registration + "/apply?what=volume");
  }
}

std::string held_by_a_new_server() {
  const TemporaryFolder folder;
  const ServerProcess server(folder.path() / "data");
  Held held(server.port());
  hold_models(held);
  return held.text();
}

void expect_held(const std::string& text) {
  std::ifstream file(std::string(SPHERULE_SOURCES) + "/tests/e2e/held.txt");
  std::istringstream now(text);
  std::string was, is;
  while (std::getline(now, is)) {
    std::getline(file, was);
    EXPECT_EQ(is, was);
  }
  EXPECT_FALSE(std::getline(file, was)) << was;
  if (testing::Test::HasFailure()) std::cout << "What held.txt would be now:\n" << text;
}

TEST(Held, IdsAndDigestsAreWhatTheyWere) { expect_held(held_by_a_new_server()); }

// The C library takes other variants of its functions then.
TEST(Held, AlsoOnAProcessorWithoutFusedMultiplication) {
  ::setenv("GLIBC_TUNABLES", "glibc.cpu.hwcaps=-AVX,-AVX2,-AVX512F,-FMA,-FMA4", 1);
  const std::string text = held_by_a_new_server();
  ::unsetenv("GLIBC_TUNABLES");
  expect_held(text);
}

}  // namespace
}  // namespace spherule::test
