// SPDX-License-Identifier: GPL-3.0-or-later
//
// OpenVDB files (https://www.openvdb.org, file versions 222 to 224) with a grid of bool, int32, int64, float (also
// stored as half) or double. Private to core/io; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>

#include "core/io/read.h"

namespace spherule {

/// Whether bytes start like an OpenVDB file.
bool is_openvdb(std::string_view head);

/// Reads the grid that options.grid names, else the first scalar one, densely: the box of its active voxels and one
/// layer of voxels around it, so that a closed border cuts nothing. Inactive voxels keep the value that the tree has
/// there (negative deep inside a level set). World units are taken as LPS mm, with a warning.
/// natural_side is below for a level set, above for any other grid. bool becomes uint8.
/// Throws not_found when no grid has the name; unusable when there is no scalar grid, the grid has no active voxel, or
/// its transform is not linear and at right angles; too_large before the dense samples are allocated.
/// Memory: the tree and the dense samples. Cancellation is polled between them only.
Volume read_openvdb(const std::filesystem::path& file, const ReadOptions& options, const Context& context);

}  // namespace spherule
