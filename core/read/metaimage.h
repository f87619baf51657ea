// SPDX-License-Identifier: GPL-3.0-or-later
//
// MetaImage (.mha, .mhd with raw or zraw data; https://itk.org/Wiki/MetaIO), in either byte order, or as
// text (BinaryData = False).
// Private to core/read; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <string_view>
#include <vector>

#include "core/read/options.h"

namespace spherule {

/// Whether bytes start like a MetaImage header: lines of `Key = value`, one of them ObjectType or NDims.
bool is_metaimage(std::string_view head);
/// Whether it names data in other files.
bool is_detached_metaimage(std::string_view head);

/// `header` is one of `files`; data files that it names must be others of them (see read.h).
/// Geometry: Offset, TransformMatrix and ElementSpacing, which are LPS; DistanceUnits become mm. Fields that do not
/// matter for the volume may repeat or come first (with a warning, as ITK reads them without).
/// NDims = 4 are volumes one after another (`frame` chooses).
Volume read_metaimage(const std::filesystem::path& header, const std::vector<std::filesystem::path>& files,
                      const ReadOptions& options, const Context& context);

}  // namespace spherule
