// SPDX-License-Identifier: GPL-3.0-or-later
//
// NRRD (https://teem.sourceforge.net/nrrd/format.html), versions 1 to 5, attached or detached, raw or gzip, in either
// byte order. Private to core/io; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "core/io/read.h"

namespace spherule {

/// Whether bytes start like an NRRD header.
bool is_nrrd(std::string_view head);

/// `header` is one of `files`; data files that it names must be others of them.
/// Geometry: space directions and origin, else spacings and axis mins. right- and left-anterior-superior become LPS;
/// any other or no space is taken as LPS (with a warning unless it is LPS). Lengths are mm.
/// Four sizes are volumes one after another (`frame` chooses) unless `kinds` says that one axis is not of space; that
/// axis must then be the slowest.
Volume read_nrrd(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                 const ReadOptions& options, const Context& context);

}  // namespace spherule
