// SPDX-License-Identifier: GPL-3.0-or-later
//
// OpenVDB files (https://www.openvdb.org, file versions 222 to 224), with or without the places of their grids, with a
// grid of bool, mask, int32, int64, float or double (the last two also stored as half), its own or another one's
// elsewhere (an instance). Private to core/read; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>

#include "core/read/options.h"

namespace spherule {

/// Whether bytes start like an OpenVDB file.
bool is_openvdb(std::string_view head);

/// Reads the grid that options.grid names, else the first scalar one with active voxels, densely: the box of its active
/// voxels and one layer of voxels around it, so that a closed border cuts nothing. Inactive voxels keep the value that
/// the tree has there (negative deep inside a level set). World units are taken as LPS mm, with a warning; of several
/// grids, another warning lists all and says which was read, and refusals list them, too.
/// natural_side is below for a level set, above for any other grid. bool becomes uint8; a mask is 1 where it is active.
/// Throws not_found when no grid has the name; unusable when there is no scalar grid, the grid has no active voxel, or
/// its transform is not linear and at right angles; before any samples are allocated: too_large over the limits, and
/// for a box of more than 256 MiB with more than 65,536 samples for each active voxel. The box is known from the tree's
/// masks, before anything is allocated. O(bytes + samples). Memory: the dense samples and 24 bytes for each block of 8³
/// voxels that the file has. Polls cancellation.
Volume read_openvdb(const std::filesystem::path& file, const ReadOptions& options, const Context& context);

}  // namespace spherule
