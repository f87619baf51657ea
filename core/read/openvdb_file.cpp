// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/openvdb_file.h"

#include <openvdb/Exceptions.h>
#include <openvdb/Grid.h>
#include <openvdb/io/io.h>
#include <openvdb/math/Maps.h>
#include <openvdb/math/Transform.h>

#include <algorithm>
#include <array>
#include <memory>

#include "core/read/openvdb_tree.h"

namespace spherule::vdb {

namespace {

constexpr std::uint32_t kOldest = openvdb::OPENVDB_FILE_VERSION_NODE_MASK_COMPRESSION;
constexpr std::uint32_t kNewest = openvdb::OPENVDB_FILE_VERSION;
constexpr std::size_t kMaxEntries = 4096;  // grids in a file, metadata of a grid
constexpr std::string_view kHalfSuffix = "_HalfFloat";

// Tells OpenVDB what its functions need to know about a stream of a file.
void prepare(std::istream& in, const File& file) {
  auto metadata = std::make_shared<openvdb::io::StreamMetadata>();
  openvdb::io::setStreamMetadataPtr(in, metadata, /*transfer=*/false);
  openvdb::io::setVersion(in, {file.library_major, file.library_minor}, file.version);
}

constexpr auto kTypes = std::to_array<GridType>({
    {"Tree_float_5_4_3", "float", 4, 2},
    {"Tree_double_5_4_3", "double", 8, 2},
    {"Tree_int32_5_4_3", "int32", 4, 4},
    {"Tree_int64_5_4_3", "int64", 8, 8},
    {"Tree_bool_5_4_3", "bool", 1, 1, GridType::Leaf::bits},
    {"Tree_mask_5_4_3", "mask", 1, 1, GridType::Leaf::states},
    {"Tree_vec3s_5_4_3", "vec3s", 12, 6, GridType::Leaf::values, false},
    {"Tree_vec3d_5_4_3", "vec3d", 24, 6, GridType::Leaf::values, false},
    {"Tree_vec3i_5_4_3", "vec3i", 12, 12, GridType::Leaf::values, false},
});

// Metadata are passed over by us: OpenVDB takes their sizes on trust. Only the class of a grid matters.
// Whether it is that of a level set.
bool read_metadata(Stream& stream) {
  bool level_set = false;
  const auto count = stream.value<std::uint32_t>();
  if (count > kMaxEntries) fail_damaged();
  for (std::uint32_t i = 0; i < count; ++i) {
    const std::string name = stream.text();
    const std::string type = stream.text();
    if (name == openvdb::GridBase::META_GRID_CLASS && type == "string") {
      level_set = openvdb::GridBase::stringToGridClass(stream.text()) == openvdb::GRID_LEVEL_SET;
    } else {
      stream.skip(stream.value<std::uint32_t>());
    }
  }
  return level_set;
}

struct Descriptor {
  GridEntry entry;
  std::string unique_name, parent;
  std::int64_t end = 0;
};

Descriptor read_descriptor(Stream& stream) {
  Descriptor d;
  d.unique_name = stream.text();
  d.entry.name = d.unique_name.substr(0, d.unique_name.find('\x1e'));  // what makes equal names unique follows it
  std::string type = stream.text();
  if (type.ends_with(kHalfSuffix)) {
    d.entry.half = true;
    type.resize(type.size() - kHalfSuffix.size());
  }
  const auto found = std::ranges::find(kTypes, type, &GridType::tree);
  if (found != kTypes.end()) d.entry.type = &*found;
  d.parent = stream.text();
  d.entry.position = stream.value<std::int64_t>();
  stream.value<std::int64_t>();  // of the leaves
  d.end = stream.value<std::int64_t>();
  return d;
}

// Passes over a grid that follows its descriptor, as a stream has it. False where that cannot be done.
bool pass_grid(Stream& stream, const File& file, const GridEntry& entry, const Context& context) {
  const GridHead head = read_head(stream, file, entry);
  if (&entry != &file.grids[entry.tree]) return true;
  if (entry.type == nullptr) return false;
  pass_tree(stream, {entry.type, head.compression, entry.half, stream.position()}, context);
  return true;
}

bool is_plain(std::string_view name) {
  const auto plain = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '_' || c == '-';
  };
  return !name.empty() && name.size() <= 64 && std::ranges::all_of(name, plain);
}

}  // namespace

File read_file(Stream& stream, const Context& context) {
  File file;
  stream.value<std::int64_t>();  // the magic
  file.version = stream.value<std::uint32_t>();
  if (file.version < kOldest || file.version > kNewest) {
    throw Error(ErrorCode::unusable, "The OpenVDB file's version is " + std::to_string(file.version) +
                                         "; write it anew with version " + std::to_string(kOldest) + " to " +
                                         std::to_string(kNewest) + ".");
  }
  file.library_major = stream.value<std::uint32_t>();
  file.library_minor = stream.value<std::uint32_t>();
  const bool has_places = stream.value<char>() != 0;
  stream.skip(36);  // the UUID
  read_metadata(stream);
  const auto count = stream.value<std::uint32_t>();
  if (count > kMaxEntries) fail_damaged();
  prepare(stream.in(), file);
  std::vector<std::string> unique_names, parents;
  const auto with_tree = [&](const std::string& parent) {
    const auto found = std::ranges::find(unique_names, parent);
    if (found == unique_names.end()) fail_damaged();
    return static_cast<std::size_t>(found - unique_names.begin());
  };
  for (std::uint32_t i = 0; i < count; ++i) {
    Descriptor d = read_descriptor(stream);
    d.entry.tree = i;
    unique_names.push_back(std::move(d.unique_name));
    parents.push_back(std::move(d.parent));
    file.grids.push_back(std::move(d.entry));
    GridEntry& entry = file.grids.back();
    if (has_places) {
      if (entry.position < stream.position() || d.end < entry.position) fail_damaged();
      stream.seek(d.end);
    } else {
      entry.position = stream.position();
      if (!parents.back().empty()) entry.tree = with_tree(parents.back());
      if (i + 1 < count && !pass_grid(stream, file, entry, context)) break;
    }
  }
  for (std::size_t i = 0; i < file.grids.size(); ++i) {
    GridEntry& entry = file.grids[i];
    if (parents[i].empty()) continue;
    entry.tree = with_tree(parents[i]);
    if (!parents[entry.tree].empty() || file.grids[entry.tree].type != entry.type) fail_damaged();
  }
  return file;
}

GridHead read_head(Stream& stream, const File& file, const GridEntry& entry) {
  stream.seek(entry.position);
  GridHead head;
  head.compression = stream.value<std::uint32_t>();
  head.level_set = read_metadata(stream);
  const std::int64_t position = stream.position();
  const std::string map = stream.text();
  if (!openvdb::math::MapRegistry::isRegistered(map)) {
    throw Error(ErrorCode::unusable,
                "The OpenVDB grid's transform is of an unknown kind; resample it onto a straight grid.");
  }
  stream.seek(position);
  prepare(stream.in(), file);
  openvdb::math::Transform transform;
  try {
    transform.read(stream.in());
    head.linear = map != openvdb::math::NonlinearFrustumMap::mapType();
    if (!head.linear) return head;
    const openvdb::math::Mat4d m = transform.baseMap()->getAffineMap()->getMat4();  // acts on row vectors
    for (int r = 0; r < 3; ++r) {
      for (int c = 0; c < 3; ++c) head.axes.rows[static_cast<std::size_t>(r)][c] = m(c, r);
      head.origin[r] = m(3, r);
    }
  } catch (const openvdb::ArithmeticError&) {
    throw Error(ErrorCode::unusable, "The OpenVDB grid's transform is singular; give it a scale above zero.");
  }
  return head;
}

std::string list_of_grids(const File& file) {
  constexpr std::size_t kMost = 20;
  std::string list;
  for (std::size_t i = 0; i < std::min(file.grids.size(), kMost); ++i) {
    const GridEntry& grid = file.grids[i];
    list += std::string(i > 0 ? ", " : "") + (is_plain(grid.name) ? grid.name : "grid " + std::to_string(i + 1)) +
            " (" + std::string(grid.type != nullptr ? grid.type->name : "other") + ")";
  }
  if (file.grids.size() > kMost) list += " and " + std::to_string(file.grids.size() - kMost) + " more";
  return list;
}

}  // namespace spherule::vdb
