// SPDX-License-Identifier: GPL-3.0-or-later
//
// Numbers in text exports, private to core/write: the shortest decimals that read back to the same double.
#pragma once

#include <array>
#include <charconv>
#include <initializer_list>
#include <string>

namespace spherule::detail {

inline void append_decimal(std::string& out, double value) {
  std::array<char, 32> digits;  // the longest shortest form of a double has 24 characters
  out.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr);
}

/// The numbers with spaces between.
inline std::string decimals(std::initializer_list<double> values) {
  std::string out;
  for (const double value : values) {
    if (!out.empty()) out += ' ';
    append_decimal(out, value + 0.0);  // -0 is 0
  }
  return out;
}

}  // namespace spherule::detail
