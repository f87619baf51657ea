// SPDX-License-Identifier: GPL-3.0-or-later
//
// Volume -> bytes of a NIfTI file.
#pragma once

#include <string>

#include "core/volume.h"

namespace spherule {

/// A single .nii file (not compressed, native byte order, which for our platforms is little-endian): the samples as
/// stored, slope and intercept, and the grid as both sform and qform in RAS mm. NIfTI-1, whose geometry is float32,
/// unless that would misplace a sample by more than a thousandth of a voxel or an axis has more than 32,767 samples;
/// then NIfTI-2, whose geometry is float64. Memory: the bytes.
std::string volume_to_nifti(const Volume& volume);

}  // namespace spherule
