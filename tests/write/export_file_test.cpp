// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/export_file.h"

#include <gtest/gtest.h>
#include <openvdb/io/File.h>
#include <openvdb/openvdb.h>
#include <tinyxml.h>
#include <urdf_parser/urdf_parser.h>
#include <yaml-cpp/yaml.h>

#include <algorithm>
#include <chrono>
#include <map>
#include <nlohmann/json.hpp>
#include <numbers>
#include <sstream>

#include "core/inside.h"
#include "core/pipeline.h"
#include "core/sampled/object.h"
#include "core/write/export.h"
#include "core/write/export_grids.h"
#include "tests/errors.h"
#include "tests/phantoms.h"
#include "tests/read/files.h"

namespace spherule::test {
namespace {

using Json = nlohmann::json;
constexpr double kPi = std::numbers::pi;

std::vector<Sphere> random_balls(std::size_t count, double edge, std::uint64_t seed) {
  phantoms::Random random(seed);
  std::vector<Sphere> balls(count);
  for (Sphere& b : balls) {
    for (int a = 0; a < 3; ++a) b.centre[a] = edge * (random.unit() - 0.5);
    b.radius = 1 + 6 * random.unit();
  }
  return balls;
}

// What the server does: measures where they are needed.
std::string written(FileFormat format, std::span<const Sphere> balls, const FileOptions& options = {},
                    const Grid* scan = nullptr, const Context& context = {}) {
  const UnionMeasures whole = needs_union(format) ? measure_union(balls) : UnionMeasures{};
  return spheres_to_file(format, {.spheres = balls, .scan = scan, .whole = &whole}, options, context);
}

RigidBody body_of(std::span<const Sphere> balls, double density, BodyOrigin origin = BodyOrigin::frame) {
  return rigid_body(balls, measure_union(balls), density, origin);
}

std::vector<double> numbers(const std::string& line) {
  std::istringstream in(line);
  std::vector<double> values;
  for (double value = 0; in >> value;) values.push_back(value);
  return values;
}

std::vector<std::string> lines_of(const std::string& text) {
  std::istringstream in(text);
  std::vector<std::string> lines;
  for (std::string line; std::getline(in, line);) lines.push_back(line);
  return lines;
}

TEST(RigidBodies, OfABall) {
  const std::vector<Sphere> ball{{{100, -20, 30}, 10}};
  const RigidBody body = body_of(ball, 2000);
  const double volume = 4 * kPi / 3 * 1e-6, inertia = 0.4 * 2000 * volume * 1e-4;
  EXPECT_NEAR(body.volume_m3, volume, 1e-12 * volume);
  EXPECT_NEAR(body.mass_kg, 2000 * volume, 1e-12 * 2000 * volume);
  expect_near(body.centre_m, {0.1, -0.02, 0.03}, 1e-14);
  EXPECT_EQ(body.spheres, (std::vector<Sphere>{{{0.1, -0.02, 0.03}, 0.01}})) << "decimals stay short";
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      // Moments about an origin 11 radii away are what cancels.
      EXPECT_NEAR(body.inertia_kg_m2.rows[static_cast<std::size_t>(i)][j], i == j ? inertia : 0, 1e-11 * inertia);
    }
  }
  const RigidBody centred = body_of(ball, 2000, BodyOrigin::centre);
  expect_near(centred.centre_m, {0, 0, 0}, 0);
  expect_near(centred.spheres[0].centre, {0, 0, 0}, 1e-14);
  expect_near(centred.origin_mm, {100, -20, 30}, 1e-11);
}

// Halves of the union are balls cut at the plane between: int t^k (R² - t²)^m dt from -R to h.
TEST(RigidBodies, OfTwoBallsCountTheLensOnce) {
  const double R = 10, h = 4;
  const std::vector<Sphere> balls{{{-h, 0, 0}, R}, {{h, 0, 0}, R}, {{h, 1, 0}, 2}};
  const RigidBody body = body_of(balls, 1e9);  // 1 kg/mm³
  const auto power = [&](int n) { return (std::pow(h, n) - std::pow(-R, n)) / n; };
  const double disc = R * R * power(1) - power(3);  // int R² - t²
  const double half = kPi * disc;
  const double across = kPi / 2 * (std::pow(R, 4) * power(1) - 2 * R * R * power(3) + power(5));  // int y² + z²
  const double along = kPi * (R * R * (power(3) - 2 * h * power(2) + h * h * power(1)) -
                              (power(5) - 2 * h * power(4) + h * h * power(3)));  // int (t - h)²
  EXPECT_NEAR(body.mass_kg, 2 * half, 1e-11 * half);
  EXPECT_LT(body.mass_kg, 2 * 4 * kPi / 3 * R * R * R - 1) << "the lens is not counted twice";
  expect_near(body.centre_m, {0, 0, 0}, 1e-13);
  const auto& inertia = body.inertia_kg_m2.rows;
  EXPECT_NEAR(inertia[0].x, 2 * across * 1e-6, 1e-11 * across * 1e-6);
  EXPECT_NEAR(inertia[1].y, (across + 2 * along) * 1e-6, 1e-11 * across * 1e-6);
  EXPECT_NEAR(inertia[2].z, (across + 2 * along) * 1e-6, 1e-11 * across * 1e-6);
  EXPECT_EQ(body.spheres.size(), 2U) << "the hidden one is left out";
  EXPECT_NEAR(body.sphere_mass_kg[0] + body.sphere_mass_kg[1], body.mass_kg, 1e-11 * half);
  UnionMeasures shared = measure_union(std::vector<Sphere>{balls[0], balls[1]});
  shared.parts.push_back(shared.parts[1]);
  shared.parts[1].volume_mm3 *= 0.25, shared.parts[2].volume_mm3 *= 0.75;
  const RigidBody once = rigid_body(std::vector<Sphere>{balls[0], balls[1], balls[1]}, shared, 1e9, BodyOrigin::frame);
  EXPECT_EQ(once.spheres.size(), 2U) << "what several cells share is one sphere";
  EXPECT_NEAR(once.sphere_mass_kg[1], body.sphere_mass_kg[1], 1e-11 * half);
  expect_error([] { body_of(std::vector<Sphere>{{{1, 2, 3}, 0}}, 1); }, ErrorCode::unusable, "no volume");
}

TEST(Urdf, IsWhatUrdfdomReads) {
  const auto balls = random_balls(20, 20, 1);
  const RigidBody body = body_of(balls, 1500, BodyOrigin::centre);
  const auto robot = urdf::parseURDF(
      written(FileFormat::urdf, balls, {.density_kg_m3 = 1500, .link = "femur_2", .origin = BodyOrigin::centre}));
  ASSERT_TRUE(robot);
  ASSERT_EQ(robot->links_.size(), 1U);
  const auto link = robot->getLink("femur_2");
  ASSERT_TRUE(link);
  ASSERT_TRUE(link->inertial);
  EXPECT_EQ(link->inertial->mass, body.mass_kg);
  EXPECT_EQ(link->inertial->origin.position.x, body.centre_m.x + 0.0);
  const auto& rows = body.inertia_kg_m2.rows;
  EXPECT_EQ(link->inertial->ixx, rows[0].x);
  EXPECT_EQ(link->inertial->ixy, rows[0].y);
  EXPECT_EQ(link->inertial->ixz, rows[0].z);
  EXPECT_EQ(link->inertial->iyy, rows[1].y);
  EXPECT_EQ(link->inertial->iyz, rows[1].z);
  EXPECT_EQ(link->inertial->izz, rows[2].z);
  ASSERT_EQ(link->collision_array.size(), body.spheres.size());
  for (std::size_t i = 0; i < body.spheres.size(); ++i) {
    const auto& collision = *link->collision_array[i];
    ASSERT_EQ(collision.geometry->type, urdf::Geometry::SPHERE);
    EXPECT_EQ(dynamic_cast<const urdf::Sphere&>(*collision.geometry).radius, body.spheres[i].radius);
    const auto& p = collision.origin.position;
    EXPECT_EQ((Vec3{p.x, p.y, p.z}), body.spheres[i].centre);
  }
}

TEST(Srdf, ListsTheSpheresOfTheLink) {
  const auto balls = random_balls(9, 20, 2);
  const RigidBody body = body_of(balls, 1);
  TiXmlDocument document;
  document.Parse(written(FileFormat::srdf, balls).c_str());
  ASSERT_FALSE(document.Error());
  const TiXmlElement* approximation = document.RootElement()->FirstChildElement("link_sphere_approximation");
  ASSERT_NE(approximation, nullptr);
  EXPECT_STREQ(approximation->Attribute("link"), "object");
  std::vector<Sphere> read;
  for (const auto* s = approximation->FirstChildElement("sphere"); s != nullptr; s = s->NextSiblingElement("sphere")) {
    const auto c = numbers(s->Attribute("center"));
    ASSERT_EQ(c.size(), 3U);
    read.push_back({{c[0], c[1], c[2]}, std::stod(s->Attribute("radius"))});
  }
  EXPECT_EQ(read, body.spheres);
}

void expect_yaml_spheres(const YAML::Node& list, const std::vector<Sphere>& expected, const std::string& text) {
  ASSERT_TRUE(list.IsSequence());
  std::vector<Sphere> read;
  for (const YAML::Node& s : list) {
    read.push_back({{s["center"][0].as<double>(), s["center"][1].as<double>(), s["center"][2].as<double>()},
                    s["radius"].as<double>()});
  }
  EXPECT_EQ(read, expected);
  for (const std::string& line : lines_of(text)) {
    if (line.find("center:") == std::string::npos && line.find("radius:") == std::string::npos) continue;
    EXPECT_EQ(line.substr(line.find(':')).find('e'), std::string::npos) << "YAML 1.1 reads 1e-05 as a word: " << line;
  }
}

TEST(Yaml, OfRobotPrograms) {
  std::vector<Sphere> balls = random_balls(9, 20, 3);
  balls.push_back({{1e-9, 1e6, -1e-4}, 1e-3});
  const RigidBody body = body_of(balls, 1);
  const std::string xrdf = written(FileFormat::xrdf, balls, {.link = "base"});
  const YAML::Node robot = YAML::Load(xrdf);
  EXPECT_EQ(robot["format"].as<std::string>(), "xrdf");
  EXPECT_EQ(robot["format_version"].as<std::string>(), "1.0");
  const auto geometry = robot["collision"]["geometry"].as<std::string>();
  expect_yaml_spheres(robot["geometry"][geometry]["spheres"]["base"], body.spheres, xrdf);
  const std::string curobo = written(FileFormat::curobo, balls, {.link = "base"});
  expect_yaml_spheres(YAML::Load(curobo)["collision_spheres"]["base"], body.spheres, curobo);
}

TEST(Liggghts, HasOneLineASphereAndTheCommand) {
  const auto balls = random_balls(9, 20, 4);
  const RigidBody body = body_of(balls, 2500);
  std::vector<Sphere> read;
  std::string command;
  for (const std::string& line : lines_of(written(FileFormat::liggghts, balls, {.density_kg_m3 = 2500}))) {
    if (line.find("# fix ") == 0) command = line;
    if (line.front() == '#') continue;
    const auto v = numbers(line);
    ASSERT_EQ(v.size(), 4U);
    read.push_back({{v[0], v[1], v[2]}, v[3]});
  }
  EXPECT_EQ(read, body.spheres);
  const auto after = [&](const std::string& word) {
    const auto at = command.find(" " + word + " ");
    return at == std::string::npos ? std::vector<double>{} : numbers(command.substr(at + word.size() + 2));
  };
  EXPECT_EQ(after("nspheres"), std::vector<double>{static_cast<double>(body.spheres.size())});
  EXPECT_EQ(after("mass"), std::vector<double>{body.mass_kg});
  const auto& rows = body.inertia_kg_m2.rows;
  EXPECT_EQ(after("inertia_tensor"),
            (std::vector<double>{rows[0].x, rows[0].y, rows[0].z, rows[1].y, rows[1].z, rows[2].z}));
}

// By the rules of the molecule command: the first line is skipped, header lines end in their keyword, a section has its
// name, a line that is skipped, and one line an atom.
TEST(Lammps, IsAMoleculeFile) {
  const auto balls = random_balls(9, 20, 5);
  const RigidBody body = body_of(balls, 2500);
  std::map<std::string, std::vector<double>> header;
  std::map<std::string, std::vector<std::vector<double>>> sections;
  const auto lines = lines_of(written(FileFormat::lammps, balls, {.density_kg_m3 = 2500}));
  for (std::size_t i = 1; i < lines.size(); ++i) {
    const std::string line = lines[i].substr(0, lines[i].find('#'));
    if (line.find_first_not_of(' ') == std::string::npos) continue;
    if (const auto word = line.find_last_of(' '); word != std::string::npos) {
      header[line.substr(word + 1)] = numbers(line);
      continue;
    }
    for (std::size_t n = 0; n < body.spheres.size(); ++n) sections[line].push_back(numbers(lines[i + 2 + n]));
    i += 1 + body.spheres.size();
  }
  EXPECT_EQ(header["atoms"], std::vector<double>{static_cast<double>(body.spheres.size())});
  EXPECT_EQ(header["mass"], std::vector<double>{body.mass_kg});
  EXPECT_EQ(header["com"], (std::vector<double>{body.centre_m.x, body.centre_m.y, body.centre_m.z}));
  const auto& rows = body.inertia_kg_m2.rows;
  EXPECT_EQ(header["inertia"], (std::vector<double>{rows[0].x, rows[1].y, rows[2].z, rows[0].y, rows[0].z, rows[1].z}));
  for (std::size_t i = 0; i < body.spheres.size(); ++i) {
    const Sphere& s = body.spheres[i];
    const double id = static_cast<double>(i + 1);
    EXPECT_EQ(sections["Coords"][i], (std::vector<double>{id, s.centre.x, s.centre.y, s.centre.z}));
    EXPECT_EQ(sections["Types"][i], (std::vector<double>{id, 1}));
    EXPECT_EQ(sections["Diameters"][i], (std::vector<double>{id, 2 * s.radius}));
    EXPECT_EQ(sections["Masses"][i], (std::vector<double>{id, body.sphere_mass_kg[i]}));
  }
}

TEST(Yade, IsOneClump) {
  const auto balls = random_balls(9, 20, 6);
  std::vector<Sphere> read;
  const auto lines = lines_of(written(FileFormat::yade, balls));
  EXPECT_EQ(lines.front(), "#format x_y_z_r_clumpId");
  for (const std::string& line : lines) {
    ASSERT_FALSE(line.empty()) << "textClumps looks at the first character of every line";
    if (line.front() == '#') continue;
    const auto v = numbers(line);
    ASSERT_EQ(v.size(), 5U);
    EXPECT_EQ(v[4], 0);
    read.push_back({{v[0], v[1], v[2]}, v[3]});
  }
  EXPECT_EQ(read, body_of(balls, 1).spheres);
}

TEST(Molecules, KeepEveryDigit) {
  const auto balls = random_balls(12, 20, 7);
  const auto xyz = lines_of(written(FileFormat::xyz, balls));
  ASSERT_EQ(xyz.size(), 14U);
  EXPECT_EQ(xyz[0], "12");
  EXPECT_NE(xyz[1].find("Properties=species:S:1:pos:R:3:radius:R:1"), std::string::npos);
  EXPECT_NE(xyz[1].find("units=mm frame=LPS"), std::string::npos);
  const std::string pqr = written(FileFormat::pqr, balls);
  std::vector<std::vector<double>> atoms;
  for (const std::string& line : lines_of(pqr)) {
    if (line.rfind("ATOM ", 0) == 0) atoms.push_back(numbers(line.substr(line.find(" SPH ") + 5)));
  }
  ASSERT_EQ(atoms.size(), 12U);
  for (std::size_t i = 0; i < 12; ++i) {
    const Sphere& s = balls[i];
    EXPECT_EQ(xyz[i + 2].substr(0, 2), "X ");
    EXPECT_EQ(numbers(xyz[i + 2].substr(2)), (std::vector<double>{s.centre.x, s.centre.y, s.centre.z, s.radius}));
    EXPECT_EQ(atoms[i], (std::vector<double>{1, s.centre.x, s.centre.y, s.centre.z, 0, s.radius}));
  }
}

// A binary glTF taken apart by its specification.
struct Glb {
  Json json;
  std::string data;

  explicit Glb(const std::string& bytes) {
    const auto number = [&](std::size_t at) {
      std::uint32_t value = 0;
      std::memcpy(&value, bytes.data() + at, 4);
      return value;
    };
    EXPECT_EQ(bytes.substr(0, 4), "glTF");
    EXPECT_EQ(number(4), 2U);
    EXPECT_EQ(number(8), bytes.size());
    EXPECT_EQ(bytes.size() % 4, 0U);
    const std::size_t json_length = number(12);
    EXPECT_EQ(json_length % 4, 0U);
    EXPECT_EQ(bytes.substr(16, 4), "JSON");
    json = Json::parse(bytes.substr(20, json_length));
    EXPECT_EQ(number(20 + json_length), bytes.size() - 28 - json_length);
    EXPECT_EQ(bytes.substr(24 + json_length, 4), std::string("BIN\0", 4));
    data = bytes.substr(28 + json_length);
    EXPECT_EQ(json["buffers"][0]["byteLength"], data.size());
  }
  template <typename T>
  std::vector<T> array(std::size_t accessor) const {
    const Json& a = json["accessors"][accessor];
    const Json& view = json["bufferViews"][a["bufferView"].get<std::size_t>()];
    const std::size_t begin = view["byteOffset"], length = view["byteLength"];
    EXPECT_EQ(begin % 4, 0U);
    EXPECT_LE(begin + length, data.size());
    EXPECT_EQ(length, a["count"].get<std::size_t>() * (a["type"] == "VEC3" ? 12 : 4));
    EXPECT_EQ(a["componentType"], (std::is_same_v<T, float> ? 5126 : 5125));
    std::vector<T> values(length / sizeof(T));
    std::memcpy(values.data(), data.data() + begin, length);
    return values;
  }
  std::vector<Vec3> points(std::size_t accessor) const {
    const auto v = array<float>(accessor);
    std::vector<Vec3> points;
    for (std::size_t i = 0; i < v.size(); i += 3) points.push_back({v[i], v[i + 1], v[i + 2]});
    return points;
  }
};

// Volume within triangles that face outwards, and whether every edge is used once in either direction.
double enclosed(const std::vector<Vec3>& points, const std::vector<std::uint32_t>& indices) {
  double volume = 0;
  std::map<std::pair<std::uint32_t, std::uint32_t>, int> edges;
  for (std::size_t i = 0; i < indices.size(); i += 3) {
    const std::uint32_t a = indices[i], b = indices[i + 1], c = indices[i + 2];
    volume += dot(points[a], cross(points[b], points[c])) / 6;
    for (const auto& edge : {std::pair{a, b}, std::pair{b, c}, std::pair{c, a}}) ++edges[edge];
  }
  for (const auto& [edge, count] : edges) {
    EXPECT_EQ(count, 1);
    EXPECT_TRUE(edges.contains({edge.second, edge.first}));
  }
  return volume;
}

TEST(Glb, DrawsOneBallManyTimes) {
  auto balls = random_balls(7, 20, 8);
  balls.push_back({{5, 5, 5}, 0});
  const Glb glb(written(FileFormat::glb, balls));
  EXPECT_EQ(glb.json["extensionsRequired"], Json({"EXT_mesh_gpu_instancing"}));
  const Json& node = glb.json["nodes"][0];
  const Json& attributes = node["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
  const auto centres = glb.points(attributes["TRANSLATION"]), scales = glb.points(attributes["SCALE"]);
  ASSERT_EQ(centres.size(), 7U) << "radius 0 shows nothing";
  const Json& moved = node["translation"];
  const Vec3 middle{1e3 * moved[0].get<double>(), -1e3 * moved[2].get<double>(), 1e3 * moved[1].get<double>()};
  for (std::size_t i = 0; i < 7; ++i) {
    expect_near(centres[i] + middle, balls[i].centre, 1e-6);
    expect_near(scales[i], {balls[i].radius, balls[i].radius, balls[i].radius}, 1e-6);
  }
  const Json& primitive = glb.json["meshes"][0]["primitives"][0];
  const auto positions = glb.points(primitive["attributes"]["POSITION"]);
  EXPECT_EQ(positions, glb.points(primitive["attributes"]["NORMAL"]));
  for (const Vec3& p : positions) EXPECT_NEAR(norm(p), 1, 1e-7);
  const double volume = enclosed(positions, glb.array<std::uint32_t>(primitive["indices"]));
  EXPECT_LT(volume, 4 * kPi / 3);
  EXPECT_GT(volume, 0.95 * 4 * kPi / 3);
  // Metres; LPS to left, head, anterior: rotation by a quaternion (x, 0, 0, w) about x.
  EXPECT_EQ(node["scale"], Json({0.001, 0.001, 0.001}));
  const double x = node["rotation"][0], w = node["rotation"][3];
  EXPECT_NEAR(w * w - x * x, 0, 1e-15) << "a quarter turn";
  EXPECT_NEAR(2 * x * w, -1, 1e-15) << "that takes z to y, and y to -z";
}

// The node is where the spheres are; within it, float32 is enough.
TEST(Glb, IsAsExactFarFromTheOrigin) {
  const Vec3 far{5e6, -4e6, 3e6};
  auto balls = random_balls(20, 1, 12);
  for (Sphere& b : balls) b = {0.1 * b.centre + far, 0.01 * b.radius};
  for (const auto style : {GlbOptions::Style::instanced, GlbOptions::Style::mesh}) {
    const Glb glb(written(FileFormat::glb, balls, {.glb = {.style = style, .detail = 0}}));
    const Json& moved = glb.json["nodes"][0]["translation"];
    const Vec3 middle{1e3 * moved[0].get<double>(), -1e3 * moved[2].get<double>(), 1e3 * moved[1].get<double>()};
    Box expected, drawn;
    for (const Sphere& b : balls) expected.include(b);
    expect_near(middle, 0.5 * (expected.min + expected.max), 2e-9);
    if (style == GlbOptions::Style::instanced) {
      const Json& attributes = glb.json["nodes"][0]["extensions"]["EXT_mesh_gpu_instancing"]["attributes"];
      const auto centres = glb.points(attributes["TRANSLATION"]);
      for (std::size_t i = 0; i < balls.size(); ++i) expect_near(centres[i] + middle, balls[i].centre, 1e-8);
    } else {
      for (const Vec3& p : glb.points(glb.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"])) {
        drawn.include(p + middle);
      }
      for (int a = 0; a < 3; ++a) EXPECT_LE(drawn.max[a], expected.max[a] + 1e-7);
    }
  }
}

TEST(Glb, MeshesEveryBall) {
  const std::vector<Sphere> balls{{{-50, 3, 4}, 2}, {{50, 0, 0}, 10}};
  double before = 0;
  for (int detail = 0; detail <= 5; ++detail) {
    const Glb glb(written(FileFormat::glb, balls, {.glb = {.style = GlbOptions::Style::mesh, .detail = detail}}));
    EXPECT_FALSE(glb.json.contains("extensionsUsed"));
    const Json& primitive = glb.json["meshes"][0]["primitives"][0];
    const std::size_t position = primitive["attributes"]["POSITION"];
    const auto points = glb.points(position);
    const auto indices = glb.array<std::uint32_t>(primitive["indices"]);
    EXPECT_EQ(indices.size(), std::size_t{2 * 3 * 20} << (2 * detail));
    EXPECT_LT(*std::ranges::max_element(indices), points.size());
    const double volume = enclosed(points, indices);
    EXPECT_GT(volume, before);
    before = volume;
    Box box;
    for (const Vec3& p : points) box.include(p);
    const Json& accessor = glb.json["accessors"][position];
    for (int a = 0; a < 3; ++a) {
      EXPECT_EQ(accessor["min"][static_cast<std::size_t>(a)], box.min[a]);
      EXPECT_EQ(accessor["max"][static_cast<std::size_t>(a)], box.max[a]);
    }
  }
  const double exact = 4 * kPi / 3 * (8 + 1000);
  EXPECT_LT(before, exact);
  EXPECT_GT(before, 0.998 * exact);
  const std::vector<Sphere> many(2000, {{0, 0, 0}, 1});
  expect_error([&] { spheres_to_glb(many, {.style = GlbOptions::Style::mesh, .detail = 5}); }, ErrorCode::too_large,
               "smaller detail");
  expect_error([] { spheres_to_glb(std::vector<Sphere>{{{0, 0, 0}, 0}}); }, ErrorCode::unusable, "nothing to show");
}

// Every voxel of a file against the definition: outside, the nearest ball; inside, the depth in the deepest. Returns
// how many are inside. Tolerances in mm: float32 of the greatest value, and the rounding of places.
std::size_t expect_fields(const std::string& bytes, std::span<const Sphere> balls, double voxel, double far = 0) {
  const TempFolder folder;
  const Volume volume = read_volume({folder.add("made.vdb", bytes)}, {});
  const Grid& grid = volume.grid;
  const double band = level_set_band * voxel, tolerance = band * 0x1p-23 + 8 * 0x1p-52 * far;
  std::size_t inside = 0, wrong = 0;
  for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
        const Vec3 at = grid.to_patient({i * voxel, j * voxel, k * voxel});
        double least = band;
        for (const Sphere& b : balls) least = std::min(least, norm(at - b.centre) - b.radius);
        least = std::max(least, -band);
        inside += least < 0;
        wrong += !(std::abs(value_at(volume, i, j, k) - least) <= tolerance);
      }
    }
  }
  EXPECT_EQ(wrong, 0U) << "voxel " << voxel;
  return inside;
}

TEST(LevelSets, AreTheUnionsDistance) {
  auto balls = random_balls(40, 30, 9);
  balls.push_back({{60, 0, 0}, 12});
  const double voxel = 0.5, band = level_set_band * voxel;
  const std::string bytes = written(FileFormat::vdb, balls, {.voxel_mm = voxel});
  EXPECT_EQ(bytes, written(FileFormat::vdb, balls, {.voxel_mm = voxel}, nullptr,
                           {.threads = 3, .cancel = {}, .progress = {}}));
  const TempFolder folder;
  const auto path = folder.add("made.vdb", bytes);
  {
    openvdb::initialize();
    openvdb::io::File file(path.string());
    file.open();
    const auto grid = file.readGrid("spheres");
    EXPECT_EQ(grid->getGridClass(), openvdb::GRID_LEVEL_SET);
    EXPECT_EQ(grid->metaValue<std::string>("units"), "mm");
    EXPECT_EQ(grid->metaValue<std::string>("frame"), "LPS");
    EXPECT_EQ(openvdb::gridPtrCast<openvdb::FloatGrid>(grid)->background(), static_cast<float>(band));
    EXPECT_EQ(grid->voxelSize(), openvdb::Vec3d(voxel));
  }
  EXPECT_EQ(read_volume({path}, {}).natural_side, Side::below);
  const std::size_t inside = expect_fields(bytes, balls, voxel, 70);
  // A ball's voxels differ from its volume by less than the shell of a voxel's diagonal, and by chance by much less.
  const UnionMeasures whole = measure_union(balls);
  EXPECT_NEAR(static_cast<double>(inside) * voxel * voxel * voxel, whole.moments.volume, 0.1 * voxel * whole.area_mm2);
}

// In float32, three voxels round down for half of all sizes; nothing may depend on that.
TEST(LevelSets, AreExactForAnyVoxelSize) {
  phantoms::Random random(21);
  for (int n = 0; n < 400; ++n) {
    const double voxel = n < 40 ? std::ldexp(1, n - 15) : std::pow(10, 6 * random.unit() - 3);
    const double far = n % 4 == 0 ? std::min(1e6 * voxel, 4e8) : n % 4 == 1 ? 30 * voxel : 0;
    std::vector<Sphere> balls(3);
    for (Sphere& b : balls) {
      for (int a = 0; a < 3; ++a) b.centre[a] = far + 8 * voxel * random.unit();
      b.radius = voxel * (n % 7 == 0 ? 3 : 6 * random.unit());
    }
    expect_fields(spheres_to_vdb(balls, voxel), balls, voxel, 2 * far + 20 * voxel);
  }
}

// Models that ended the process, and took seconds.
TEST(LevelSets, OfModelsFoundInUse) {
  const std::filesystem::path file = std::filesystem::path(SPHERULE_SHARED_DATA) / "field/01-spheres.csv";
  if (!exists(file)) GTEST_SKIP() << "no shared data";
  const std::vector<Sphere> balls = spheres_from_csv(bytes_of_file(file));
  EXPECT_GT(written(FileFormat::vdb, balls).size(), 10'000U);
}

// Copies, contained balls and balls that almost coincide: what cannot be the deepest costs nothing.
TEST(LevelSets, AreNotSlowedByBallsThatAddNothing) {
  const Sphere ball{{1, 2, 3}, 20};
  const double voxel = 0.25;
  const std::string alone = spheres_to_vdb(std::vector{ball}, voxel);
  std::vector<Sphere> balls(2000, ball);
  EXPECT_EQ(spheres_to_vdb(balls, voxel), alone);
  phantoms::Random random(22);
  for (std::size_t i = 1; i < balls.size(); ++i) {
    const double inner = 20 * random.unit();
    balls[i].radius = inner;
    if (i % 2 == 0) balls[i].centre.x += 20 - inner - 1e-9;
  }
  EXPECT_EQ(spheres_to_vdb(balls, voxel), alone);
  for (Sphere& b : balls) {
    b = ball;
    for (int a = 0; a < 3; ++a) b.centre[a] += 1e-3 * random.unit();
  }
  EXPECT_GT(spheres_to_vdb(balls, voxel).size(), 10'000U);
}

TEST(LevelSets, HearACancel) {
  std::stop_source stop;
  const auto balls = random_balls(20'000, 400, 23);
  std::chrono::steady_clock::time_point asked{};
  const Context context{.threads = 1, .cancel = stop.get_token(), .progress = [&](std::string_view, double) {
                          if (stop.request_stop()) asked = std::chrono::steady_clock::now();
                        }};
  expect_error([&] { spheres_to_vdb(balls, 1, max_level_set_blocks, context); }, ErrorCode::cancelled, "cancelled");
  EXPECT_LT(std::chrono::steady_clock::now() - asked, std::chrono::seconds(1));
}

// Each alone in a node of 4096³ voxels, 300 kB of pointers.
TEST(LevelSets, RefuseATreeFarLargerThanItsBlocks) {
  std::vector<Sphere> balls;
  for (int n = 0; n < 4096; ++n) balls.push_back({{n % 16 * 5000.0, n / 16 % 16 * 5000.0, n / 256 * 5000.0}, 1});
  expect_error([&] { spheres_to_vdb(balls, 1); }, ErrorCode::too_large, "too far apart");
  expect_error(
      [] {
        spheres_to_vdb(std::vector<Sphere>{{{1e9, 0, 0}, 1}}, 1e-4);
      },
      ErrorCode::too_large, "larger voxel_mm");
}

TEST(LevelSets, FillWhatIsDeep) {
  const std::vector<Sphere> balls{{{1, 2, 3}, 140}, {{100, 0, 0}, 0}};
  const TempFolder folder;
  const Volume volume = read_volume({folder.add("deep.vdb", spheres_to_vdb(balls, 1))}, {});
  const Grid& grid = volume.grid;
  for (std::int32_t k = 0; k < grid.dims[2]; k += 5) {
    for (std::int32_t j = 0; j < grid.dims[1]; j += 5) {
      for (std::int32_t i = 0; i < grid.dims[0]; i += 5) {
        const double distance = norm(grid.to_patient({double(i), double(j), double(k)}) - balls[0].centre) - 140;
        ASSERT_NEAR(value_at(volume, i, j, k), std::clamp(distance, -3.0, 3.0), 1e-5);
      }
    }
  }
  expect_error([&] { spheres_to_vdb(balls, 1, 1000); }, ErrorCode::too_large, "larger voxel_mm");
  expect_error([&] { spheres_to_vdb(balls, 1e-4); }, ErrorCode::too_large, "larger voxel_mm");
  expect_error([&] { spheres_to_vdb(balls, 0); }, ErrorCode::invalid_argument, "2e-5 to 1e9");
  expect_error([&] { spheres_to_vdb(balls, 1e39); }, ErrorCode::invalid_argument, "2e-5 to 1e9");
  // OpenVDB takes smaller voxels for none; by default they are not smaller.
  const std::vector<Sphere> tiny{{{0, 0, 0}, 1e-5}};
  expect_error([&] { spheres_to_vdb(tiny, 1e-6); }, ErrorCode::invalid_argument, "2e-5 to 1e9");
  EXPECT_GT(written(FileFormat::vdb, tiny).size(), 100U);
}

Grid oblique(bool left_handed) {
  Grid grid;
  grid.dims = {23, 19, 17};
  grid.spacing = {1.5, 2, 2.5};
  grid.origin = {-10, -15, -22};
  const double c = std::cos(0.3), s = std::sin(0.3);
  grid.direction = {{Vec3{c, -s, 0}, Vec3{s, c, 0}, Vec3{0, 0, left_handed ? -1.0 : 1.0}}};
  if (left_handed) grid.origin.z = 20;
  return grid;
}

TEST(Masks, AreOnTheScansGrid) {
  const auto balls = random_balls(15, 25, 10);
  for (const bool left_handed : {false, true}) {
    const Grid scan = oblique(left_handed);
    const TempFolder folder;
    const Volume mask = read_volume({folder.add("mask.nii.gz", written(FileFormat::nifti, balls, {}, &scan))}, {});
    ASSERT_EQ(mask.grid.dims, scan.dims);
    EXPECT_TRUE(mask.warnings.empty());
    expect_near(mask.grid.origin, scan.origin, 1e-5);
    for (int a = 0; a < 3; ++a) expect_step(mask, a, scan.spacing[a] * scan.direction.column(a), 1e-6);
    std::size_t inside = 0;
    for (std::int32_t k = 0; k < scan.dims[2]; ++k) {
      for (std::int32_t j = 0; j < scan.dims[1]; ++j) {
        for (std::int32_t i = 0; i < scan.dims[0]; ++i) {
          const Vec3 at = scan.to_patient({i * scan.spacing.x, j * scan.spacing.y, k * scan.spacing.z});
          const bool held =
              std::ranges::any_of(balls, [&](const Sphere& b) { return norm(at - b.centre) <= b.radius; });
          ASSERT_EQ(value_at(mask, i, j, k), held ? 1 : 0);
          inside += held;
        }
      }
    }
    EXPECT_GT(inside, 100U);
  }
}

// Every inside sample is in some ball of a raw model, and no outside sample is: the mask gives back the object.
TEST(Masks, OfARawModelsSpheresAreTheObject) {
  Grid grid = oblique(false);
  grid.origin = {0, 0, 0};
  const Volume volume = phantoms::noise(grid, 200, 5);
  const ObjectRule rule = phantoms::threshold(120.5);
  const SphereModel model = build_model(volume, rule).model;
  const InsideSamples truth = classify_samples(volume, rule);
  const TempFolder folder;
  const Volume mask =
      read_volume({folder.add("mask.nii.gz", written(FileFormat::nifti, model.spheres, {}, &grid))}, {});
  for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
      for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
        ASSERT_EQ(value_at(mask, i, j, k) == 1, truth.inside.test(i, j, k));
      }
    }
  }
}

// Samples equal to a threshold lie on the spheres, where rounding would decide: the rule decides.
TEST(Masks, OfARawModelAreTheObjectAtAWholeThreshold) {
  Grid grid = oblique(false);
  const Volume volume = phantoms::noise(grid, 200, 5);
  for (const Side side : {Side::above, Side::below}) {
    ObjectRule rule = phantoms::threshold(120);
    rule.side = side;
    const SphereModel model = build_model(volume, rule).model;
    const SampleBits inside = classify_samples(volume, rule).inside;
    const TempFolder folder;
    const Volume mask = read_volume(
        {folder.add("mask.nii.gz", spheres_to_file(FileFormat::nifti,
                                                   {.spheres = model.spheres, .scan = &grid, .inside = &inside}, {}))},
        {});
    std::size_t equal = 0, wrong = 0;
    for (std::int32_t k = 0; k < grid.dims[2]; ++k) {
      for (std::int32_t j = 0; j < grid.dims[1]; ++j) {
        for (std::int32_t i = 0; i < grid.dims[0]; ++i) {
          const double value = value_at(volume, i, j, k);
          equal += value == 120;
          wrong += (value_at(mask, i, j, k) == 1) != (side == Side::above ? value >= 120 : value < 120);
        }
      }
    }
    EXPECT_GT(equal, 10U);
    EXPECT_EQ(wrong, 0U);
  }
}

// NIfTI-1 places samples in float32; where that is not enough, the file is NIfTI-2.
TEST(Masks, AreInPlaceFarFromTheOrigin) {
  Grid far = oblique(false);
  far.origin = {5e6 + 0.123, -5e6, 5e6};
  far.spacing = {0.01, 0.02, 0.03};
  Grid wide;
  wide.dims = {32768, 1, 1};
  for (const Grid& grid : {far, wide}) {
    SampleBits bits(grid.dims);
    bits.row(0, 0)[0] = 5;
    const TempFolder folder;
    const Volume mask = read_volume({folder.add("mask.nii.gz", mask_to_nifti(grid, bits))}, {});
    ASSERT_EQ(mask.grid.dims, grid.dims);
    EXPECT_TRUE(mask.warnings.empty());
    expect_near(mask.grid.origin, grid.origin, 1e-8);
    for (int a = 0; a < 3; ++a) expect_step(mask, a, grid.spacing[a] * grid.direction.column(a), 1e-12);
    EXPECT_EQ(value_at(mask, 2, 0, 0), 1);
  }
}

TEST(Masks, OfSpheresWithoutAScanNeedAVoxelSize) {
  const std::vector<Sphere> ball{{{10, 20, 30}, 8}};
  expect_error([&] { written(FileFormat::nifti, ball); }, ErrorCode::unusable, "give voxel_mm");
  const TempFolder folder;
  const Volume mask =
      read_volume({folder.add("mask.nii.gz", written(FileFormat::nifti, ball, {.voxel_mm = 0.25}))}, {});
  std::size_t inside = 0;
  visit_voxels(mask, [&](auto voxels) { inside = static_cast<std::size_t>(std::ranges::count(voxels, 1)); });
  EXPECT_NEAR(static_cast<double>(inside) / 64, 4 * kPi / 3 * 512, 0.01 * 4 * kPi / 3 * 512);
  expect_error([&] { written(FileFormat::nifti, ball, {.voxel_mm = 1e-3}); }, ErrorCode::too_large, "larger voxel_mm");
}

std::vector<FileFormat> all_formats() {
  std::vector<FileFormat> formats;
  for (std::size_t i = 0; i < file_format_count; ++i) formats.push_back(static_cast<FileFormat>(i));
  return formats;
}

TEST(Files, AreTheSameBytesEachTimeAndRefuseWhatIsNoUse) {
  const auto balls = random_balls(10, 20, 11);
  for (const FileFormat format : all_formats()) {
    const FileFormatInfo& about = info(format);
    EXPECT_EQ(file_format(about.name), format);
    const FileOptions options{.voxel_mm = 1};
    EXPECT_EQ(written(format, balls, options), written(format, balls, options)) << about.name;
    expect_error([&] { check_exportable(format, 0, true, {}); }, ErrorCode::unusable, "no spheres");
    if (about.most_spheres < 1'000'000) {
      check_exportable(format, about.most_spheres, true, {});
      expect_error([&] { check_exportable(format, about.most_spheres + 1, true, {}); }, ErrorCode::unusable,
                   "simplify the model first");
    }
  }
  EXPECT_FALSE(file_format("stl"));
  EXPECT_FALSE(file_format(""));
}

TEST(FileOptions, AreReadBackAndRefusedByName) {
  const std::map<std::string, std::string> unusual{{"density", "19300.5"}, {"link", "tibia_l"}, {"origin", "centre"},
                                                   {"style", "mesh"},      {"detail", "4"},     {"voxel_mm", "0.25"}};
  for (const FileFormat format : all_formats()) {
    EXPECT_TRUE(file_option_texts(format, {}).empty());
    OptionTexts texts;
    for (const std::string_view name : file_option_names(format)) {
      texts.emplace_back(name, unusual.at(std::string(name)));
    }
    EXPECT_EQ(file_option_texts(format, parse_file_options(format, texts)), texts);
    for (const auto& [name, text] : unusual) {
      const auto names = file_option_names(format);
      if (std::ranges::find(names, name) != names.end()) continue;
      expect_error([&] { parse_file_options(format, {{name, text}}); }, ErrorCode::invalid_argument, name);
    }
  }
  for (const auto& [format, name, text] : std::initializer_list<std::tuple<FileFormat, std::string, std::string>>{
           {FileFormat::urdf, "density", "0"},
           {FileFormat::urdf, "density", "-1"},
           {FileFormat::urdf, "density", "inf"},
           {FileFormat::urdf, "density", "heavy"},
           {FileFormat::urdf, "link", ""},
           {FileFormat::urdf, "link", "2nd"},
           {FileFormat::urdf, "link", "a\"b"},
           {FileFormat::urdf, "link", "a b"},
           {FileFormat::urdf, "link", std::string(65, 'a')},
           {FileFormat::yade, "origin", "center"},
           {FileFormat::glb, "style", "points"},
           {FileFormat::glb, "detail", "6"},
           {FileFormat::glb, "detail", "-1"},
           {FileFormat::glb, "detail", "1.5"},
           {FileFormat::urdf, "density", "1e300"},
           {FileFormat::vdb, "voxel_mm", "0"},
           {FileFormat::nifti, "voxel_mm", "1e-10"},
           {FileFormat::nifti, "voxel_mm", "1e10"},
           {FileFormat::vdb, "voxel_mm", "nan"}}) {
    try {
      parse_file_options(format, {{name, text}});
      ADD_FAILURE() << name << "=" << text;
    } catch (const Error& e) {
      EXPECT_EQ(e.code(), ErrorCode::invalid_argument);
      ASSERT_EQ(e.fields().size(), 1U);
      EXPECT_EQ(e.fields()[0].pointer, name);
    }
  }
  expect_error(
      [] {
        parse_file_options(FileFormat::vdb, {{"voxel_mm", "1"}, {"voxel_mm", "2"}});
      },
      ErrorCode::invalid_argument, "once");
}

}  // namespace
}  // namespace spherule::test
