// SPDX-License-Identifier: GPL-3.0-or-later
//
// Labels as JSON numbers: every whole number that a sample may be, without loss.
#pragma once

#include <nlohmann/json.hpp>
#include <optional>
#include <vector>

#include "core/inside.h"

namespace spherule::api {

/// Nothing unless the value is a whole number that was not rounded.
inline std::optional<Label> label_from(const nlohmann::json& value) {
  if (value.is_number_unsigned()) return value.get<std::uint64_t>();
  if (value.is_number_integer()) return value.get<std::int64_t>();
  return std::nullopt;
}

/// An array of them.
inline nlohmann::json labels_json(const std::vector<Label>& labels) {
  nlohmann::json array = nlohmann::json::array();
  for (const Label label : labels) {
    if (label < 0) {
      array.push_back(static_cast<std::int64_t>(label));
    } else {
      array.push_back(static_cast<std::uint64_t>(label));
    }
  }
  return array;
}

}  // namespace spherule::api
