// SPDX-License-Identifier: GPL-3.0-or-later
//
// What headers have in common: words, numbers, units of length, and the data files that they name.
// Private to core/read. Errors never repeat the header's text, which may hold patient data, but for the plain name of a
// data file that was not sent.
#pragma once

#include <cstdint>
#include <filesystem>
#include <functional>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/read/options.h"

namespace spherule {

/// Most characters of one value that is parsed: none needs more, and its words take a multiple in memory.
inline constexpr std::size_t max_header_value = std::size_t{1} << 16;

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

/// Millimetres in one unit of length, by its name or symbol in any case ("mm", "micrometer", "microns", "um", "inch"
/// …); nothing for other words.
std::optional<double> millimetres(std::string_view unit);
/// The same, and for words that say nothing ("", "?") or something else 1, the latter with a warning.
double millimetres_or_one(std::string_view unit, std::vector<std::string>& warnings);

/// The names that `pattern first last step` stands for, where pattern holds one %d (or %3d, %03d).
/// Throws malformed for any other pattern, and for more than `most` names.
std::vector<std::string> numbered_names(std::string_view pattern, std::span<const std::string_view> range,
                                        std::size_t most);

/// Those of `files` that have the names, in the names' order. Only the last part of a name counts, behind any folders:
/// files come without theirs. Throws malformed, with the name, for the first that was not sent.
std::vector<std::filesystem::path> named_files(const std::vector<std::string>& names,
                                               const std::vector<std::filesystem::path>& files);

/// The one data file that a header names: the file of that name, or else the only other file that was sent, if `fits`
/// says that it holds just the samples (with a warning). Throws malformed, with the name, when it is neither.
std::filesystem::path data_file(std::string_view name, const std::filesystem::path& header,
                                const std::vector<std::filesystem::path>& files,
                                const std::function<bool(const std::filesystem::path&)>& fits,
                                std::vector<std::string>& warnings);

}  // namespace spherule
