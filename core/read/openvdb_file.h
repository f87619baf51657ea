// SPDX-License-Identifier: GPL-3.0-or-later
//
// What an OpenVDB file says around its trees: which grids it has, of which types, and where they lie. Private to
// core/read. Everything throws malformed where bytes are missing or make no sense.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/read/openvdb_stream.h"

namespace spherule::vdb {

/// A grid of a file, and where it lies.
struct GridEntry {
  std::string name;
  const GridType* type = nullptr;  ///< null: one that we cannot pass over (points)
  bool half = false;
  std::size_t tree = 0;  ///< the entry that has the tree: itself, but for instances
  std::int64_t position = 0;
};

/// What precedes a grid's tree, or stands instead of it.
struct GridHead {
  std::uint32_t compression = 0;
  bool level_set = false;
  bool linear = true;  ///< else a camera's frustum, and what follows is not set
  Mat3 axes{};         ///< columns: one step of the index, in world units
  Vec3 origin{};       ///< of voxel (0, 0, 0)
};

/// What a file says before its grids, and which these are.
struct File {
  std::uint32_t version = 0;
  std::uint32_t library_major = 0, library_minor = 0;
  std::vector<GridEntry> grids;
};

/// Reads the list of grids. Of a file without the places of its grids (written as a stream), they are found by passing
/// over one after another, up to the first of a type that we do not know: O(file). Throws unusable for versions other
/// than 222 to 224.
File read_file(Stream& stream, const Context& context);

/// Reads what is at entry.position, and leaves the stream at the tree. Throws unusable for a transform unknown to
/// OpenVDB and for a singular one.
GridHead read_head(Stream& stream, const File& file, const GridEntry& entry);

/// The grids, for a sentence: "density (float), velocity (vec3s)". Names that are not plain words are left out.
std::string list_of_grids(const File& file);

}  // namespace spherule::vdb
