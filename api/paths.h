// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where results are found.
#pragma once

#include <string>

#include "api/work.h"

namespace spherule::api {

/// The path, with its query, that gives what the request makes: of options only those that differ from the defaults.
/// `result_id` is that of a model or registration.
std::string path_of(const WorkRequest& request, const std::string& result_id);

}  // namespace spherule::api
