// SPDX-License-Identifier: GPL-3.0-or-later
//
// Bytes of a file, or of a few files that belong together, to a Volume. The format is sniffed from the bytes;
// names only tell which file of several is meant.
#pragma once

#include <filesystem>
#include <vector>

#include "core/base/context.h"
#include "core/read/options.h"
#include "core/volume.h"

namespace spherule {

/// Reads a volume from one file, or from several in one folder (header + data pairs; slices).
/// Throws: unknown_format when no reader recognises the bytes; malformed when they are cut, contradict their header
/// or do not parse; unusable when they parse but are not one scalar volume on a straight grid (4-D without `frame`,
/// colour, sheared or singular affine, zero or negative sizes or spacings); too_large over the limits, before memory
/// is taken; invalid_argument for a frame or raw layout that is not possible; not_found for a grid that is not there or
/// a file that cannot be opened; cancelled. Every geometry is within the bounds of volume.h.
/// A data file that a header names is the one of `files` with the last part of that name (folders do not count), or
/// else the only other file if it holds just the samples, with a warning; malformed, with the name wanted, otherwise.
/// Where several files look like volumes, a header that names its data elsewhere is the one that is read.
/// Warnings: bytes after the last sample, lengths of unknown unit, values that are not finite, slices far thicker than
/// their pixels, and headers that every reader mends, each as one sentence.
/// Memory at its peak: the samples once, in their stored type, and beside them at most twice max_header_bytes and
/// 16 MiB; for OpenVDB see openvdb.h. Thread safe: distinct calls share nothing mutable.
Volume read_volume(const std::vector<std::filesystem::path>& files, const ReadOptions& options = {},
                   const Context& context = {});

}  // namespace spherule
