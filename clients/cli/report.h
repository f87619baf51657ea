// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the command prints: an aligned table for people, or "key value" lines for scripts.
#pragma once

#include <cstdint>
#include <string>
#include <string_view>

#include "core/base/geometry.h"

namespace spherule::cli {

class Report {
 public:
  explicit Report(bool plain) : plain_(plain) {}

  /// A line above a group of rows; people only.
  void heading(std::string_view text);
  /// `key` is snake_case and the same in every release; `unit` ("mm", "mm2", "mm3", "s", "MiB") becomes its suffix.
  void row(std::string_view key, std::string_view text, std::string_view unit = {});
  void row(std::string_view key, const char* text) { row(key, std::string_view(text)); }
  void row(std::string_view key, std::uint64_t count);
  void row(std::string_view key, double value, std::string_view unit = {});
  void row(std::string_view key, Vec3 value, std::string_view unit = {});

 private:
  std::string number(double value) const;
  bool plain_;
};

}  // namespace spherule::cli
