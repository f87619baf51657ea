// SPDX-License-Identifier: GPL-3.0-or-later
//
// Volume -> bytes of a NIfTI-1 file.
#pragma once

#include <string>

#include "core/volume.h"

namespace spherule {

/// A single .nii file (not compressed, native byte order, which for our platforms is little-endian): the samples as
/// stored, slope and intercept, and the grid as both sform and qform in RAS mm. Throws too_large for an axis of more
/// than 32,767 samples, which the format cannot say. read_volume gives the same grid back to float32.
std::string volume_to_nifti(const Volume& volume);

}  // namespace spherule
