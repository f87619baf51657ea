// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/http/cors.h"

#include <algorithm>

namespace spherule::api {

AllowedOrigins origins_from(std::string_view list) {
  AllowedOrigins origins;
  while (!list.empty()) {
    const std::size_t end = std::min(list.find(','), list.size());
    std::string_view one = list.substr(0, end);
    while (one.starts_with(' ')) one.remove_prefix(1);
    while (one.ends_with(' ') || one.ends_with('/')) one.remove_suffix(1);
    if (!one.empty()) origins.emplace_back(one);
    list.remove_prefix(std::min(end + 1, list.size()));
  }
  return origins;
}

bool is_allowed(const AllowedOrigins& allowed, std::string_view origin) {
  return !origin.empty() &&
         std::ranges::any_of(allowed, [&](const std::string& one) { return one == "*" || one == origin; });
}

Response with_cors(const AllowedOrigins& allowed, const Request& request, const std::function<Response()>& answer) {
  if (allowed.empty()) return answer();
  const std::string origin(request.header("Origin"));
  const bool reads = is_allowed(allowed, origin);
  const bool is_preflight = request.method == "OPTIONS" && !request.header("Access-Control-Request-Method").empty();
  Response response = reads && is_preflight ? Response{.status = 204} : answer();
  response.set("Vary", "Origin");
  if (!reads) return response;
  response.set("Access-Control-Allow-Origin", origin);
  if (is_preflight) {
    response.set("X-Request-Id", request.id);
    response.set("Access-Control-Allow-Methods", "GET, HEAD, POST, PATCH, DELETE");
    response.set("Access-Control-Allow-Headers",
                 "Authorization, Content-Type, Content-Encoding, Idempotency-Key, If-Match, If-None-Match, If-Range, "
                 "Last-Event-ID, Prefer, Range, traceparent, Tus-Resumable, Upload-Length, Upload-Metadata, "
                 "Upload-Offset");
    response.set("Access-Control-Max-Age", "3600");
  } else {
    response.set(
        "Access-Control-Expose-Headers",
        "Accept-Post, Accept-Ranges, Allow, Content-Disposition, Content-Range, ETag, Idempotency-Replayed, Link, "
        "Location, Preference-Applied, Retry-After, Spherule-Frame, Spherule-Unit, Tus-Extension, Tus-Max-Size, "
        "Tus-Resumable, Tus-Version, Upload-Expires, Upload-Length, Upload-Offset, WWW-Authenticate, "
        "X-Request-Id");
  }
  return response;
}

}  // namespace spherule::api
