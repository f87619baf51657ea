// SPDX-License-Identifier: GPL-3.0-or-later
#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <sstream>
#include <vector>

#include "core/base/check.h"
#include "core/base/error.h"
#include "core/base/parallel.h"
#include "core/io/export_grids.h"

namespace spherule {
namespace {

constexpr std::int32_t kBlock = 8;           // voxels along a leaf of OpenVDB's tree
constexpr std::int32_t kLongest = 1 << 20;   // voxels along an axis
constexpr double kSlack = 1e-6;              // voxels; rounding of coordinates up to kLongest is far below
constexpr std::size_t kParallelCubes = 512;  // enough pieces to share out
constexpr std::size_t kFew = 8;              // balls that are looked at sooner than chosen among
constexpr double kEdgePiece = 0.125;         // voxels; of edges that are looked for
constexpr std::size_t kMostWithEdges = std::size_t{1} << 16;  // balls
constexpr std::int32_t kBins = 4;                             // along a block, of its edges

using Index = std::array<std::int32_t, 3>;

// A cube of voxels and the balls that can decide a value in it: none where all are out of reach.
struct Cube {
  Index low{0, 0, 0};
  std::int32_t size = 0;
  std::vector<std::uint32_t> balls{};
  bool deep = false;  // farther inside than the band
};

// A place where two spheres meet on the union's surface.
struct Edge {
  Vec3 at;
  std::uint32_t first, second;  // their balls
};

struct Block {
  Index low;
  std::array<float, kBlock * kBlock * kBlock> values;  // mm, z fastest as in OpenVDB
  std::vector<std::uint32_t> balls{};                  // of its cube
  std::vector<Edge> edges{};                           // a piece apart or less, by bins
  std::array<std::uint32_t, kBins * kBins * kBins + 1> bin_begin{};
};

// The distance to a cube, 0 in it.
double distance(Vec3 p, Vec3 low, double size) {
  Vec3 beyond;
  for (int a = 0; a < 3; ++a) beyond[a] = std::max({low[a] - p[a], p[a] - low[a] - size, 0.0});
  return norm(beyond);
}

// What a part of space comes to: blocks near the surface, and cubes that lie deep inside.
struct Part {
  std::vector<std::unique_ptr<Block>> blocks;
  std::vector<Cube> deep;
};

class Builder {
 public:
  // `balls` in voxels.
  Builder(std::span<const Sphere> balls, double voxel_mm, std::size_t most_blocks)
      : balls_(balls), voxel_mm_(voxel_mm), most_blocks_(most_blocks) {}

  std::vector<Part> build(std::int32_t size, const Context& context) {
    Cube root{.size = size, .balls = std::vector<std::uint32_t>(balls_.size())};
    for (std::uint32_t i = 0; i < root.balls.size(); ++i) root.balls[i] = i;
    std::vector<Cube> cubes;
    cubes.push_back(std::move(root));
    std::vector<Part> parts(1);
    while (!cubes.empty() && cubes.front().size > kBlock && cubes.size() < kParallelCubes) {
      std::vector<std::vector<Cube>> finer(cubes.size());
      std::vector<Part> found(cubes.size());
      parallel_for(context, "", cubes.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) divide(cubes[i], found[i], finer[i]);
      });
      cubes.clear();
      for (std::vector<Cube>& list : finer) std::ranges::move(list, std::back_inserter(cubes));
      for (Part& part : found) std::ranges::move(part.deep, std::back_inserter(parts[0].deep));
    }
    parts.resize(1 + cubes.size());
    parallel_for(context, "level set", cubes.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        descend(cubes[i], parts[1 + i]);
        cubes[i] = {};
      }
    });
    if (has_edges()) measure_insides(parts, context);
    return parts;
  }

 private:
  double field(std::uint32_t ball, Vec3 at) const { return norm(at - balls_[ball].centre) - balls_[ball].radius; }

  // The eighths of a cube. The field changes by at most the distance that one goes: within a radius about a middle
  // where its least is d, it stays within d ± radius; balls that are above d + 2 · radius there are the deepest nowhere
  // in it, and those above band + radius are out of reach. All that holds for the voxels' own cubes, too.
  std::array<Cube, 8> eighths(const Cube& cube) const {
    std::array<Cube, 8> parts;
    const std::int32_t half = cube.size / 2;
    const double radius = std::sqrt(3.0) / 2 * half + kSlack;
    std::vector<double> values(cube.balls.size());
    for (std::size_t corner = 0; corner < 8; ++corner) {
      Cube& part = parts[corner];
      part.size = half;
      Vec3 middle;
      for (int a = 0; a < 3; ++a) {
        const auto axis = static_cast<std::size_t>(a);
        part.low[axis] = cube.low[axis] + static_cast<std::int32_t>(corner >> a & 1) * half;
        middle[a] = part.low[axis] + 0.5 * (half - 1);
      }
      double least = std::numeric_limits<double>::infinity();
      for (std::size_t i = 0; i < values.size(); ++i) {
        values[i] = field(cube.balls[i], middle);
        least = std::min(least, values[i]);
      }
      part.deep = least < -level_set_band - radius;
      if (part.deep) {
        // Any one of them tells that all is inside.
        part.balls.push_back(cube.balls[static_cast<std::size_t>(std::ranges::min_element(values) - values.begin())]);
        continue;
      }
      const double most = std::min(least + 2 * radius, level_set_band + radius);
      for (std::size_t i = 0; i < values.size(); ++i) {
        if (values[i] <= most) part.balls.push_back(cube.balls[i]);
      }
    }
    return parts;
  }

  // Puts the eighths that the surface may pass near into `finer`.
  void divide(const Cube& cube, Part& part, std::vector<Cube>& finer) const {
    for (Cube& eighth : eighths(cube)) {
      if (eighth.deep) {
        part.deep.push_back({.low = eighth.low, .size = eighth.size, .balls = {}});
      } else if (!eighth.balls.empty()) {
        finer.push_back(std::move(eighth));
      }
    }
  }

  void descend(const Cube& cube, Part& part) {
    if (cube.size == kBlock) {
      fill(cube, part);
      return;
    }
    std::vector<Cube> finer;
    divide(cube, part, finer);
    for (const Cube& eighth : finer) descend(eighth, part);
  }

  void fill(const Cube& cube, Part& part) {
    auto block = std::make_unique<Block>();
    block->low = cube.low;
    evaluate(cube, *block);
    const auto [least, greatest] = std::ranges::minmax(block->values);
    const auto band = static_cast<float>(level_set_band * voxel_mm_);
    if (least == band) return;
    if (greatest == -band) {
      part.deep.push_back({.low = cube.low, .size = kBlock, .balls = {}});
      return;
    }
    if (++blocks_ > most_blocks_) {
      throw Error(ErrorCode::too_large,
                  "The level set would take more memory than allowed; ask for a larger voxel_mm.");
    }
    block->balls = cube.balls;
    constexpr double half = 0.5 * kBlock;
    const Vec3 middle{cube.low[0] + half - 0.5, cube.low[1] + half - 0.5, cube.low[2] + half - 0.5};
    if (has_edges()) find_edges(middle, half, block->balls, block->edges);
    sort_edges(*block);
    part.blocks.push_back(std::move(block));
  }

  // Sets the values of a part of a block, halved on as long as that leaves out balls.
  void evaluate(const Cube& cube, Block& block) const {
    if (cube.size > 1 && cube.balls.size() > kFew) {
      for (const Cube& eighth : eighths(cube)) evaluate(eighth, block);
      return;
    }
    for (std::int32_t x = cube.low[0]; x < cube.low[0] + cube.size; ++x) {
      for (std::int32_t y = cube.low[1]; y < cube.low[1] + cube.size; ++y) {
        for (std::int32_t z = cube.low[2]; z < cube.low[2] + cube.size; ++z) {
          double value = level_set_band;
          for (const std::uint32_t ball : cube.balls)
            value = std::min(value, field(ball, {double(x), double(y), double(z)}));
          const auto n = ((x - block.low[0]) * kBlock + (y - block.low[1])) * kBlock + (z - block.low[2]);
          block.values[static_cast<std::size_t>(n)] = static_cast<float>(std::max(value, -level_set_band) * voxel_mm_);
        }
      }
    }
  }

  bool has_edges() const { return balls_.size() <= kMostWithEdges; }

  // Inside, the depth in the deepest ball is the distance to its own sphere. Where the nearest point of that sphere is
  // on the union's surface, nothing of the surface is nearer; else what is nearest are edges, for the nearest point of
  // any other sphere is farther than that. Edges are found by halving space on where two spheres pass and the surface
  // does.
  void find_edges(Vec3 middle, double half, std::span<const std::uint32_t> balls, std::vector<Edge>& edges) const {
    const double radius = std::sqrt(3.0) * half + kSlack;
    std::vector<double> values(balls.size());
    double least = std::numeric_limits<double>::infinity();
    for (std::size_t i = 0; i < balls.size(); ++i) {
      values[i] = field(balls[i], middle);
      least = std::min(least, values[i]);
    }
    if (std::abs(least) > radius) return;
    std::vector<std::uint32_t> near, passing;
    for (std::size_t i = 0; i < balls.size(); ++i) {
      if (values[i] <= least + 2 * radius) near.push_back(balls[i]);
      if (std::abs(values[i]) <= radius) passing.push_back(balls[i]);
    }
    if (passing.size() < 2) return;
    if (2 * half <= kEdgePiece) {
      for (std::size_t i = 0; i < passing.size(); ++i) {
        for (std::size_t j = i + 1; j < passing.size(); ++j) {
          const auto at = on_both(passing[i], passing[j], middle);
          if (!at || norm(*at - middle) > radius || !on_surface(*at, near)) continue;
          edges.push_back({*at, passing[i], passing[j]});
          return;
        }
      }
      return;
    }
    for (unsigned corner = 0; corner < 8; ++corner) {
      Vec3 part = middle;
      for (int a = 0; a < 3; ++a) part[a] += (corner >> a & 1) != 0 ? 0.5 * half : -0.5 * half;
      find_edges(part, 0.5 * half, near, edges);
    }
  }

  // The point nearest to `from` of the circle that two spheres share, if there is one.
  std::optional<Vec3> on_both(std::uint32_t first, std::uint32_t second, Vec3 from) const {
    const Sphere &a = balls_[first], &b = balls_[second];
    const Vec3 apart = b.centre - a.centre;
    const double distance = norm(apart);
    if (distance == 0) return std::nullopt;
    const Vec3 axis = (1 / distance) * apart;
    const double along = (distance * distance + (a.radius - b.radius) * (a.radius + b.radius)) / (2 * distance);
    const double squared = (a.radius - along) * (a.radius + along);
    const Vec3 across = from - a.centre - dot(from - a.centre, axis) * axis;
    if (squared < 0 || norm(across) == 0) return std::nullopt;
    return a.centre + along * axis + (std::sqrt(squared) / norm(across)) * across;
  }

  bool on_surface(Vec3 at, std::span<const std::uint32_t> balls) const {
    return std::ranges::none_of(balls, [&](std::uint32_t ball) { return field(ball, at) < -kSlack; });
  }

  static std::size_t bin_of(const Block& block, Vec3 at) {
    std::size_t bin = 0;
    for (int a = 0; a < 3; ++a) {
      const double place = (at[a] + 0.5 - block.low[static_cast<std::size_t>(a)]) * kBins / kBlock;
      bin = kBins * bin + static_cast<std::size_t>(std::clamp(place, 0.0, kBins - 1.0));
    }
    return bin;
  }
  static void sort_edges(Block& block) {
    std::ranges::stable_sort(block.edges, {}, [&](const Edge& edge) { return bin_of(block, edge.at); });
    for (const Edge& edge : block.edges) ++block.bin_begin[bin_of(block, edge.at) + 1];
    for (std::size_t bin = 1; bin < block.bin_begin.size(); ++bin) block.bin_begin[bin] += block.bin_begin[bin - 1];
  }

  // Makes depths into distances to the surface.
  void measure_insides(std::vector<Part>& parts, const Context& context) const {
    std::map<Index, const Block*> places;
    std::vector<Block*> blocks;
    for (Part& part : parts) {
      for (const auto& block : part.blocks) {
        places.emplace(block->low, block.get());
        blocks.push_back(block.get());
      }
    }
    parallel_for(context, "level set", blocks.size(), 16, [&](std::size_t begin, std::size_t end) {
      for (std::size_t b = begin; b < end; ++b) measure_inside(*blocks[b], places);
    });
  }

  void measure_inside(Block& block, const std::map<Index, const Block*>& places) const {
    std::array<const Block*, 27> around{};
    for (std::size_t n = 0; n < around.size(); ++n) {
      const std::array<std::size_t, 3> step{n / 9, n / 3 % 3, n % 3};
      Index low = block.low;
      for (std::size_t a = 0; a < 3; ++a) low[a] += kBlock * (static_cast<std::int32_t>(step[a]) - 1);
      const auto found = places.find(low);
      if (found != places.end()) around[n] = found->second;
    }
    for (std::size_t n = 0; n < block.values.size(); ++n) {
      const double depth = -block.values[n] / voxel_mm_;
      if (!(depth > 0 && depth < level_set_band)) continue;
      const auto i = static_cast<std::int32_t>(n);
      const std::int32_t x = block.low[0] + i / (kBlock * kBlock), y = block.low[1] + i / kBlock % kBlock,
                         z = block.low[2] + i % kBlock;
      const Vec3 at{double(x), double(y), double(z)};
      const std::uint32_t deepest =
          *std::ranges::min_element(block.balls, {}, [&](std::uint32_t ball) { return field(ball, at); });
      if (!own_sphere_is_nearest(at, balls_[deepest], block, around)) {
        block.values[n] = static_cast<float>(-distance_to_edges(at, block, around) * voxel_mm_);
      }
    }
  }

  // In the middle of a ball, all of its sphere is.
  bool own_sphere_is_nearest(Vec3 at, const Sphere& ball, const Block& own,
                             const std::array<const Block*, 27>& around) const {
    const Vec3 from = at - ball.centre;
    if (norm(from) == 0) return true;
    const Vec3 nearest = ball.centre + (ball.radius / norm(from)) * from;
    std::size_t n = 0;
    for (int a = 0; a < 3; ++a) {
      const double block = std::floor((nearest[a] + 0.5 - own.low[static_cast<std::size_t>(a)]) / kBlock);
      n = 3 * n + static_cast<std::size_t>(block + 1);
    }
    // Without a block, it is deep inside.
    return around[n] != nullptr && on_surface(nearest, around[n]->balls);
  }

  // At most the band.
  double distance_to_edges(Vec3 at, const Block& own, const std::array<const Block*, 27>& around) const {
    double least = level_set_band;
    const Edge* nearest = nullptr;
    const auto look = [&](const Block& block) {
      const auto low_of = [](const Index& low) { return Vec3{low[0] - 0.5, low[1] - 0.5, low[2] - 0.5}; };
      if (block.edges.empty() || distance(at, low_of(block.low), kBlock) >= least) return;
      for (std::size_t bin = 0; bin + 1 < block.bin_begin.size(); ++bin) {
        if (block.bin_begin[bin] == block.bin_begin[bin + 1]) continue;
        constexpr double size = double(kBlock) / kBins;
        const std::size_t x = bin / (kBins * kBins), y = bin / kBins % kBins, z = bin % kBins;
        const Vec3 corner{double(x), double(y), double(z)};
        if (distance(at, low_of(block.low) + size * corner, size) >= least) continue;
        for (std::uint32_t e = block.bin_begin[bin]; e < block.bin_begin[bin + 1]; ++e) {
          const double far = norm(block.edges[e].at - at);
          if (far >= least) continue;
          least = far;
          nearest = &block.edges[e];
        }
      }
    };
    look(own);
    for (const Block* block : around) {
      if (block != nullptr && block != &own) look(*block);
    }
    if (nearest == nullptr) return least;
    // Between the places that were found, the circle itself.
    const auto closer = on_both(nearest->first, nearest->second, at);
    if (closer && norm(*closer - nearest->at) <= 2 * kEdgePiece) least = std::min(least, norm(*closer - at));
    return least;
  }

  std::span<const Sphere> balls_;
  double voxel_mm_;
  std::size_t most_blocks_;
  std::atomic<std::size_t> blocks_{0};
};

openvdb::Coord coord(const Index& i) { return {i[0], i[1], i[2]}; }

void add(openvdb::FloatTree& tree, const Part& part, float background) {
  using Leaf = openvdb::FloatTree::LeafNodeType;
  for (const auto& block : part.blocks) {
    auto leaf = std::make_unique<Leaf>(coord(block->low), background, false);
    for (openvdb::Index n = 0; n < Leaf::SIZE; ++n) {
      const float value = block->values[n];
      leaf->setValueOnly(n, value);
      if (std::abs(value) < background) leaf->setValueOn(n);
    }
    tree.addLeaf(leaf.release());
  }
  // The tree's nodes hold 8³, 128³ and 4096³ voxels.
  constexpr std::array<std::int32_t, 3> sizes{8, 128, 4096};
  for (const Cube& cube : part.deep) {
    openvdb::Index level = 0;
    while (level + 1 < sizes.size() && sizes[level + 1] <= cube.size) ++level;
    const std::int32_t step = sizes[level];
    for (std::int32_t x = 0; x < cube.size; x += step) {
      for (std::int32_t y = 0; y < cube.size; y += step) {
        for (std::int32_t z = 0; z < cube.size; z += step) {
          tree.addTile(level + 1, coord({cube.low[0] + x, cube.low[1] + y, cube.low[2] + z}), -background, false);
        }
      }
    }
  }
}

// Writes to memory what a file would hold.
class Memory : public openvdb::io::Archive {
 public:
  std::string write_grid(const openvdb::GridBase::Ptr& grid) const {
    std::ostringstream out(std::ios::binary);
    write(out, openvdb::GridCPtrVec{grid}, /*seekable=*/true);
    return std::move(out).str();
  }
};

// Every archive begins with a random UUID, in characters; ours says what is in it.
void name_by_content(std::string& bytes) {
  constexpr std::size_t at = 21, length = 36;  // after magic, file and library version, and the flag of offsets
  SPHERULE_CHECK(bytes.size() > at + length && bytes[at + 8] == '-' && bytes[at + 23] == '-');
  std::uint64_t hash = 0xcbf29ce484222325U;  // FNV-1a
  for (const char c : std::string_view(bytes).substr(at + length)) {
    hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
  }
  for (std::size_t i = 0; i < length; ++i) {
    if (bytes[at + i] == '-') continue;
    bytes[at + i] = "0123456789abcdef"[hash & 15];
    hash = (hash >> 4) | (hash << 60);
  }
}

}  // namespace

std::string spheres_to_vdb(std::span<const Sphere> spheres, double voxel_mm, std::size_t most_blocks,
                           const Context& context) {
  SPHERULE_CHECK(!spheres.empty());
  if (!(voxel_mm > 0) || !std::isfinite(voxel_mm)) {
    throw Error(ErrorCode::invalid_argument, "Give a voxel_mm above 0.");
  }
  Box box;
  for (const Sphere& s : spheres) box.include(s);
  const double margin = (level_set_band + 1) * voxel_mm;
  const Vec3 origin = box.min - Vec3{margin, margin, margin}, extent = box.max - box.min;
  const double longest = std::max({extent.x, extent.y, extent.z}) / voxel_mm + 2 * (level_set_band + 1) + 1;
  if (longest > kLongest) {
    throw Error(ErrorCode::too_large,
                "The level set would have too many voxels along an axis; ask for a larger voxel_mm.");
  }
  std::int32_t size = 2 * kBlock;
  while (size < longest) size *= 2;
  std::vector<Sphere> balls;
  balls.reserve(spheres.size());
  for (const Sphere& s : spheres) balls.push_back({(1 / voxel_mm) * (s.centre - origin), s.radius / voxel_mm});
  const std::vector<Part> parts = Builder(balls, voxel_mm, most_blocks).build(size, context);

  openvdb::initialize();  // safe to call again and from several threads
  // Made by the library, and all that is virtual called through the base: to compile a grid's every function here would
  // take minutes.
  const openvdb::GridBase::Ptr grid = openvdb::GridBase::createGrid(openvdb::FloatGrid::gridType());
  auto& tree = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)->tree();
  const auto background = static_cast<float>(level_set_band * voxel_mm);
  tree.root().setBackground(background, /*updateChildNodes=*/false);
  for (const Part& part : parts) add(tree, part, background);
  const auto transform = openvdb::math::Transform::createLinearTransform(voxel_mm);
  transform->postTranslate({origin.x, origin.y, origin.z});
  grid->setTransform(transform);
  grid->setName("spheres");
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  grid->setCreator("Spherule");
  grid->insertMeta("units", openvdb::StringMetadata("mm"));
  grid->insertMeta("frame", openvdb::StringMetadata("LPS"));
  std::string bytes = Memory().write_grid(grid);
  name_by_content(bytes);
  return bytes;
}

}  // namespace spherule
