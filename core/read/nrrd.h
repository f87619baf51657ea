// SPDX-License-Identifier: GPL-3.0-or-later
//
// NRRD (https://teem.sourceforge.net/nrrd/format.html), versions 1 to 5, attached or detached, as raw, ascii, hex, gzip
// or bzip2, in either byte order. Private to core/read; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "core/read/options.h"

namespace spherule {

/// Whether bytes start like an NRRD header.
bool is_nrrd(std::string_view head);

/// Whether it names data in other files.
bool is_detached_nrrd(std::string_view head);

/// `header` is one of `files`; data files that it names must be others of them (see read.h).
/// Geometry: space directions and origin, else spacings and axis mins; units become mm. right- and
/// left-anterior-superior become LPS; any other or no space is taken as LPS (with a warning unless it is LPS).
/// Axes: two or three are of space, anywhere among the others; one more may hold several volumes (`frame` chooses); of
/// all others the size must be 1. `kinds` say which is which (domain, space; list, time; a kind of colours or vectors
/// is refused), then space directions (none: not of space; one along the fourth dimension of a space: time), then
/// spacings (nan: not of space). Where nothing does, an axis of one sample in front of three others is passed over and
/// the slowest of four holds the volumes, which is also what ITK writes.
Volume read_nrrd(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                 const ReadOptions& options, const Context& context);

}  // namespace spherule
