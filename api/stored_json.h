// SPDX-License-Identifier: GPL-3.0-or-later
//
// Reading back JSON that only this program writes.
#pragma once

#include <nlohmann/json.hpp>
#include <string_view>

#include "core/base/error.h"

namespace spherule::api {

/// `f` of the parsed record. Throws corrupt when the record, or what `f` looks for in it, is not as it was written.
template <typename F>
auto read_stored(std::string_view record, F&& f) {
  using Json = nlohmann::json;
  try {
    return f(Json::parse(record));
  } catch (const Json::exception&) {
    throw Error(ErrorCode::corrupt,
                "The server's record of this resource is damaged; delete the resource and make it again.");
  }
}

}  // namespace spherule::api
