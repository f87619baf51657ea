// SPDX-License-Identifier: GPL-3.0-or-later
//
// Pages of other origins: which may read answers (the Fetch standard's CORS protocol).
#pragma once

#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "api/http/http.h"

namespace spherule::api {

/// Origins such as "https://viewer.example"; "*" allows all. Empty: none, and nothing is said about it.
using AllowedOrigins = std::vector<std::string>;

/// Reads a list with commas between.
AllowedOrigins origins_from(std::string_view list);

/// Whether pages of this origin, as its header gives it, are allowed; none when that is empty.
bool is_allowed(const AllowedOrigins& allowed, std::string_view origin);

/// Answers a preflight of an allowed origin by itself, and lets allowed origins read every other answer. Goes around
/// all that may refuse a request: a page reads refusals too, and preflights bear no credentials.
Response with_cors(const AllowedOrigins& allowed, const Request& request, const std::function<Response()>& answer);

}  // namespace spherule::api
