// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/write/write_nifti.h"

#include "core/write/nifti_header.h"

namespace spherule {

std::string volume_to_nifti(const Volume& volume) {
  std::string bytes = nifti_header(
      volume.grid,
      {.type = volume.type, .slope = volume.slope, .intercept = volume.intercept, .description = "Spherule"});
  bytes.append(reinterpret_cast<const char*>(volume.voxels.data()), volume.voxels.size());
  return bytes;
}

}  // namespace spherule
