// SPDX-License-Identifier: GPL-3.0-or-later
//
// Picture options as words: the names and values that the REST interface and the command line share.
#pragma once

#include <span>
#include <string_view>

#include "core/base/option_texts.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"

namespace spherule {

/// Every option's name. Values: words for choices (the names of the enumerators), true and false, numbers in decimal
/// notation, lists with commas. `view` and `views` are letters; `buckets` may have ranges: 0,3-5; `clip` is a normal or
/// a normal and an offset; position, look_at and up are three numbers.
std::span<const std::string_view> render_option_names();

/// Throws invalid_argument, with the name as pointer, for a name that is unknown or given twice, a value that is not of
/// its kind, and an option that would change nothing beside the others (a smoothness of spheres). What render() itself
/// checks is left to it.
RenderOptions parse_render_options(const OptionTexts& given);

/// Every option that matters, defaults filled in: equal pictures have equal texts, and parsing them gives the options
/// back. In the order of render_option_names.
OptionTexts render_option_texts(const RenderOptions& options);

/// The same of slices. `window` and `level` come together; `region` is four numbers; `show` is a list of words. What
/// check_slice_options checks is left to it.
std::span<const std::string_view> slice_option_names();
SliceOptions parse_slice_options(const OptionTexts& given);
OptionTexts slice_option_texts(const SliceOptions& options);

}  // namespace spherule
