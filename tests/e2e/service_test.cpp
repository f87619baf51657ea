// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every operation of the contract against a real server.
#include <gtest/gtest.h>

#include <numbers>
#include <thread>

#include "tests/contract/contract.h"
#include "tests/e2e/client.h"
#include "tests/e2e/process.h"

namespace spherule::test {
namespace {

const std::string kRaw = "?format=raw&dims=24,24,24&dtype=uint8";

class Service : public testing::Test {
 protected:
  static void SetUpTestSuite() {
    folder = new TemporaryFolder;
    server = new ServerProcess(folder->path() / "data",
                               {"--max-body-bytes", "8M", "--max-streams", "3", "--max-spheres", "100000"});
  }
  static void TearDownTestSuite() {
    delete server;
    delete folder;
  }
  // The one that most tests look at.
  static std::string volume() { return client().upload(kRaw, ball(24, 11.5)); }
  static std::string model() { return client().model({{"volume", volume()}, {"threshold", 120}})["id"]; }
  static Client client() { return Client(server->port()); }

  static TemporaryFolder* folder;
  static ServerProcess* server;
};
TemporaryFolder* Service::folder = nullptr;
ServerProcess* Service::server = nullptr;

TEST_F(Service, StoresVolumesOnce) {
  const std::string bytes = ball(20, 9);
  const std::string query = "?format=raw&dims=20,20,20&dtype=uint8&spacing=1,1,2&origin=1,2,3";
  const Answer first = client().post("/v1/volumes" + query, {.body = bytes, .type = "image/x-anything"});
  EXPECT_EQ(first.status, 201);
  const Json json = first.json();
  EXPECT_EQ(first.header("Location"), "/v1/volumes/" + json["id"].get<std::string>());
  EXPECT_EQ(json["dims"], Json({20, 20, 20}));
  EXPECT_EQ(json["spacing_mm"], Json({1, 1, 2}));
  EXPECT_EQ(json["origin_mm"], Json({1, 2, 3}));
  EXPECT_EQ(json["bytes"], 8000);
  EXPECT_EQ(json["already_stored"], false);
  const Answer second = client().post("/v1/volumes" + query, {.body = bytes});
  EXPECT_EQ(second.status, 200);
  EXPECT_EQ(second.json()["id"], json["id"]);
  EXPECT_NE(Json(client().upload("?format=raw&dims=20,20,20&dtype=uint8", bytes)), json["id"])
      << "geometry is identity";
}

TEST_F(Service, ReadsAFormatByItsBytes) {
  const Answer answer = client().post("/v1/volumes", {.body = ball_nifti(16, 7, 1.5F), .type = "text/plain"});
  ASSERT_EQ(answer.status, 201) << answer.body;
  EXPECT_EQ(answer.json()["format"], "nifti");
  EXPECT_EQ(answer.json()["spacing_mm"], Json({1.5, 1.5, 1.5}));
  EXPECT_EQ(answer.json()["direction"], Json({{-1, 0, 0}, {0, -1, 0}, {0, 0, 1}})) << "NIfTI is RAS";
}

TEST_F(Service, TakesAHeaderAndItsDataAsAForm) {
  const std::string header =
      "ObjectType = Image\nNDims = 3\nBinaryData = True\nBinaryDataByteOrderMSB = False\nDimSize = 24 24 24\n"
      "ElementSpacing = 2 2 2\nElementType = MET_UCHAR\nElementDataFile = Doe_Jane.raw\n";
  const auto form = [](const std::vector<std::pair<std::string, std::string>>& files) {
    std::string body;
    for (const auto& [name, bytes] : files) {
      body +=
          "--XyZ\r\nContent-Disposition: form-data; name=\"file\"; filename=\"" + name + "\"\r\n\r\n" + bytes + "\r\n";
    }
    return Ask{.body = body + "--XyZ--\r\n", .type = "multipart/form-data; boundary=\"XyZ\"; charset=utf-8"};
  };
  const Answer answer =
      client().post("/v1/volumes", form({{"C:\\scans\\Doe_Jane.mhd", header}, {"Doe_Jane.raw", ball(24, 11.5)}}));
  ASSERT_EQ(answer.status, 201) << answer.body;
  EXPECT_EQ(answer.json()["format"], "metaimage");
  EXPECT_EQ(answer.json()["files"].size(), 2U);
  EXPECT_EQ(answer.body.find("Doe"), std::string::npos);
  const std::string id = answer.json()["id"];
  EXPECT_EQ(client().get("/v1/volumes/" + id + "/content?file=0").body, header);
  EXPECT_EQ(client().get("/v1/volumes/" + id + "/content?file=1").body, ball(24, 11.5));
  EXPECT_EQ(client().get("/v1/volumes/" + id + "/content?file=2").status, 404);
  EXPECT_GT(client().model({{"volume", id}, {"threshold", 120}})["counts"]["spheres"], 0);

  EXPECT_EQ(client().post("/v1/volumes", form({{"a", "1"}, {"a", "2"}})).status, 400) << "names that repeat";
  EXPECT_EQ(client().post("/v1/volumes", form({{"Doe_Jane.mhd", header}})).status, 400) << "the data is missing";
  EXPECT_EQ(client().post("/v1/volumes", form({})).status, 400);
  Ask cut = form({{"Doe_Jane.mhd", header}});
  cut.body.resize(cut.body.size() - 10);
  EXPECT_EQ(client().post("/v1/volumes", cut).status, 400);
  cut.type = "multipart/form-data";
  EXPECT_EQ(client().post("/v1/volumes", cut).status, 400);
  EXPECT_EQ(server->log().find("Doe"), std::string::npos) << "names of files are not logged";
}

TEST_F(Service, RefusesWhatIsNoVolume) {
  const auto status = [](const std::string& query, const std::string& bytes) {
    return client().post("/v1/volumes" + query, {.body = bytes}).status;
  };
  EXPECT_EQ(status("", ""), 400);
  EXPECT_EQ(status("", "this is a letter, not a scan"), 415);
  EXPECT_EQ(status(kRaw, ball(20, 9)), 400) << "fewer bytes than the sizes say";
  EXPECT_EQ(status("", ball_nifti(16, 7, 1).substr(0, 1000)), 400);
  EXPECT_EQ(status("", ball_nifti(16, 7, 0)), 422) << "no spacing";
  EXPECT_EQ(status("?format=raw&dims=2000,2000,2000&dtype=float64", "x"), 413) << "over the limit of samples";
  EXPECT_EQ(status("?format=raw", "x"), 400);
}

TEST_F(Service, ShowsVolumes) {
  const std::string path = "/v1/volumes/" + volume();
  const Answer shown = client().get(path);
  EXPECT_EQ(shown.status, 200);
  EXPECT_EQ(client().get(path, {.headers = {{"If-None-Match", shown.header("ETag")}}}).status, 304);
  const Answer head = client().ask("HEAD", path);
  EXPECT_EQ(head.status, 200);
  EXPECT_EQ(head.header("Content-Length"), std::to_string(shown.body.size()));
  const Answer histogram = client().get(path + "/histogram?buckets=16");
  const std::vector<std::uint64_t> counts = histogram.json()["counts"];
  EXPECT_EQ(counts.size(), 16U);
  EXPECT_EQ(std::accumulate(counts.begin(), counts.end(), std::uint64_t{0}), 24U * 24 * 24);
  EXPECT_EQ(client().get(path + "/histogram?buckets=0").status, 400);
  EXPECT_EQ(client().get("/v1/volumes/vol_" + std::string(32, '0')).status, 404);
  EXPECT_EQ(client().get("/v1/volumes/' OR 1=1 --").status, 404);
}

TEST_F(Service, GivesBackTheBytes) {
  const std::string path = "/v1/volumes/" + volume() + "/content";
  const std::string bytes = ball(24, 11.5);
  const Answer whole = client().get(path);
  EXPECT_EQ(whole.body, bytes);
  EXPECT_EQ(whole.header("Content-Type"), "application/octet-stream");
  const Answer part = client().get(path, {.headers = {{"Range", "bytes=100-199"}}});
  EXPECT_EQ(part.status, 206);
  EXPECT_EQ(part.body, bytes.substr(100, 100));
  EXPECT_EQ(part.header("Content-Range"), "bytes 100-199/13824");
  EXPECT_EQ(client().get(path, {.headers = {{"Range", "bytes=-7"}}}).body, bytes.substr(13824 - 7));
  EXPECT_EQ(client().get(path, {.headers = {{"Range", "bytes=20000-"}}}).status, 416);
  EXPECT_EQ(client().get(path, {.headers = {{"Range", "bytes=5-1"}}}).status, 200) << "no range (RFC 9110, 14.1.1)";
  EXPECT_EQ(client().get(path, {.headers = {{"If-None-Match", whole.header("ETag")}}}).status, 304);
  EXPECT_EQ(client().ask("HEAD", path).header("Content-Length"), "13824");
}

TEST_F(Service, ListsInPages) {
  for (int i = 0; i < 3; ++i) client().upload("?format=raw&dims=2,2,2&dtype=uint8", "seven!!" + std::to_string(i));
  std::set<std::string> ids;
  std::string target = "/v1/volumes?limit=2";
  for (int pages = 0; !target.empty() && pages < 100; ++pages) {
    const Answer page = client().get(target);
    ASSERT_EQ(page.status, 200);
    EXPECT_LE(page.json()["volumes"].size(), 2U);
    const Json list = page.json();
    for (const Json& item : list["volumes"]) EXPECT_TRUE(ids.insert(item["id"]).second) << "seen twice";
    const std::string link = page.header("Link");
    EXPECT_EQ(link.empty(), page.json()["next_cursor"].is_null());
    target = link.empty() ? "" : link.substr(1, link.find('>') - 1);
  }
  EXPECT_GE(ids.size(), 3U);
  EXPECT_EQ(client().get("/v1/volumes?cursor=nonsense").status, 400);
}

TEST_F(Service, MakesTheModelOfABall) {
  const Answer created = client().post(
      "/v1/models", {.headers = {{"Prefer", "wait=60"}},
                     .body = Json{{"volume", client().upload("?format=raw&dims=40,40,40&dtype=uint8", ball(40, 19))},
                                  {"threshold", 100.5}}
                                 .dump(),
                     .type = "application/json"});
  ASSERT_EQ(created.status, 201) << created.body;
  EXPECT_EQ(created.header("Preference-Applied"), "wait=60");
  const Json model = created.json();
  const std::string path = "/v1/models/" + model["id"].get<std::string>();
  EXPECT_EQ(created.header("Location"), path);
  EXPECT_EQ(model["parameters"], Json({{"threshold", 100.5}, {"inside", "above"}, {"border", "closed"}}));
  EXPECT_EQ(model["counts"]["spheres"], model["counts"]["inside_tetrahedra"]);
  EXPECT_GT(model["counts"]["tetrahedra"], model["counts"]["inside_tetrahedra"]);
  EXPECT_EQ(client().get(path).json()["counts"], model["counts"]);

  // 255·(1 − r/19) = 100.5
  const double radius = 19 * (1 - 100.5 / 255);
  const double exact = 4.0 / 3 * std::numbers::pi * radius * radius * radius;
  const Answer measured = client().get(path + "/measures");
  ASSERT_EQ(measured.status, 200);
  const Json measures = measured.json();
  EXPECT_NEAR(measures["tetrahedra"]["volume_mm3"], exact, 0.02 * exact);
  EXPECT_NEAR(measures["tetrahedra"]["area_mm2"], 4 * std::numbers::pi * radius * radius, 0.05 * exact);
  EXPECT_NEAR(measures["voxels"]["volume_mm3"], exact, 0.02 * exact);
  EXPECT_EQ(measures["tetrahedra"]["betti"], Json({1, 0, 0}));
  EXPECT_NEAR(model["bounds_mm"]["max"][0], 19.5 + radius, 0.1);
  EXPECT_NEAR(measures["spheres"]["radius_max_mm"], radius, 0.2);
  for (const char* of : {"spheres", "marching_cubes"}) {
    EXPECT_NEAR(measures[of]["volume_mm3"], exact, 0.02 * exact) << of;
    EXPECT_EQ(measures[of]["euler_characteristic"], 1) << of;
  }
  EXPECT_LT(measures["tetrahedra"]["volume_mm3"], measures["spheres"]["volume_mm3"]);
  EXPECT_GT(measures["observations"]["excess_volume"]["slack_mm3"], 0);
  EXPECT_NEAR(measures["smallest_enclosing_sphere"]["radius_mm"], radius, 0.6) << "spheres bulge out a little";
  EXPECT_NEAR(measures["local_thickness"]["mean_mm"], 2 * radius, 0.5);
  EXPECT_EQ(measures["components"]["items"].size(), 1U);
  EXPECT_NEAR(measures["spheres"]["centroid_mm"][0], 19.5, 1e-3);

  const Json checks = client().get(path + "/checks").json();
  EXPECT_EQ(checks["violations"], 0);
  EXPECT_EQ(checks["bounds"]["density_holds"], true);

  const Json histogram = client().get(path + "/histogram").json();
  EXPECT_EQ(histogram["counts"].size(), 40U);
  EXPECT_EQ(std::accumulate(histogram["counts"].begin(), histogram["counts"].end(), 0ULL,
                            [](std::uint64_t sum, const Json& n) { return sum + n.get<std::uint64_t>(); }),
            model["counts"]["spheres"]);
  const std::string wish =
      Json{{"volume", model["source"]["volume"]}, {"threshold", 100.5}, {"inside", "above"}}.dump();
  const Answer again = client().post("/v1/models", {.body = wish, .type = "application/json"});
  EXPECT_EQ(again.status, 200);
  EXPECT_EQ(again.json()["id"], model["id"]) << "defaults are part of the identity";
}

TEST_F(Service, MakesModelsOfRangesAndLabelsAndTheOutside) {
  const std::string id = volume();
  const Json shell = client().model({{"volume", id}, {"range", {60.5, 160.5}}});
  const Json measures = client().get("/v1/models/" + shell["id"].get<std::string>() + "/measures").json();
  EXPECT_EQ(measures["tetrahedra"]["betti"], Json({1, 0, 1})) << "a shell has a void";
  const Json below = client().model({{"volume", id}, {"threshold", 120}, {"inside", "below"}});
  EXPECT_EQ(client().get("/v1/models/" + below["id"].get<std::string>() + "/measures").json()["tetrahedra"]["betti"],
            Json({1, 0, 1}));
  std::string labels(8 * 8 * 8, '\0');
  labels[3 * 64 + 3 * 8 + 3] = 5;
  labels[3 * 64 + 3 * 8 + 4] = 7;
  const std::string map = client().upload("?format=raw&dims=8,8,8&dtype=uint8", labels);
  const Json model = client().model({{"volume", map}, {"labels", {7, 5, 5}}});
  EXPECT_EQ(model["parameters"]["labels"], Json({5, 7}));
  EXPECT_GT(model["counts"]["spheres"], 0);
}

TEST_F(Service, RefusesModelsThatCannotBe) {
  const auto status = [](const Json& wish) {
    return client()
        .post("/v1/models", {.headers = {{"Prefer", "wait=60"}}, .body = wish.dump(), .type = "application/json"})
        .status;
  };
  EXPECT_EQ(status({{"volume", "vol_" + std::string(32, '0')}, {"threshold", 1}}), 404);
  EXPECT_EQ(status({{"volume", volume()}, {"threshold", 1000}}), 422) << "nothing is inside";
  EXPECT_EQ(status({{"volume", volume()}, {"threshold", 1}, {"colour", "red"}}), 400);
  EXPECT_EQ(client().post("/v1/models", {.body = "{", .type = "application/json"}).status, 400);
  EXPECT_EQ(client().post("/v1/models", {.body = "x", .type = "image/png"}).status, 415);
  EXPECT_EQ(client().post("/v1/models").status, 400);
}

TEST_F(Service, ServesSpheresInEveryFormat) {
  const std::string id = model();
  const std::string path = "/v1/models/" + id;
  const std::size_t count = client().get(path).json()["counts"]["spheres"];
  const Json page = client().get(path + "/spheres?offset=5&limit=3").json();
  EXPECT_EQ(page["total"], count);
  ASSERT_EQ(page["spheres"].size(), 3U);
  EXPECT_NE(client().get(path + "/spheres?limit=3").header("Link").find("offset=3&limit=3"), std::string::npos);

  const Answer csv = client().get(path + "/spheres", {.headers = {{"Accept", "text/csv"}}});
  EXPECT_EQ(csv.header("Content-Type"), "text/csv");
  EXPECT_NE(csv.body.find("LPS"), std::string::npos);
  EXPECT_NE(csv.body.find("mm"), std::string::npos);
  const std::string row = "\n" + page["spheres"][0][0].dump();
  EXPECT_EQ(client().get(path + "/exports/csv").body, csv.body);
  EXPECT_EQ(static_cast<std::size_t>(std::ranges::count(csv.body, '\n')) - 4, count);

  const Answer npy = client().get(path + "/spheres?format=npy");
  EXPECT_EQ(npy.header("Spherule-Frame"), "LPS");
  EXPECT_EQ(npy.body.substr(1, 5), "NUMPY");
  ASSERT_EQ(npy.body.size() % 64, (32 * count) % 64);
  double x = 0;
  std::memcpy(&x, npy.body.data() + npy.body.size() - 32 * count + 32 * 5, 8);
  EXPECT_EQ(x, page["spheres"][0][0].get<double>());
  EXPECT_EQ(client().get(path + "/exports/ply").body.substr(0, 4), "ply\n");
  EXPECT_NE(client().get(path + "/exports/vtp").body.find("PolyData"), std::string::npos);
  EXPECT_EQ(client().get(path + "/exports/stl").status, 404);
  EXPECT_EQ(client().get(path + "/spheres", {.headers = {{"Accept", "image/png"}}}).status, 406);
  EXPECT_EQ(client().get(path + "/exports/npy", {.headers = {{"Range", "bytes=1-5"}}}).body, "NUMPY");
}

TEST_F(Service, WritesFilesForOtherPrograms) {
  // Two balls that share half a diameter: the lens between counts once.
  const Answer created = client().post("/v1/models", {.body = "x,y,z,r\n0,0,0,10\n10,0,0,10\n", .type = "text/csv"});
  const std::string path = "/v1/models/" + created.json()["id"].get<std::string>() + "/exports/";
  const double exact = 2 * 4 * std::numbers::pi / 3 * 1000 - 5 * std::numbers::pi / 12 * 1000;
  const Answer urdf = client().get(path + "urdf?density=2000&origin=centre");
  ASSERT_EQ(urdf.status, 200) << urdf.body;
  EXPECT_EQ(urdf.header("Spherule-Unit"), "m");
  const std::size_t at = urdf.body.find("<mass value=\"");
  ASSERT_NE(at, std::string::npos);
  EXPECT_NEAR(std::stod(urdf.body.substr(at + 13)), 2000 * exact * 1e-9, 1e-12);
  EXPECT_NE(urdf.body.find("xyz=\"-0.005 "), std::string::npos) << "from the centre";
  for (const char* format : {"srdf", "xrdf", "curobo", "liggghts", "lammps", "yade", "xyz", "pqr", "glb", "vdb"}) {
    const Answer file = client().get(path + format);
    EXPECT_EQ(file.status, 200) << format << file.body;
    EXPECT_FALSE(file.body.empty());
  }
  EXPECT_EQ(client().get(path + "nifti").status, 422) << "no scan, no grid";
  const std::string mask = client().get(path + "nifti?voxel_mm=1").body;
  const Json read = client().get("/v1/volumes/" + client().upload("", mask)).json();
  EXPECT_EQ(read["dtype"], "uint8") << "what we write, we read";
  EXPECT_EQ(read["spacing_mm"], Json({1.0, 1.0, 1.0}));

  // A scan's mask is on its grid, and of its raw model the object itself.
  const Json scan = client().get("/v1/volumes/" + volume()).json();
  const std::string own = client().get("/v1/models/" + model() + "/exports/nifti").body;
  const Json back = client().get("/v1/volumes/" + client().upload("", own)).json();
  EXPECT_EQ(back["dims"], scan["dims"]);
  EXPECT_EQ(back["origin_mm"], scan["origin_mm"]);
  const Json mask_model = client().model({{"volume", back["id"]}, {"threshold", 0.5}});
  const auto voxels = [](const std::string& id) {
    return client().get("/v1/models/" + id + "/measures").json()["voxels"];
  };
  EXPECT_TRUE(voxels(model()).is_object());
  EXPECT_EQ(voxels(mask_model["id"]), voxels(model()));
}

TEST_F(Service, RanksSpheresByWhatTheyContribute) {
  const Answer created = client().post(
      "/v1/models", {.body = "x,y,z,r\n0,0,0,1\n10,0,0,2\n10,0,0,0.5\n20,0,0,1\n21,0,0,1\n", .type = "text/csv"});
  ASSERT_EQ(created.status, 201) << created.body;
  const std::string path = "/v1/models/" + created.json()["id"].get<std::string>();
  const std::string columns = "columns=index,volume_mm3,area_mm2,share,rank,cumulative_share";
  const Json page = client().get(path + "/spheres?" + columns + "&order=contribution").json();
  ASSERT_EQ(page["spheres"].size(), 5U);
  std::vector<int> order;
  double volume = 0, before = HUGE_VAL;
  for (const Json& row : page["spheres"]) {
    order.push_back(row[4]);
    EXPECT_LE(row[5], before);
    before = row[5];
    volume += row[5].get<double>();
    EXPECT_EQ(row[8], order.size()) << "rank";
  }
  EXPECT_EQ(order, (std::vector{1, 0, 3, 4, 2}));
  // 8 and 1 balls of radius 1, two that overlap by a lens of 5π/12, and one hidden.
  const double ball = 4 * std::numbers::pi / 3;
  EXPECT_NEAR(volume, 11 * ball - 5 * std::numbers::pi / 12, 1e-11);
  EXPECT_NEAR(page["spheres"][0][5], 8 * ball, 1e-12);
  EXPECT_NEAR(page["spheres"][1][6], 4 * std::numbers::pi, 1e-12);
  EXPECT_NEAR(page["spheres"][0][7], 8 * ball / volume, 1e-12);
  EXPECT_EQ(page["spheres"][4][5], 0);
  EXPECT_EQ(page["spheres"][4][9], 1);
  const Json measures = client().get(path + "/measures").json();
  EXPECT_NEAR(measures["spheres"]["volume_mm3"], volume, 1e-11);
  EXPECT_EQ(measures["components"]["count"], 3);
  EXPECT_EQ(measures["spheres"]["betti"], Json({3, 0, 0}));
  EXPECT_EQ(client().get(path + "/measures?components=1").json()["components"]["items"].size(), 1U);

  const Json plain = client().get(path + "/spheres?columns=rank&limit=2").json();
  EXPECT_EQ(plain["spheres"][0], Json({0, 0, 0, 1, 2}));
  const std::string npy = client().get(path + "/spheres?format=npy&columns=volume_mm3,share").body;
  EXPECT_NE(npy.find("(5, 6)"), std::string::npos);
  EXPECT_NE(client().get(path + "/spheres?format=npy").body.find("(5, 4)"), std::string::npos);
  EXPECT_NE(
      client().get(path + "/exports/csv?columns=share&order=contribution").body.find("\nx,y,z,r,share\n10,0,0,2,"),
      std::string::npos);
  EXPECT_NE(client().get(path + "/exports/vtp?columns=area_mm2").body.find("Name=\"area_mm2\""), std::string::npos);
  EXPECT_NE(client().get(path + "/exports/ply?columns=rank").body.find("property double rank\n"), std::string::npos);
  EXPECT_EQ(client().get(path + "/histogram?scale=log&buckets=3").json()["counts"], Json({1, 3, 1}));
}

TEST_F(Service, RendersPictures) {
  const std::string path = "/v1/models/" + model() + "/render";
  const Answer picture = client().get(path + "?view=h&width=64&height=48");
  EXPECT_EQ(picture.status, 200);
  EXPECT_EQ(picture.header("Content-Type"), "image/png");
  ASSERT_GT(picture.body.size(), 33U);
  EXPECT_EQ(picture.body.substr(0, 8), "\x89PNG\r\n\x1a\n");
  EXPECT_EQ(picture.body.substr(16, 8), std::string("\0\0\0\x40\0\0\0\x30", 8)) << "64 x 48";
  EXPECT_EQ(client()
                .get(path + "?view=h&width=64&height=48", {.headers = {{"If-None-Match", picture.header("ETag")}}})
                .status,
            304);
  EXPECT_EQ(client().get(path, {.headers = {{"Accept", "image/jpeg"}}}).status, 406);
  EXPECT_EQ(client().get(path + "?view=x").status, 400);
  EXPECT_EQ(client().get(path + "?width=8192&height=8192").status, 413);
}

TEST_F(Service, RefusesPicturesThatCannotBe) {
  const std::string path = "/v1/models/" + model() + "/render";
  const auto problem = [](const Answer& answer) {
    EXPECT_EQ(answer.header("Content-Type"), "application/problem+json");
    EXPECT_EQ(answer.json()["detail"].get<std::string>().back(), '.');
    return answer.status;
  };
  for (const char* query :
       {"?width=0", "?height=-5", "?width=8193", "?height=99999999999", "?colour_by=radius&colour_map=rainbow",
        "?position=11.5,11.5,11.5&look_at=11.5,11.5,90&projection=perspective",  // inside the ball
        "?position=5,5,90&look_at=5,5,90", "?position=5,5,90&look_at=5,5,0&up=0,0,1",
        "?position=0,-100,0&look_at=0,-200,0&projection=perspective"})
    EXPECT_EQ(problem(client().get(path + query)), 400) << query;
  const Answer empty = client().post("/v1/models", {.body = "x,y,z,r\n0,0,0,0\n", .type = "text/csv"});
  ASSERT_EQ(empty.status, 201) << empty.body;
  EXPECT_EQ(problem(client().get(empty.header("Location") + "/render")), 422) << "nothing to draw";
  const Answer one = client().post("/v1/models", {.body = "x,y,z,r\n0,0,0,1\n", .type = "text/csv"});
  for (const char* style : {"tetrahedra", "points", "surface"})
    EXPECT_EQ(problem(client().get(one.header("Location") + "/render?style=" + style)), 422) << style;
}

TEST_F(Service, DrawsSlicesAndTellsThemAsNumbers) {
  const std::string path = "/v1/volumes/" + volume() + "/slices/k/12";
  const std::string object = "?threshold=30&width=200&height=200&show=inside,circles";
  const Answer picture = client().get(path + object);
  EXPECT_EQ(picture.status, 200);
  EXPECT_EQ(picture.body.substr(0, 8), "\x89PNG\r\n\x1a\n");
  EXPECT_EQ(client().get(path + object).body, picture.body);
  EXPECT_NE(client().get(path + "?width=200&height=200").body, picture.body);
  const Answer drawing = client().get(path + object, {.headers = {{"Accept", "image/svg+xml"}}});
  EXPECT_EQ(drawing.header("Content-Type"), "image/svg+xml");
  EXPECT_NE(drawing.body.find("<circle"), std::string::npos);
  const Json json = client().get(path + object + "&format=json").json();
  EXPECT_EQ(json["circles"].size(), json["inside_triangles"]);
  EXPECT_EQ(json["contour"].size(), json["boundary_points"].size());
  EXPECT_EQ(json["plane"], "axial");
  EXPECT_EQ(client().get(path + "0").status, 404);
  EXPECT_EQ(client().get("/v1/volumes/" + volume() + "/histogram?format=svg").body.substr(0, 4), "<svg");
  EXPECT_EQ(client().get("/v1/models/" + model() + "/histogram?format=png").header("Content-Type"), "image/png");
}

TEST_F(Service, ImportsSpheres) {
  const Answer created = client().post("/v1/models", {.body = "x,y,z,r\n0,0,0,10\n12,0,0,5\n", .type = "text/csv"});
  ASSERT_EQ(created.status, 201) << created.body;
  const Json json = created.json();
  EXPECT_EQ(json["kind"], "imported");
  EXPECT_EQ(json["counts"]["spheres"], 2);
  EXPECT_EQ(json["bounds_mm"]["max"], Json({17, 10, 10}));
  EXPECT_EQ(client().post("/v1/models?format=csv", {.body = "x,y,z,r\n0,0,0,10\n12,0,0,5\n"}).status, 200);
  const std::string path = "/v1/models/" + json["id"].get<std::string>();
  const Json measures = client().get(path + "/measures").json();
  EXPECT_EQ(measures["spheres"]["radius_max_mm"], 10);
  EXPECT_FALSE(measures.contains("tetrahedra"));
  EXPECT_EQ(client().get(path + "/checks").status, 422);
  EXPECT_EQ(client().get(path + "/render?width=32&height=32").status, 200);
  const std::string npy = client().get(path + "/exports/npy").body;
  EXPECT_EQ(client().post("/v1/models", {.body = npy, .type = "application/x-npy"}).json()["counts"]["spheres"], 2);
  EXPECT_EQ(client().post("/v1/models?format=npy", {.body = "x,y,z,r\n1,2,3,4\n"}).status, 400);
  for (const char* row : {"1,2,3,-4", "nan,2,3,4", "1,2,inf,4", "1,2,3,nan", "1e30,2,3,4", ""}) {
    const Answer refused =
        client().post("/v1/models", {.body = std::string("x,y,z,r\n") + row + "\n", .type = "text/csv"});
    EXPECT_EQ(refused.status, 422) << row;
    EXPECT_EQ(refused.header("Content-Type"), "application/problem+json") << row;
    EXPECT_TRUE(refused.json()["detail"].get<std::string>().ends_with('.')) << row;
  }
  std::string many = "x,y,z,r\n";
  for (int i = 0; i <= 100'000; ++i) many += "1,2,3,4\n";
  const Answer refused = client().post("/v1/models", {.body = many, .type = "text/csv"});
  EXPECT_EQ(refused.status, 413);
  EXPECT_NE(refused.json()["detail"].get<std::string>().find("more than 100000 spheres"), std::string::npos);
  EXPECT_EQ(client().ask("DELETE", path).status, 204);
  EXPECT_EQ(client().get(path).status, 404);
}

TEST_F(Service, RunsJobs) {
  const std::string wish = Json{{"volume", volume()}, {"threshold", 77.25}}.dump();
  const Answer accepted = client().post("/v1/models", {.body = wish, .type = "application/json"});
  ASSERT_EQ(accepted.status, 202) << accepted.body;
  const std::string job = accepted.header("Location");
  EXPECT_EQ(Json(job), accepted.json()["links"]["self"]);
  const Answer events = client().get(job + "/events");
  EXPECT_EQ(events.status, 200);
  EXPECT_NE(events.body.find("event: end\ndata: {\"state\":\"succeeded\""), std::string::npos) << events.body;
  const Json over = client().get(job).json();
  EXPECT_EQ(over["state"], "succeeded");
  EXPECT_EQ(over["progress"], 1);
  const Answer model = client().get(over["links"]["result"]);
  EXPECT_EQ(model.status, 200);
  EXPECT_EQ(model.json()["parameters"]["threshold"], 77.25);
  EXPECT_EQ(client().post(job + "/cancel").status, 409);
  const std::size_t last = events.body.rfind("id: ") + 4;
  const std::string number = events.body.substr(last, events.body.find('\n', last) - last);
  EXPECT_EQ(client().get(job + "/events", {.headers = {{"Last-Event-ID", number}}}).status, 204);
  EXPECT_EQ(client().get("/v1/jobs?limit=1").json()["jobs"].size(), 1U);
  EXPECT_EQ(client().get("/v1/jobs/job_" + std::string(32, '0')).status, 404);

  const Answer failed = client().post(
      "/v1/models", {.body = Json{{"volume", volume()}, {"threshold", 999}}.dump(), .type = "application/json"});
  ASSERT_EQ(failed.status, 202);
  client().get(failed.header("Location") + "/events");
  const Json end = client().get(failed.header("Location")).json();
  EXPECT_EQ(end["state"], "failed");
  EXPECT_EQ(end["error"]["status"], 422);
}

TEST_F(Service, SharesTheJobOfEqualRequestsAndCancelsIt) {
  // Large enough to be under way while it is asked about: the queue runs one job at a time.
  const std::string big = client().upload("?format=raw&dims=128,128,128&dtype=uint8", ball(128, 63));
  const auto start = [&](double threshold) {
    return client().post("/v1/models",
                         {.body = Json{{"volume", big}, {"threshold", threshold}}.dump(), .type = "application/json"});
  };
  const Answer running = start(10.5), queued = start(20.5);
  Answer joined;
  for (int i = 0; i < 10; ++i) joined = start(20.5);
  ASSERT_EQ(running.status, 202);
  ASSERT_EQ(queued.status, 202);
  EXPECT_EQ(queued.header("Location"), joined.header("Location"));
  EXPECT_NE(queued.header("Location"), running.header("Location"));
  EXPECT_EQ(client().post(queued.header("Location") + "/cancel").json()["state"], "cancelled")
      << "one client, one cancel";
  EXPECT_EQ(client().post(running.header("Location") + "/cancel").status, 202);
  client().get(running.header("Location") + "/events");
  EXPECT_EQ(client().get(running.header("Location")).json()["state"], "cancelled");
}

TEST_F(Service, DeletesWithEverythingMadeFromIt) {
  const std::string id = client().upload("?format=raw&dims=12,12,12&dtype=uint8", ball(12, 5));
  const std::string model = client().model({{"volume", id}, {"threshold", 99}})["id"];
  EXPECT_EQ(client().get("/v1/models/" + model + "/measures").status, 200);
  EXPECT_EQ(client().ask("DELETE", "/v1/models/" + id).status, 404);
  EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + id).status, 204);
  EXPECT_EQ(client().ask("DELETE", "/v1/volumes/" + id).status, 404);
  EXPECT_EQ(client().get("/v1/volumes/" + id).status, 404);
  EXPECT_EQ(client().get("/v1/models/" + model).status, 404);
  EXPECT_EQ(client().get("/v1/models/" + model + "/measures").status, 404);
}

TEST_F(Service, TellsOfItself) {
  EXPECT_EQ(client().get("/livez").json()["status"], "alive");
  EXPECT_EQ(client().get("/readyz").json()["status"], "ready");
  EXPECT_EQ(client().get("/version").json()["algorithm_version"], "1");
  EXPECT_EQ(client().get("/openapi.yaml").body.substr(0, 9), "# SPDX-Li");
  EXPECT_EQ(client().get("/docs").header("Content-Type"), "text/html; charset=utf-8");
  EXPECT_EQ(client().get("/nothing").status, 404);
  const Answer wrong = client().ask("PUT", "/v1/models", {.body = "x", .type = "text/plain"});
  EXPECT_EQ(wrong.status, 405);
  EXPECT_EQ(wrong.header("Allow"), "GET, HEAD, POST, OPTIONS");
}

TEST_F(Service, AnswersEveryOperationOfTheContract) {
  const std::string id = volume(), made = model();
  const Answer job = client().post("/v1/models", {.body = Json{{"volume", id}, {"threshold", 33}}.dump()});
  ASSERT_EQ(job.status, 202);
  const Answer simplified = client().post("/v1/models/" + made + "/simplifications",
                                          {.headers = {{"Prefer", "wait=60"}}, .body = R"({"method": "average"})"});
  ASSERT_EQ(simplified.status, 201) << simplified.body;
  const Ask pair{.headers = {{"Prefer", "wait=60"}},
                 .body = Json{{"fixed", made}, {"moving", simplified.json()["id"]}}.dump()};
  const std::string registration = client().post("/v1/registrations", pair).header("Location");
  const Ask upload{.headers = {{"Upload-Length", "4"}}};
  const std::string uploads = client().post("/v1/uploads", upload).header("Location");
  // What an operation needs to succeed; a new one that needs something fails until it stands here.
  const std::map<std::string, Ask> asks = {
      {"POST /v1/volumes", {.body = ball(24, 11.5)}},
      {"POST /v1/uploads", upload},
      {"PATCH /v1/uploads/{upload}",
       {.headers = {{"Upload-Offset", "0"}}, .body = "abcd", .type = "application/offset+octet-stream"}},
      {"POST /v1/models", {.body = Json{{"volume", id}, {"threshold", 34}}.dump()}},
      {"POST /v1/models/{model}/simplifications", {.body = R"({"method": "median"})"}},
      {"POST /v1/registrations", pair}};
  // Deleting comes after all that reads, and a job that is to be cancelled must not be over.
  const std::string big = client().upload("?format=raw&dims=128,128,128&dtype=uint8", ball(128, 63));
  const Answer busy = client().post("/v1/models", {.body = Json{{"volume", big}, {"threshold", 5}}.dump()});
  auto operations = contract_operations();
  std::ranges::stable_partition(operations, [](const auto& operation) { return operation.first != "DELETE"; });
  std::ranges::stable_partition(
      operations, [](const auto& operation) { return operation.second.starts_with("/v1/jobs/{job}/cancel"); });
  std::ranges::stable_sort(operations, {}, [](const auto& operation) {
    const auto& [method, path] = operation;
    if (method != "DELETE") return 0;
    return path.starts_with("/v1/registrations") ? 1 : path.starts_with("/v1/volumes") ? 3 : 2;
  });
  for (auto [method, path] : operations) {
    const bool cancels = path.ends_with("/cancel");
    const auto fill = [&](const std::string& name, const std::string& value) {
      if (const std::size_t at = path.find(name); at != std::string::npos) path.replace(at, name.size(), value);
    };
    const std::string pattern = path;
    fill("{volume}", id);
    fill("{model}", path.ends_with("/tree") ? simplified.json()["id"].get<std::string>() : made);
    fill("/v1/registrations/{registration}", registration);
    fill("/v1/uploads/{upload}", uploads);
    fill("/v1/jobs/{job}", (cancels ? busy : job).header("Location"));
    fill("{format}", "ply");
    fill("{axis}/{index}", "k/9");
    const auto wanted = asks.find(method + " " + pattern);
    const Ask ask = wanted == asks.end() ? Ask() : wanted->second;
    if (pattern == "/v1/volumes" && method == "POST") path += kRaw;
    const Answer answer = client().ask(method, path, ask);
    EXPECT_TRUE(answer.status >= 200 && answer.status < 300) << method << " " << path << " " << answer.status;
  }
}

}  // namespace
}  // namespace spherule::test
