// SPDX-License-Identifier: GPL-3.0-or-later
#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstring>
#include <memory>
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

using Index = std::array<std::int32_t, 3>;

// A cube of voxels and the balls that can decide a value in it: none where all are out of reach.
struct Cube {
  Index low{0, 0, 0};
  std::int32_t size = 0;
  std::vector<std::uint32_t> balls{};
  bool deep = false;  // farther inside than the band
};

struct Block {
  Index low;
  std::array<float, kBlock * kBlock * kBlock> values;  // mm, z fastest as in OpenVDB
};

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
    return parts;
  }

 private:
  double field(std::uint32_t ball, Vec3 at) const { return norm(at - balls_[ball].centre) - balls_[ball].radius; }

  // The eighths of a cube. The field changes by at most the distance that one goes: within a radius about a middle
  // where its least is d, it stays within d ± radius; balls that are above d + 2 · radius there are the deepest nowhere
  // in it, and those above band + radius are out of reach.
  std::array<Cube, 8> eighths(const Cube& cube) const {
    std::array<Cube, 8> parts;
    const std::int32_t half = cube.size / 2;
    const double side = half - 1, radius = std::sqrt(3.0) / 2 * side + kSlack;
    std::vector<double> values(cube.balls.size());
    for (std::size_t corner = 0; corner < 8; ++corner) {
      Cube& part = parts[corner];
      part.size = half;
      Vec3 middle;
      for (int a = 0; a < 3; ++a) {
        const auto axis = static_cast<std::size_t>(a);
        part.low[axis] = cube.low[axis] + static_cast<std::int32_t>(corner >> a & 1) * half;
        middle[a] = part.low[axis] + side / 2;
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
