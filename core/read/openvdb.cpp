// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/openvdb.h"

#include <openvdb/openvdb.h>

#include <algorithm>
#include <new>
#include <optional>
#include <stdexcept>

#include "core/base/check.h"
#include "core/read/openvdb_file.h"
#include "core/read/openvdb_tree.h"
#include "core/read/read_bytes.h"

namespace spherule {

namespace {

using vdb::File, vdb::GridEntry, vdb::GridHead, vdb::GridType, vdb::Stream, vdb::TreeExtent, vdb::TreePlace;

[[noreturn]] void refuse(const File& file, ErrorCode code, std::string sentence) {
  if (!file.grids.empty()) sentence += "; the file's grids are " + vdb::list_of_grids(file);
  throw Error(code, sentence + ".");
}

VoxelType voxel_type_of(const GridType& type) {
  if (type.leaf != GridType::Leaf::values) return VoxelType::uint8;
  if (type.name == "int32") return VoxelType::int32;
  if (type.name == "int64") return VoxelType::int64;
  return type.bytes == 4 ? VoxelType::float32 : VoxelType::float64;
}

struct Choice {
  std::size_t index = 0;
  GridHead head;
  TreePlace place;
  TreeExtent extent;
  bool after_empty = false;  // it is only the first one with active voxels
};

bool is_scalar(const GridEntry& grid) { return grid.type != nullptr && grid.type->scalar; }

Choice with_extent(Stream& stream, const File& file, std::size_t index, const Context& context) {
  const GridEntry &grid = file.grids[index], &with_tree = file.grids[grid.tree];
  Choice choice;
  choice.index = index;
  choice.head = vdb::read_head(stream, file, grid);
  std::uint32_t compression = choice.head.compression;
  if (grid.tree != index) compression = vdb::read_head(stream, file, with_tree).compression;
  choice.place = {with_tree.type, compression, with_tree.half, stream.position()};
  choice.extent = vdb::measure_tree(stream, choice.place, context);
  return choice;
}

// The grid that is asked for, else the first scalar one with active voxels.
Choice choose(Stream& stream, const File& file, const ReadOptions& options, const Context& context) {
  if (!options.grid.empty()) {
    const auto found = std::ranges::find(file.grids, options.grid, &GridEntry::name);
    if (found == file.grids.end()) {
      refuse(file, ErrorCode::not_found, "The OpenVDB file has no grid of that name; leave out grid for the first one");
    }
    if (!is_scalar(*found)) {
      refuse(file, ErrorCode::unusable,
             "The chosen OpenVDB grid is not a scalar one (bool, mask, int32, int64, float or double); choose another");
    }
    Choice choice = with_extent(stream, file, static_cast<std::size_t>(found - file.grids.begin()), context);
    if (choice.extent.active > 0) return choice;
    refuse(file, ErrorCode::unusable, "The chosen OpenVDB grid has no active voxel; choose another");
  }
  bool some = false;
  for (std::size_t i = 0; i < file.grids.size(); ++i) {
    if (!is_scalar(file.grids[i])) continue;
    Choice choice = with_extent(stream, file, i, context);
    choice.after_empty = some;
    if (choice.extent.active > 0) return choice;
    some = true;
  }
  if (some) {
    refuse(file, ErrorCode::unusable, "The OpenVDB grid has no active voxel; activate the voxels of the object");
  }
  refuse(file, ErrorCode::unusable,
         "The OpenVDB file has no scalar grid (bool, mask, int32, int64, float or double); convert points or vectors "
         "first");
}

// The box of the active voxels and a layer around, once it is bounded.
std::array<std::int32_t, 3> dims_of(const File& file, const Choice& choice, VoxelType type, const ReadLimits& limits) {
  const TreeExtent& extent = choice.extent;
  std::array<std::int64_t, 3> sizes{};
  for (std::size_t a = 0; a < 3; ++a) {
    sizes[a] = extent.max[a] - extent.min[a] + 3;
    if (extent.min[a] <= INT32_MIN || extent.max[a] >= INT32_MAX) {
      refuse(file, ErrorCode::unusable, "The OpenVDB grid reaches the end of index space; move it to the origin");
    }
  }
  // A curve one voxel thick through a box of 256³ voxels is just dense enough; smaller boxes may be as empty as they
  // like.
  constexpr double most_voxels_an_active_one = 65536, most_bytes_of_any = 1 << 28;
  const double samples = static_cast<double>(sizes[0]) * static_cast<double>(sizes[1]) * static_cast<double>(sizes[2]);
  if (samples * static_cast<double>(bytes_per_voxel(type)) > most_bytes_of_any &&
      samples > most_voxels_an_active_one * extent.active) {
    refuse(file, ErrorCode::too_large,
           "The OpenVDB grid's few active voxels lie in a box of far too many others; crop or resample it");
  }
  return checked_dims(sizes, type, limits);
}

Volume read(const std::filesystem::path& path, const ReadOptions& options, const Context& context) {
  Stream stream(path);
  const File file = vdb::read_file(stream, context);
  const Choice choice = choose(stream, file, options, context);
  if (!choice.head.linear) {
    refuse(file, ErrorCode::unusable, "The OpenVDB grid lies in a camera's frustum; resample it onto a straight grid");
  }
  Volume volume;
  volume.format = "openvdb";
  volume.type = voxel_type_of(*choice.place.type);
  const auto dims = dims_of(file, choice, volume.type, options.limits);
  std::array<std::int64_t, 3> first = choice.extent.min;
  for (std::int64_t& i : first) --i;
  const Vec3 index{static_cast<double>(first[0]), static_cast<double>(first[1]), static_cast<double>(first[2])};
  volume.grid = grid_from_affine(dims, choice.head.axes, choice.head.origin + choice.head.axes * index);
  volume.natural_side = choice.head.level_set ? Side::below : Side::above;
  context.report("read", 0.2);
  volume.voxels.resize(volume.grid.sample_count() * bytes_per_voxel(volume.type));
  vdb::read_tree(volume, first, stream, choice.place, context);

  volume.warnings.push_back("OpenVDB does not name its units or the patient's axes; they were taken as mm, LPS.");
  if (file.grids.size() > 1) {
    volume.warnings.push_back("The OpenVDB file's grids are " + vdb::list_of_grids(file) + "; number " +
                              std::to_string(choice.index + 1) + " was read" +
                              (choice.after_empty ? ", the first one with active voxels." : "."));
  }
  return volume;
}

}  // namespace

bool is_openvdb(std::string_view head) {
  return head.size() >= 12 && head.substr(0, 8) == std::string_view(" BDV\0\0\0\0", 8);
}

Volume read_openvdb(const std::filesystem::path& path, const ReadOptions& options, const Context& context) {
  openvdb::initialize();  // safe to call again and from several threads
  chosen_frame(1, options);
  try {
    return read(path, options, context);
  } catch (const Error&) {
    throw;
  } catch (const Defect&) {
    throw;
  } catch (const std::bad_alloc&) {
    throw;
  } catch (const std::exception&) {
    vdb::fail_damaged();  // whatever else a library throws, bytes made it do so
  }
}

}  // namespace spherule
