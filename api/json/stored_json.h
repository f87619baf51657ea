// SPDX-License-Identifier: GPL-3.0-or-later
//
// JSON that only this program writes, and reads back.
#pragma once

#include <algorithm>
#include <cmath>
#include <nlohmann/json.hpp>
#include <string>
#include <string_view>

#include "core/base/error.h"

namespace spherule::api {

/// Throws unusable when a number in it is not finite: JSON has no such numbers, so that it would not read back.
template <typename Json>
void require_finite(const Json& json) {
  if (json.is_structured())
    std::ranges::for_each(json, require_finite<Json>);
  else if (json.is_number_float() && !std::isfinite(json.template get<double>()))
    throw Error(ErrorCode::unusable,
                "Figures of this object are beyond the range of floating-point numbers; check its spacing and its "
                "coordinates, and scale them.");
}

/// One line of text. Throws what require_finite throws.
template <typename Json>
std::string write_stored(const Json& json) {
  require_finite(json);
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

/// `f` of the parsed record. Throws corrupt when the record, or what `f` looks for in it, is not as it was written, or
/// is not valid any more.
template <typename F>
auto read_stored(std::string_view record, F&& f) {
  using Json = nlohmann::json;
  try {
    return f(Json::parse(record));
  } catch (const Json::exception&) {
  } catch (const Error&) {
  }
  throw Error(ErrorCode::corrupt,
              "The server's record of this resource is damaged; delete the resource and make it again.");
}

}  // namespace spherule::api
