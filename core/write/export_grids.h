// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> samples on a grid, for programs that know volumes. One .cpp a format.
#pragma once

#include <span>
#include <string>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/inside.h"
#include "core/volume.h"

namespace spherule {

/// Most 8³ blocks of voxels that a level set may have near its surface (2 KiB each).
inline constexpr std::size_t max_level_set_blocks = std::size_t{1} << 18;
/// How far a level set reaches on either side of the surface, voxels.
inline constexpr double level_set_band = 3;

/// The least voxel of a level set, mm; the largest is that of ranges::voxel_mm. OpenVDB takes a transform whose scales
/// have a product below 3e-15 for singular.
inline constexpr double min_level_set_voxel_mm = 2e-5;

/// An OpenVDB level set (grid "spheres", float) of the union: negative inside; mm along LPS. Values are the distance to
/// the nearest ball outside, the depth in the deepest ball inside (at most the distance to the union's surface), cut at
/// level_set_band voxels. Exact to float32; the grid's place is of doubles. Balls that repeat cost nothing.
/// Throws invalid_argument for a voxel outside these bounds; too_large beyond `most_blocks`, for as much memory for
/// the tree that joins blocks far apart, for 2^20 voxels along an axis, and for voxels below 2^-40 of the farthest
/// coordinate. Precondition: some ball. The same bytes for any thread count.
/// Space is halved, with the balls that can be the deepest in each part, down to blocks: O(balls + blocks · balls near
/// them). Memory: 6 KiB a block at the peak, when the tree is written; refused before more is taken. Cancellation is
/// polled with every block. Reports stage "level set".
std::string spheres_to_vdb(std::span<const Sphere> balls, double voxel_mm,
                           std::size_t most_blocks = max_level_set_blocks, const Context& context = {});

/// A NIfTI file (uint8, 0 and 1, gzip'ed) of samples and the grid that they are on, by sform and qform; mm, RAS+. Of
/// version 2 where version 1 cannot say the sizes or would misplace a sample (write_nifti.h). Memory: the file's bytes.
std::string mask_to_nifti(const Grid& grid, const SampleBits& mask);

}  // namespace spherule
