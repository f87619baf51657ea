// SPDX-License-Identifier: GPL-3.0-or-later
//
// What parsers of options share.
#pragma once

#include <string>
#include <string_view>

#include "core/base/error.h"

namespace spherule::detail {

[[noreturn]] inline void refuse_option(std::string_view name, const std::string& detail) {
  throw Error(ErrorCode::invalid_argument, "Correct the option " + std::string(name) + ": " + detail,
              {{std::string(name), detail}});
}

}  // namespace spherule::detail
