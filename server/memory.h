// SPDX-License-Identifier: GPL-3.0-or-later
//
// How much memory a job will need at its peak: what admission goes by. Coefficients come from measured peaks of the
// stages (tests/bench/memory.sh), rounded up; they are estimates, not bounds.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "api/service.h"
#include "core/volume.h"

namespace spherule::server {

/// Of making a model, before the volume is looked at: as if its surface were as rich as that of the richest scans (a
/// boundary point for every 8 samples, and no more than 24 n^(2/3) of them).
std::uint64_t memory_to_model(const Grid& grid, VoxelType type);

/// The same once the boundary points are known.
std::uint64_t memory_to_model(const Grid& grid, VoxelType type, std::size_t boundary_points);

/// Of deriving an answer from a model.
std::uint64_t memory_to_derive(const api::ModelInfo& model);

/// Of writing so many spheres within a box as a file for one other program; `scan` is the grid of a mask without a
/// voxel size of its own. Beside memory_to_derive.
std::uint64_t memory_to_write(const api::FileRequest& file, std::uint64_t spheres, const Box& box,
                              const std::optional<Grid>& scan);

/// Of simplifying a model; `grid` is that of the scan that its first source model was made from, if any.
std::uint64_t memory_to_simplify(const api::ModelInfo& model, const std::optional<Grid>& grid);

/// Of drawing a slice: the whole volume is read.
std::uint64_t memory_to_slice(const api::VolumeInfo& volume);

}  // namespace spherule::server
