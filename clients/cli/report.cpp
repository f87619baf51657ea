// SPDX-License-Identifier: GPL-3.0-or-later
#include "clients/cli/report.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>

namespace spherule::cli {

void Report::heading(std::string_view text) {
  if (!plain_) std::printf("%.*s\n", static_cast<int>(text.size()), text.data());
}

void Report::row(std::string_view key, std::string_view text, std::string_view unit) {
  std::string name(key), shown(unit);
  if (plain_) {
    if (!unit.empty()) name += '_' + shown;
    std::printf("%s %.*s\n", name.c_str(), static_cast<int>(text.size()), text.data());
    return;
  }
  std::ranges::replace(name, '_', ' ');
  if (shown == "mm2") shown = "mm²";
  if (shown == "mm3") shown = "mm³";
  std::printf("  %-28s %.*s%s%s\n", name.c_str(), static_cast<int>(text.size()), text.data(), shown.empty() ? "" : " ",
              shown.c_str());
}

void Report::row(std::string_view key, std::uint64_t count) {
  std::string digits = std::to_string(count);
  if (!plain_)
    for (std::size_t i = digits.size(); i > 3; i -= 3) digits.insert(i - 3, ",");
  row(key, std::string_view(digits));
}

std::string Report::number(double value) const {
  std::array<char, 32> digits;
  const auto end =
      plain_ ? std::to_chars(digits.data(), digits.data() + digits.size(), value).ptr
             : std::to_chars(digits.data(), digits.data() + digits.size(), value, std::chars_format::general, 6).ptr;
  return {digits.data(), end};
}

void Report::row(std::string_view key, double value, std::string_view unit) {
  row(key, std::string_view(number(value)), unit);
}

void Report::row(std::string_view key, Vec3 value, std::string_view unit) {
  row(key, std::string_view(number(value.x) + ' ' + number(value.y) + ' ' + number(value.z)), unit);
}

}  // namespace spherule::cli
