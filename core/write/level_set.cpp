// SPDX-License-Identifier: GPL-3.0-or-later
#include <openvdb/io/Archive.h>
#include <openvdb/openvdb.h>
#include <tbb/task_group.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <limits>
#include <memory>
#include <set>
#include <sstream>
#include <stop_token>
#include <tuple>
#include <utility>
#include <vector>

#include "core/base/check.h"
#include "core/base/error.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/base/ranges.h"
#include "core/write/export_grids.h"

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
  Builder(std::span<const Sphere> balls, double voxel_mm, std::size_t most_blocks, const Context& context)
      : balls_(balls), voxel_mm_(voxel_mm), most_blocks_(most_blocks), context_(context) {}

  std::vector<Part> build(std::int32_t size) {
    Cube root{.size = size, .balls = std::vector<std::uint32_t>(balls_.size())};
    for (std::uint32_t i = 0; i < root.balls.size(); ++i) root.balls[i] = i;
    std::vector<Cube> cubes;
    cubes.push_back(std::move(root));
    std::vector<Part> parts(1);
    while (!cubes.empty() && cubes.front().size > kBlock && cubes.size() < kParallelCubes) {
      std::vector<std::vector<Cube>> finer(cubes.size());
      std::vector<Part> found(cubes.size());
      parallel_for(context_, "", cubes.size(), 1, [&](std::size_t begin, std::size_t end) {
        for (std::size_t i = begin; i < end; ++i) divide(cubes[i], found[i], finer[i]);
      });
      cubes.clear();
      for (std::vector<Cube>& list : finer) std::ranges::move(list, std::back_inserter(cubes));
      for (Part& part : found) std::ranges::move(part.deep, std::back_inserter(parts[0].deep));
    }
    parts.resize(1 + cubes.size());
    parallel_for(context_, "level set", cubes.size(), 1, [&](std::size_t begin, std::size_t end) {
      for (std::size_t i = begin; i < end; ++i) {
        descend(cubes[i], parts[1 + i]);
        cubes[i] = {};
      }
    });
    return parts;
  }

 private:
  double field(std::uint32_t ball, Vec3 at) const { return norm(at - balls_[ball].centre) - balls_[ball].radius; }

  // Whether a ball can be deeper than the deepest one of a cube's middle somewhere in the cube. Their fields differ by
  // f there, and by at least the difference of radii less that of the centres anywhere. On the way to a place within
  // `radius` f falls by at most the difference of the two directions to the centres times the way: |a/|a| - b/|b|| is
  // at most 2 |a - b| / (|a| + |b|) (C. Dunkl, K. Williams, 1964). So balls that almost coincide do not pile up.
  bool competes(std::uint32_t ball, std::uint32_t deepest, Vec3 middle, double radius) const {
    if (ball == deepest) return true;
    const Sphere &one = balls_[ball], &other = balls_[deepest];
    const double apart = norm(one.centre - other.centre);
    if (other.radius - one.radius >= apart) return false;
    const double to_one = norm(middle - one.centre), to_other = norm(middle - other.centre);
    const double f = (to_one - one.radius) - (to_other - other.radius), sum = to_one + to_other - 2 * radius;
    return f <= radius * (sum > apart ? 2 * apart / sum : 2);
  }

  // The eighths of a cube. The field changes by at most the distance that one goes: within a radius about a middle
  // where its least is d, it stays within d ± radius; balls that are above band + radius there are out of reach. All
  // that holds for the voxels' own cubes, too.
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
      for (std::size_t i = 0; i < values.size(); ++i) values[i] = field(cube.balls[i], middle);
      const auto at = std::ranges::min_element(values);
      const double least = *at;
      const std::uint32_t deepest = cube.balls[static_cast<std::size_t>(at - values.begin())];
      part.deep = least < -level_set_band - radius;
      if (part.deep) {
        part.balls.push_back(deepest);  // any one of them tells that all is inside
        continue;
      }
      const double most = std::min(least + 2 * radius, level_set_band + radius);
      for (std::size_t i = 0; i < values.size(); ++i) {
        if (values[i] <= most && competes(cube.balls[i], deepest, middle, radius)) part.balls.push_back(cube.balls[i]);
      }
    }
    return parts;
  }

  // Puts the eighths that the surface may pass near into `finer`.
  void divide(const Cube& cube, Part& part, std::vector<Cube>& finer) const {
    context_.throw_if_cancelled();
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
    context_.throw_if_cancelled();
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
  const Context& context_;
  std::atomic<std::size_t> blocks_{0};
};

// The balls in voxels from the origin, each once.
std::vector<Sphere> in_voxels(std::span<const Sphere> spheres, Vec3 origin, double voxel_mm) {
  std::vector<Sphere> balls;
  balls.reserve(spheres.size());
  for (const Sphere& s : spheres) balls.push_back({(1 / voxel_mm) * (s.centre - origin), s.radius / voxel_mm});
  std::ranges::sort(balls, {},
                    [](const Sphere& s) { return std::tuple(s.centre.x, s.centre.y, s.centre.z, s.radius); });
  const auto same = std::ranges::unique(balls);
  balls.erase(same.begin(), same.end());
  return balls;
}

// Blocks far apart have nodes of the tree to themselves, which take far more than the blocks: pointers to 16³ blocks,
// and to 32³ of those.
void check_nodes(const std::vector<Part>& parts, std::size_t most_blocks) {
  constexpr std::array<std::size_t, 2> bytes{std::size_t{9} << 12, std::size_t{9} << 15};
  constexpr std::array<int, 2> log_size{7, 12};
  std::array<std::set<Index>, 2> nodes;
  std::size_t total = 0;
  const auto add = [&](Index low, std::size_t level) {
    for (std::int32_t& i : low) i >>= log_size[level];
    if (nodes[level].insert(low).second) total += bytes[level];
    if (total > most_blocks * sizeof(Block)) {
      throw Error(ErrorCode::too_large,
                  "The spheres lie too far apart for a level set of such voxels; ask for a larger voxel_mm.");
    }
  };
  for (const Part& part : parts) {
    for (const auto& block : part.blocks) add(block->low, 0), add(block->low, 1);
    for (const Cube& cube : part.deep) add(cube.low, 0), add(cube.low, 1);
  }
}

openvdb::Coord coord(const Index& i) { return {i[0], i[1], i[2]}; }

void add(openvdb::FloatTree& tree, const Part& part, float background, const Context& context) {
  using Leaf = openvdb::FloatTree::LeafNodeType;
  for (const auto& block : part.blocks) {
    context.throw_if_cancelled();
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
        context.throw_if_cancelled();
        for (std::int32_t z = 0; z < cube.size; z += step) {
          tree.addTile(level + 1, coord({cube.low[0] + x, cube.low[1] + y, cube.low[2] + z}), -background, false);
        }
      }
    }
  }
}

// Memory to write to, which hears a cancellation with every piece.
class HearingBuffer : public std::stringbuf {
 public:
  explicit HearingBuffer(const Context& context)
      : std::stringbuf(std::ios::out | std::ios::binary), context_(context) {}

 protected:
  std::streamsize xsputn(const char* bytes, std::streamsize count) override {
    context_.throw_if_cancelled();
    return std::stringbuf::xsputn(bytes, count);
  }

 private:
  const Context& context_;
};

// Writes to memory what a file would hold.
class Memory : public openvdb::io::Archive {
 public:
  std::string write_grid(const openvdb::GridBase::Ptr& grid, const Context& context) const {
    HearingBuffer buffer(context);
    std::ostream out(&buffer);
    out.exceptions(std::ios::badbit);  // what the buffer throws is not swallowed
    // The library packs all leaves once for their sizes, before it writes the first byte.
    tbb::task_group_context group;
    const std::stop_callback stop(context.cancel, [&] { group.cancel_group_execution(); });
    tbb::task_group(group).run_and_wait([&] { write(out, openvdb::GridCPtrVec{grid}, /*seekable=*/true); });
    context.throw_if_cancelled();  // which a group that is cancelled does not pass on
    return std::move(buffer).str();
  }
};

// Every archive begins with a random UUID, in characters; ours says what is in it.
void name_by_content(std::string& bytes, const Context& context) {
  constexpr std::size_t at = 21, length = 36;  // after magic, file and library version, and the flag of offsets
  SPHERULE_CHECK(bytes.size() > at + length && bytes[at + 8] == '-' && bytes[at + 23] == '-');
  std::uint64_t hash = 0xcbf29ce484222325U;  // FNV-1a
  Poll poll(context, 1U << 20);
  for (const char c : std::string_view(bytes).substr(at + length)) {
    poll();
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
  if (!(voxel_mm >= min_level_set_voxel_mm && voxel_mm <= ranges::voxel_mm.most)) {
    throw Error(ErrorCode::invalid_argument, "Give a voxel_mm of 2e-5 to 1e9, which OpenVDB can bear.");
  }
  Box box;
  for (const Sphere& s : spheres) box.include(s);
  const double margin = (level_set_band + 1) * voxel_mm;
  const Vec3 origin = box.min - Vec3{margin, margin, margin}, extent = box.max - box.min;
  const double longest = std::max({extent.x, extent.y, extent.z}) / voxel_mm + 2 * (level_set_band + 1) + 1;
  // Of fewer than 2^12 units in the last place of the farthest coordinate, voxels would begin to show its rounding.
  double farthest = 0;
  for (int a = 0; a < 3; ++a) farthest = std::max({farthest, std::abs(box.min[a]), std::abs(box.max[a])});
  if (longest > kLongest || farthest * 0x1p-40 > voxel_mm) {
    throw Error(ErrorCode::too_large,
                "The level set would have too many voxels along an axis, or voxels too fine for places so far from the "
                "origin; ask for a larger voxel_mm.");
  }
  std::int32_t size = 2 * kBlock;
  while (size < longest) size *= 2;
  const std::vector<Sphere> balls = in_voxels(spheres, origin, voxel_mm);
  std::vector<Part> parts = Builder(balls, voxel_mm, most_blocks, context).build(size);
  check_nodes(parts, most_blocks);

  openvdb::initialize();  // safe to call again and from several threads
  // Made by the library, and all that is virtual called through the base: to compile a grid's every function here would
  // take minutes.
  const openvdb::GridBase::Ptr grid = openvdb::GridBase::createGrid(openvdb::FloatGrid::gridType());
  auto& tree = openvdb::gridPtrCast<openvdb::FloatGrid>(grid)->tree();
  const auto background = static_cast<float>(level_set_band * voxel_mm);
  tree.root().setBackground(background, /*updateChildNodes=*/false);
  for (Part& part : parts) add(tree, std::exchange(part, {}), background, context);
  const auto transform = openvdb::math::Transform::createLinearTransform(voxel_mm);
  transform->postTranslate({origin.x, origin.y, origin.z});
  grid->setTransform(transform);
  grid->setName("spheres");
  grid->setGridClass(openvdb::GRID_LEVEL_SET);
  grid->setCreator("Spherule");
  grid->insertMeta("units", openvdb::StringMetadata("mm"));
  grid->insertMeta("frame", openvdb::StringMetadata("LPS"));
  std::string bytes = Memory().write_grid(grid, context);
  name_by_content(bytes, context);
  return bytes;
}

}  // namespace spherule
