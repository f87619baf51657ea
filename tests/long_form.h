// SPDX-License-Identifier: GPL-3.0-or-later
#pragma once

#include <cstdlib>
#include <string_view>

namespace spherule::test {

/// Whether drills run in their long form: SPHERULE_FAULTS=full.
inline bool long_form() {
  const char* form = std::getenv("SPHERULE_FAULTS");
  return form != nullptr && std::string_view(form) == "full";
}

}  // namespace spherule::test
