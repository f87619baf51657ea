// SPDX-License-Identifier: GPL-3.0-or-later
//
// The one place that knows ITK: what its NRRD and MetaImage modules make of a header. Private to core/read.
//
// ITK never sees what a stranger wrote. nrrd.cpp and metaimage.cpp check a header word by word and write it anew with
// only the fields that say what the samples are and where they lie; that text, which is always of three dimensions,
// is what ITK parses. Samples are read by read_bytes.h, which takes memory only as they arrive.
#pragma once

#include <cstdint>
#include <string>

#include "core/base/geometry.h"
#include "core/volume.h"

namespace spherule {

enum class ItkFormat : std::uint8_t { nrrd, metaimage };

struct ItkHeader {
  std::array<std::int64_t, 3> dims{0, 0, 0};
  VoxelType type = VoxelType::uint8;
  Mat3 axes;    ///< columns: one index step along each axis, in the header's own frame and units
  Vec3 origin;  ///< of sample (0, 0, 0)
};

/// Throws unusable when ITK does not take the samples for one scalar of a known type, or does not parse the header
/// (after our checks what remains is a type that it does not know). Thread safe: calls take turns, because NRRD's
/// list of errors is global.
ItkHeader parse_with_itk(ItkFormat format, const std::string& header);

}  // namespace spherule
