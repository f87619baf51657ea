// SPDX-License-Identifier: GPL-3.0-or-later
//
// What parsers of options share.
#pragma once

#include <array>
#include <charconv>
#include <cmath>
#include <optional>
#include <string>
#include <string_view>
#include <type_traits>

#include "core/base/error.h"

namespace spherule::detail {

[[noreturn]] inline void refuse_option(std::string_view name, const std::string& detail) {
  throw Error(ErrorCode::invalid_argument, "Correct the option " + std::string(name) + ": " + detail,
              {{std::string(name), detail}});
}

/// The finite number that is all of `text`.
template <typename T>
std::optional<T> number_in(std::string_view text) {
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
std::string text_of_number(T value) {
  std::array<char, 32> text;
  if constexpr (std::is_floating_point_v<T>) value += 0.0;
  return {text.data(), std::to_chars(text.data(), text.data() + text.size(), value).ptr};
}

}  // namespace spherule::detail
