// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a caller says about the bytes that are read to a Volume (read.h), and what is refused.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <optional>
#include <string>

#include "core/volume.h"

namespace spherule {

/// What a reader refuses before it takes memory.
struct ReadLimits {
  std::size_t max_voxels = std::size_t{1} << 31;         ///< samples in one volume
  std::size_t max_bytes = std::size_t{8} << 30;          ///< of decoded samples
  std::size_t max_header_bytes = std::size_t{16} << 20;  ///< of a header with its extensions
  /// Called once the header has told how many bytes the samples will take, before any of that is taken. It may wait;
  /// what it throws ends the reading. Called again when it turns out to be more (or a reader needs more beside them).
  std::function<void(std::size_t bytes)> admit{};
};

/// Description of headerless samples (`?format=raw`).
struct RawLayout {
  std::array<std::int32_t, 3> dims{0, 0, 0};
  VoxelType type = VoxelType::uint8;
  Vec3 spacing{1, 1, 1};  ///< mm
  Vec3 origin{};          ///< LPS mm of sample (0, 0, 0)
  bool big_endian = false;
};

struct ReadOptions {
  std::optional<RawLayout> raw{};  ///< set: the bytes have no header and this describes them
  std::optional<int> frame{};      ///< which volume of a 4-D file, from 0; without it a file of several is refused
  std::string grid{};              ///< OpenVDB: name of the grid; empty: the first scalar one with active voxels
  ReadLimits limits{};
};

}  // namespace spherule
