// SPDX-License-Identifier: GPL-3.0-or-later
//
// The whole REST interface as one function: an HTTP request as a value in, the response as a value out.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string_view>

#include "api/http/http.h"

namespace spherule::api {

/// Answers any request; never throws. HEAD is answered as GET (the listener leaves the body out). Every error becomes a
/// problem document. May block for as long as the request allows (uploads; `Prefer: wait`). Thread safe.
Response handle(Service& service, const Request& request);

/// What `handle` would refuse for the request's head alone, without its body: paths that name nothing (404), methods
/// (405), bodies announced larger than `most_bytes` (413), media types (415). Does not read the body; never throws.
std::optional<Response> refused_by_head(const Request& request, std::uint64_t most_bytes);

/// The template of a path, for logs; empty when nothing is there.
std::string_view route_of(std::string_view path);

/// The rows of the route table, in the order of openapi.yaml. Path parameters stand in braces.
struct Operation {
  std::string_view method;
  std::string_view path;
};
std::span<const Operation> operations();

/// The text of openapi.yaml.
std::string_view contract();

/// Version of the build that this is part of.
std::string_view program_version();

}  // namespace spherule::api
