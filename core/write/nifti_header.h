// SPDX-License-Identifier: GPL-3.0-or-later
//
// What precedes the samples in the NIfTI files that we write. Private to core/write.
#pragma once

#include <string>

#include "core/volume.h"

namespace spherule {

/// How samples are stored, beside their grid.
struct NiftiSamples {
  VoxelType type = VoxelType::uint8;
  double slope = 1, intercept = 0;
  double shown_up_to = 0;        ///< cal_max; 0: not said
  std::string description = {};  ///< at most 79 characters
};

/// Share of a voxel by which NIfTI-1's float32 may misplace a sample.
inline constexpr double max_nifti_1_shift = 1e-3;

/// The bytes before the first sample of a single file, without extensions: of NIfTI-1, or of NIfTI-2 (sizes of 64 bits,
/// geometry in float64) where an axis has more than 32,767 samples or float32 would misplace a corner by more than
/// max_nifti_1_shift. sform and qform alike, RAS mm, scanner coordinates.
std::string nifti_header(const Grid& grid, const NiftiSamples& samples);

}  // namespace spherule
