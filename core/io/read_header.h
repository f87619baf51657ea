// SPDX-License-Identifier: GPL-3.0-or-later
//
// What text headers (NRRD, MetaImage) have in common: words, numbers, and the data files that they name.
// Private to core/io. Errors never repeat the header's text: it may hold patient data.
#pragma once

#include <cstdint>
#include <filesystem>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/io/read.h"

namespace spherule {

/// Without blanks at either end.
std::string_view trimmed(std::string_view text);
/// The parts between blanks.
std::vector<std::string_view> words(std::string_view text);
/// The text up to the next line feed (and without a carriage return before it); `text` moves behind it.
std::string_view next_line(std::string_view& text);

/// A whole number. Throws malformed.
std::int64_t header_integer(std::string_view word);
/// A number. Throws malformed; unusable when it is not finite.
double header_number(std::string_view word);
/// Exactly `count` of them.
std::vector<std::int64_t> header_integers(std::string_view text, std::size_t count);
std::vector<double> header_numbers(std::string_view text, std::size_t count);
/// The shortest text that reads back as the same numbers, separated by blanks.
std::string joined(std::span<const double> values);

/// The names that `pattern first last step` stands for, where pattern holds one %d (or %3d, %03d).
/// Throws malformed for any other pattern, and for more than `most` names.
std::vector<std::string> numbered_names(std::string_view pattern, std::span<const std::string_view> range,
                                        std::size_t most);

/// Those of `files` that have the names, in the names' order.
/// Throws malformed for a name that leaves the folder (holds a slash, or is "..") or that was not sent.
std::vector<std::filesystem::path> named_files(const std::vector<std::string>& names,
                                               const std::vector<std::filesystem::path>& files);

}  // namespace spherule
