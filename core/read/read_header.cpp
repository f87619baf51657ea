// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/read_header.h"

#include <algorithm>
#include <charconv>
#include <cmath>
#include <iterator>
#include <map>

#include "core/base/text.h"

namespace spherule {

namespace {

constexpr std::string_view kBlanks = " \t\r\n\v\f";

[[noreturn]] void fail_number() {
  throw Error(ErrorCode::malformed, "The header has a missing, surplus or unreadable number; correct the header.");
}

}  // namespace

std::vector<std::string_view> words(std::string_view text) {
  std::vector<std::string_view> found;
  for (std::size_t at = 0; (at = text.find_first_not_of(kBlanks, at)) != std::string_view::npos;) {
    const std::size_t end = std::min(text.find_first_of(kBlanks, at), text.size());
    found.push_back(text.substr(at, end - at));
    at = end;
  }
  return found;
}

std::string_view next_line(std::string_view& text) {
  const std::size_t end = text.find('\n');
  std::string_view line = text.substr(0, end);
  text = end == std::string_view::npos ? std::string_view{} : text.substr(end + 1);
  if (line.ends_with('\r')) line.remove_suffix(1);
  return line;
}

std::optional<double> millimetres(std::string_view unit) {
  struct Unit {
    double mm;
    std::vector<std::string_view> words;
  };
  static const std::vector<Unit> units{
      {1e-9, {"pm", "picometer", "picometre"}},
      {1e-7, {"a", "angstrom", "\u00e5", "\u00c5", "\u212b"}},
      {1e-6, {"nm", "nanometer", "nanometre"}},
      {1e-3, {"um", "\u00b5m", "\u03bcm", "micron", "micrometer", "micrometre"}},
      {1, {"mm", "millimeter", "millimetre"}},
      {10, {"cm", "centimeter", "centimetre"}},
      {100, {"dm", "decimeter", "decimetre"}},
      {1000, {"m", "meter", "metre"}},
      {1e6, {"km", "kilometer", "kilometre"}},
      {25.4, {"in", "inch", "inche"}},  // the last without its plural
  };
  std::string word = lowered(trimmed(unit));
  if (word.size() > 2 && word.back() == 's') word.pop_back();
  for (const Unit& known : units) {
    if (std::ranges::find(known.words, word) != known.words.end()) return known.mm;
  }
  return std::nullopt;
}

double millimetres_or_one(std::string_view unit, std::vector<std::string>& warnings) {
  unit = trimmed(unit);
  if (unit.empty() || unit == "?" || unit == "???") return 1;
  if (const std::optional<double> mm = millimetres(unit)) return *mm;
  const std::string warning = "The header's unit of length is not known; lengths were taken as millimetres.";
  if (std::ranges::find(warnings, warning) == warnings.end()) warnings.push_back(warning);
  return 1;
}

std::int64_t header_integer(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);
  std::int64_t value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error != std::errc{} || end != word.data() + word.size()) fail_number();
  return value;
}

double header_number(std::string_view word) {
  if (word.starts_with('+')) word.remove_prefix(1);
  double value = 0;
  const auto [end, error] = std::from_chars(word.data(), word.data() + word.size(), value);
  if (error == std::errc::result_out_of_range || (error == std::errc{} && !std::isfinite(value))) {
    throw Error(ErrorCode::unusable, "Every spacing, direction and origin in the header must be finite; correct it.");
  }
  if (error != std::errc{} || end != word.data() + word.size()) fail_number();
  return value;
}

std::vector<std::int64_t> header_integers(std::string_view text, std::size_t count) {
  std::vector<std::int64_t> values;
  for (const std::string_view word : words(text)) values.push_back(header_integer(word));
  if (values.size() != count) fail_number();
  return values;
}

std::vector<double> header_numbers(std::string_view text, std::size_t count) {
  std::vector<double> values;
  for (const std::string_view word : words(text)) values.push_back(header_number(word));
  if (values.size() != count) fail_number();
  return values;
}

std::string joined(std::span<const double> values) {
  std::string text;
  for (const double value : values) {
    char digits[32];
    const auto result = std::to_chars(std::begin(digits), std::end(digits), value);
    if (!text.empty()) text += ' ';
    text.append(digits, result.ptr);
  }
  return text;
}

std::vector<std::string> numbered_names(std::string_view pattern, std::span<const std::string_view> range,
                                        std::size_t most) {
  const auto refuse = [] {
    throw Error(ErrorCode::malformed,
                "The header's pattern of data file names must be a name with one %d, a first and a last number and a "
                "step; correct the header.");
  };
  if (range.size() != 3) refuse();
  const std::size_t percent = pattern.find('%');
  const std::size_t d = std::min(pattern.find_first_not_of("0123456789", percent + 1), pattern.size());
  if (percent == std::string_view::npos || d == pattern.size() || pattern[d] != 'd' || d - percent > 3 ||
      pattern.find('%', d) != std::string_view::npos) {
    refuse();
  }
  const std::string_view flags = pattern.substr(percent + 1, d - percent - 1);
  const std::size_t width = flags.empty() ? 0 : static_cast<std::size_t>(header_integer(flags));
  const char fill = flags.starts_with('0') ? '0' : ' ';
  const std::int64_t first = header_integer(range[0]), last = header_integer(range[1]), step = header_integer(range[2]);
  constexpr std::int64_t kLargest = 1'000'000'000;  // keeps the steps below from overflowing
  if (step == 0 || std::abs(step) > kLargest || first < 0 || last < 0 || first > kLargest || last > kLargest ||
      (step > 0) != (last >= first || step > 0)) {
    refuse();
  }
  std::vector<std::string> names;
  for (std::int64_t n = first; step > 0 ? n <= last : n >= last; n += step) {
    if (names.size() == most) {
      throw Error(ErrorCode::malformed,
                  "The header names data files that were not sent; send the header and all its data files together.");
    }
    std::string number = std::to_string(n);
    if (number.size() < width) number.insert(0, width - number.size(), fill);
    names.push_back(std::string(pattern.substr(0, percent)) + number + std::string(pattern.substr(d + 1)));
  }
  if (names.empty()) refuse();
  return names;
}

namespace {

std::string_view last_part(std::string_view name) {
  name = name.substr(name.find_last_of("/\\") + 1);
  return name == "." || name == ".." ? std::string_view{} : name;
}

// The name is repeated only where it is plain and short.
[[noreturn]] void fail_not_sent(std::string_view name) {
  constexpr std::size_t kLongest = 64;
  const auto plain = [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '-' ||
           c == '_';
  };
  const bool shown = !name.empty() && name.size() <= kLongest && std::ranges::all_of(name, plain);
  throw Error(ErrorCode::malformed, "The header names data files that were not sent" +
                                        (shown ? " (" + std::string(name) + ")" : std::string()) +
                                        "; send the header and all its data files together.");
}

const std::filesystem::path* find_file(std::string_view name, const std::vector<std::filesystem::path>& files) {
  const auto found = std::ranges::find_if(files, [&](const auto& file) { return file.filename() == name; });
  return name.empty() || found == files.end() ? nullptr : &*found;
}

}  // namespace

std::vector<std::filesystem::path> named_files(const std::vector<std::string>& names,
                                               const std::vector<std::filesystem::path>& files) {
  std::map<std::string, std::filesystem::path, std::less<>> by_name;
  for (const auto& file : files) by_name.emplace(file.filename().string(), file);
  std::vector<std::filesystem::path> found;
  for (const std::string& name : names) {
    const auto file = by_name.find(last_part(name));
    if (file == by_name.end()) fail_not_sent(last_part(name));
    found.push_back(file->second);
  }
  return found;
}

std::filesystem::path data_file(std::string_view name, const std::filesystem::path& header,
                                const std::vector<std::filesystem::path>& files,
                                const std::function<bool(const std::filesystem::path&)>& fits,
                                std::vector<std::string>& warnings) {
  if (const std::filesystem::path* named = find_file(last_part(name), files)) return *named;
  std::vector<std::filesystem::path> others;
  std::ranges::copy_if(files, std::back_inserter(others), [&](const auto& file) { return file != header; });
  if (others.size() != 1 || !fits(others.front())) fail_not_sent(last_part(name));
  warnings.emplace_back(
      "The header names its data file otherwise; the only other file that was sent has just the samples that it wants "
      "and was taken.");
  return others.front();
}

}  // namespace spherule
