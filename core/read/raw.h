// SPDX-License-Identifier: GPL-3.0-or-later
//
// Headerless samples that the caller describes. Private to core/read; see read.h for what is thrown.
#pragma once

#include <filesystem>
#include <vector>

#include "core/read/options.h"

namespace spherule {

/// Reads exactly one file of samples, x fastest, also gzip'ed (unless its size is just that of the samples).
/// Throws invalid_argument, with the field's name, for a layout that is not possible.
Volume read_raw(const std::vector<std::filesystem::path>& files, const RawLayout& layout, const ReadOptions& options,
                const Context& context);

}  // namespace spherule
