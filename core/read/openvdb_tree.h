// SPDX-License-Identifier: GPL-3.0-or-later
//
// Trees of OpenVDB files without OpenVDB's trees: first what a tree spans is learnt from its masks, in no memory to
// speak of, then its values go straight into dense samples. Private to core/read. Everything throws malformed where
// bytes are missing or make no sense, and polls cancellation.
#pragma once

#include <array>
#include <cstdint>

#include "core/base/context.h"
#include "core/read/openvdb_stream.h"
#include "core/volume.h"

namespace spherule::vdb {

/// Where a tree is in a file, and how it is stored.
struct TreePlace {
  const GridType* type = nullptr;
  std::uint32_t compression = 0;
  bool half = false;
  std::int64_t position = 0;
};

/// What a tree spans.
struct TreeExtent {
  std::array<std::int64_t, 3> min{INT64_MAX, INT64_MAX, INT64_MAX};  ///< of the active voxels
  std::array<std::int64_t, 3> max{INT64_MIN, INT64_MIN, INT64_MIN};
  double active = 0;         ///< voxels
  std::uint64_t leaves = 0;  ///< blocks of 8³ voxels with values of their own
};

/// Passes over the nodes of a tree, to the values of its leaves. O(bytes).
TreeExtent measure_tree(Stream& stream, const TreePlace& place, const Context& context);

/// Passes over a whole tree, to what follows it. O(bytes).
void pass_tree(Stream& stream, const TreePlace& place, const Context& context);

/// Reads a tree into the volume's samples, whose first one is voxel `first`, and which must have the tree's type and be
/// sized; what lies beyond them is left out. O(bytes + samples). Memory: 24 bytes a leaf. Reports stage "read".
void read_tree(Volume& volume, std::array<std::int64_t, 3> first, Stream& stream, const TreePlace& place,
               const Context& context);

}  // namespace spherule::vdb
