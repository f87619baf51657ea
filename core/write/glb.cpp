// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: Khronos glTF 2.0 specification, with the extension EXT_mesh_gpu_instancing.
#include <array>
#include <cstdint>
#include <map>
#include <utility>
#include <vector>

#include "core/base/error.h"
#include "core/base/poll.h"
#include "core/write/binary.h"
#include "core/write/decimal.h"
#include "core/write/export_scenes.h"

namespace spherule {
namespace {

struct Triangulation {
  std::vector<Vec3> vertices;
  std::vector<std::array<std::uint32_t, 3>> triangles;
};

// Corners on the unit sphere, triangles counter-clockwise from outside.
Triangulation icosphere(int detail) {
  const double phi = (1 + std::sqrt(5.0)) / 2;
  Triangulation ball;
  for (const Vec3 v :
       {Vec3{-1, phi, 0}, Vec3{1, phi, 0}, Vec3{-1, -phi, 0}, Vec3{1, -phi, 0}, Vec3{0, -1, phi}, Vec3{0, 1, phi},
        Vec3{0, -1, -phi}, Vec3{0, 1, -phi}, Vec3{phi, 0, -1}, Vec3{phi, 0, 1}, Vec3{-phi, 0, -1}, Vec3{-phi, 0, 1}}) {
    ball.vertices.push_back(normalised(v));
  }
  ball.triangles = {{0, 11, 5},  {0, 5, 1},  {0, 1, 7},  {0, 7, 10}, {0, 10, 11}, {1, 5, 9}, {5, 11, 4},
                    {11, 10, 2}, {10, 7, 6}, {7, 1, 8},  {3, 9, 4},  {3, 4, 2},   {3, 2, 6}, {3, 6, 8},
                    {3, 8, 9},   {4, 9, 5},  {2, 4, 11}, {6, 2, 10}, {8, 6, 7},   {9, 8, 1}};
  for (int level = 0; level < detail; ++level) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
    const auto middle = [&](std::uint32_t a, std::uint32_t b) {
      const auto [it, added] = middles.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(ball.vertices.size()));
      if (added) ball.vertices.push_back(normalised(ball.vertices[a] + ball.vertices[b]));
      return it->second;
    };
    std::vector<std::array<std::uint32_t, 3>> finer;
    for (const auto& [a, b, c] : ball.triangles) {
      const std::uint32_t ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
      for (const auto& t :
           {std::array{a, ab, ca}, std::array{b, bc, ab}, std::array{c, ca, bc}, std::array{ab, bc, ca}})
        finer.push_back(t);
    }
    ball.triangles = std::move(finer);
  }
  return ball;
}

void append(std::string& out, Vec3 v) {
  for (int a = 0; a < 3; ++a) detail::append_number(out, static_cast<float>(v[a]));
}

constexpr int kFloat = 5126, kUint32 = 5125, kVertices = 34962, kIndices = 34963;

// The two chunks of a file as they grow. Every buffer view starts at a multiple of four bytes, as float32 and uint32
// arrays keep them. What is added returns its accessor's index.
struct Document {
  std::string views, accessors, data;
  int count = 0;

  // An array whose bytes were appended to `data` from `begin` on. `target` is kVertices for attributes of vertices,
  // kIndices for their indices, 0 for neither.
  std::string add(std::size_t begin, const char* type, int component, std::size_t elements, int target,
                  const std::string& more = {}) {
    const std::string comma = count > 0 ? "," : "";
    views += comma + "{\"buffer\":0,\"byteOffset\":" + std::to_string(begin) +
             ",\"byteLength\":" + std::to_string(data.size() - begin) +
             (target != 0 ? ",\"target\":" + std::to_string(target) : "") + "}";
    accessors += comma + "{\"bufferView\":" + std::to_string(count) +
                 ",\"componentType\":" + std::to_string(component) + ",\"count\":" + std::to_string(elements) +
                 ",\"type\":\"" + type + "\"" + more + "}";
    return std::to_string(count++);
  }

  std::string add_vectors(std::span<const Vec3> values, int target, Poll& poll, const std::string& more = {}) {
    const std::size_t begin = data.size();
    for (const Vec3& v : values) poll(4), append(data, v);
    return add(begin, "VEC3", kFloat, values.size(), target, more);
  }

  // The corners of the triangles of so many balls, whose vertices follow one another.
  std::string add_triangles(const Triangulation& ball, std::size_t balls, Poll& poll) {
    const std::size_t begin = data.size();
    for (std::size_t i = 0; i < balls; ++i) {
      for (const auto& triangle : ball.triangles) {
        poll(4);
        for (const std::uint32_t v : triangle)
          detail::append_number(data, static_cast<std::uint32_t>(i * ball.vertices.size() + v));
      }
    }
    return add(begin, "SCALAR", kUint32, 3 * balls * ball.triangles.size(), kIndices);
  }
};

// The least and greatest of each coordinate, as the numbers stand in the file.
std::string extent(std::span<const Vec3> points) {
  Box box;
  for (const Vec3& p : points) {
    box.include(Vec3{static_cast<float>(p.x), static_cast<float>(p.y), static_cast<float>(p.z)});
  }
  const auto list = [](Vec3 v) {
    std::string text;
    for (int a = 0; a < 3; ++a) text += (a > 0 ? "," : "") + detail::decimals({v[a]});
    return text;
  };
  return ",\"min\":[" + list(box.min) + "],\"max\":[" + list(box.max) + "]";
}

// One chunk: its length, its kind, its bytes padded to a multiple of four.
void append_chunk(std::string& out, const char* kind, std::string bytes, char padding) {
  bytes.append((4 - bytes.size() % 4) % 4, padding);
  detail::append_number(out, static_cast<std::uint32_t>(bytes.size()));
  out.append(kind, 4);
  out += bytes;
}

// The spheres that show, about the origin; where that was.
struct Centred {
  std::vector<Sphere> spheres;
  Vec3 middle;
};

Centred centred(std::span<const Sphere> all) {
  Centred shown;
  for (const Sphere& s : all)
    if (s.radius > 0) shown.spheres.push_back(s);
  if (shown.spheres.empty())
    throw Error(ErrorCode::unusable, "All spheres have radius 0, so there is nothing to show.");
  Box box;
  for (const Sphere& s : shown.spheres) box.include(s);
  shown.middle = 0.5 * (box.min + box.max);
  for (Sphere& s : shown.spheres) s.centre = s.centre - shown.middle;
  return shown;
}

// What the node says of its instances, or nothing; and the accessors of its mesh.
struct Node {
  std::string position, normal, index, instances;
};

// The triangles of the balls in `drawn`; instances of them, if any, for every one of `instances`.
Node add_node(const Triangulation& ball, std::span<const Sphere> drawn, std::span<const Sphere> instances, Poll& poll,
              Document& document) {
  std::vector<Vec3> positions, normals;
  for (const Sphere& s : drawn) {
    for (const Vec3& v : ball.vertices) {
      poll(2);
      positions.push_back(s.centre + s.radius * v);
      normals.push_back(v);
    }
  }
  Node node;
  node.position = document.add_vectors(positions, kVertices, poll, extent(positions));
  node.normal = document.add_vectors(normals, kVertices, poll);
  node.index = document.add_triangles(ball, drawn.size(), poll);
  if (instances.empty()) return node;
  std::vector<Vec3> centres, scales;
  for (const Sphere& s : instances) centres.push_back(s.centre), scales.push_back({s.radius, s.radius, s.radius});
  const std::string translation = document.add_vectors(centres, 0, poll), scale = document.add_vectors(scales, 0, poll);
  node.instances = ",\"extensions\":{\"EXT_mesh_gpu_instancing\":{\"attributes\":{\"TRANSLATION\":" + translation +
                   ",\"SCALE\":" + scale + "}}}";
  return node;
}

std::string json_of(const Node& node, Vec3 middle, const Document& document) {
  const std::string half = detail::decimals({std::sqrt(0.5)});
  const std::string moved = detail::decimals({middle.x / 1e3}) + "," + detail::decimals({middle.z / 1e3}) + "," +
                            detail::decimals({-middle.y / 1e3});
  const std::string extension = R"(["EXT_mesh_gpu_instancing"])";
  return R"({"asset":{"version":"2.0","generator":"Spherule","extras":{)"
         R"("accessors":"mm, LPS, from the node's translation","scene":"metres; x left, y head, z anterior"}},)" +
         (node.instances.empty() ? std::string()
                                 : R"("extensionsUsed":)" + extension + R"(,"extensionsRequired":)" + extension + ",") +
         R"("scene":0,"scenes":[{"nodes":[0]}],"nodes":[{"name":"spheres","mesh":0,"scale":[0.001,0.001,0.001],)"
         R"("rotation":[-)" +
         half + ",0,0," + half + R"(],"translation":[)" + moved + "]" + node.instances +
         R"(}],"meshes":[{"primitives":[{"attributes":{"POSITION":)" + node.position + R"(,"NORMAL":)" + node.normal +
         R"(},"indices":)" + node.index +
         R"(,"material":0}]}],"materials":[{"pbrMetallicRoughness":{"baseColorFactor":[0.8,0.8,0.8,1],)"
         R"("metallicFactor":0,"roughnessFactor":0.6}}],"buffers":[{"byteLength":)" +
         std::to_string(document.data.size()) + R"(}],"bufferViews":[)" + document.views + R"(],"accessors":[)" +
         document.accessors + "]}";
}

}  // namespace

std::string spheres_to_glb(std::span<const Sphere> all, const GlbOptions& options, const Context& context) {
  Poll poll(context);
  const auto [spheres, middle] = centred(all);
  const Triangulation ball = icosphere(options.detail);
  const bool instanced = options.style == GlbOptions::Style::instanced;
  if (!instanced && spheres.size() > max_glb_triangles / ball.triangles.size()) {
    throw Error(ErrorCode::too_large,
                "The mesh would have more than " + std::to_string(max_glb_triangles) +
                    " triangles; ask for a smaller detail, style=instanced, or a simplified model.");
  }
  Document document;
  const std::vector<Sphere> unit{{{}, 1}};
  const Node node =
      instanced ? add_node(ball, unit, spheres, poll, document) : add_node(ball, spheres, {}, poll, document);
  std::string chunks;
  append_chunk(chunks, "JSON", json_of(node, middle, document), ' ');
  append_chunk(chunks, "BIN\0", std::move(document.data), '\0');
  std::string out = "glTF";
  detail::append_number(out, std::uint32_t{2});
  detail::append_number(out, static_cast<std::uint32_t>(12 + chunks.size()));
  return out + chunks;
}

}  // namespace spherule
