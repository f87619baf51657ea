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

/// An OpenVDB level set (grid "spheres", float) of the union: negative inside; mm along LPS. Values are the distance to
/// the union's surface, cut at level_set_band voxels; exact but near corners behind which three spheres meet, where it
/// may be wrong by an eighth of a voxel. Of more than 65,536 balls, which lie as densely as a raw model's, the inside
/// is the depth in the deepest ball, which is at most that distance. Throws invalid_argument for a voxel that is not
/// above 0, too_large beyond `most_blocks` and 2^20 voxels along an axis. Precondition: some ball. The same bytes for
/// any thread count. Space is halved, with the balls that reach into each part, down to blocks, and on to where spheres
/// meet: O(balls + blocks · balls near them). Reports stage "level set".
std::string spheres_to_vdb(std::span<const Sphere> balls, double voxel_mm,
                           std::size_t most_blocks = max_level_set_blocks, const Context& context = {});

/// A NIfTI-1 file (uint8, 0 and 1, gzip'ed) of samples and the grid that they are on, by sform and qform; mm, RAS+.
/// Throws unusable for more than 32,767 samples along an axis, which the format cannot say.
std::string mask_to_nifti(const Grid& grid, const SampleBits& mask);

}  // namespace spherule
