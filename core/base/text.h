// SPDX-License-Identifier: GPL-3.0-or-later
//
// Words and numbers in text, for parsers and for sentences. Nothing here depends on the locale.
#pragma once

#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <type_traits>
#include <vector>

namespace spherule {

/// Without `blanks` at either end.
std::string_view trimmed(std::string_view text, std::string_view blanks = " \t\r\n\v\f");

/// With a to z in place of A to Z; other bytes as they are.
std::string lowered(std::string_view text);

/// The parts between separators, empty ones too: one more than there are separators. They are views of `text`.
std::vector<std::string_view> split(std::string_view text, char separator);

/// "one, two, three", for sentences that name what may be chosen.
std::string listed(std::span<const std::string_view> words);

/// The number that is all of `text`, in decimal notation; none for a text that is more or less than that, a number
/// that T cannot hold, one that is not finite, and a plus sign.
template <typename T>
requires std::is_arithmetic_v<T> std::optional<T> number_in(std::string_view text) {
  T value{};
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  if (text.empty() || error != std::errc{} || end != text.data() + text.size()) return std::nullopt;
  if constexpr (std::is_floating_point_v<T>) {
    if (!std::isfinite(value)) return std::nullopt;
  }
  return value;
}

/// The shortest decimals that read back to the same number; -0 is 0.
template <typename T>
requires std::is_arithmetic_v<T> std::string text_of(T value) {
  std::array<char, 32> text;  // the longest of a double has 24 characters
  if constexpr (std::is_floating_point_v<T>) value += 0.0;
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

}  // namespace spherule
