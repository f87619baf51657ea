// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/gate.h"

#include <algorithm>
#include <array>

#include "api/problem.h"
#include "server/digest.h"

namespace spherule::server {

namespace {

using api::HttpError;
using api::Request;
using api::Response;

bool changes(const Request& request) {
  return request.method != "GET" && request.method != "HEAD" && request.method != "OPTIONS";
}

// The first part of a path that is an id; nothing else that a client wrote is repeated.
std::string id_in(std::string_view path) {
  constexpr std::array<std::string_view, 4> prefixes = {"vol", "mdl", "reg", "job"};
  while (!path.empty()) {
    path.remove_prefix(1);
    const std::string_view part = path.substr(0, std::min(path.find('/'), path.size()));
    if (std::ranges::any_of(prefixes, [&](std::string_view prefix) { return is_id(prefix, part); })) {
      return std::string(part);
    }
    path.remove_prefix(part.size());
  }
  return {};
}

Response refusal(const Request& request, const HttpError& error) {
  Response response = api::problem(error, request.id);
  if (!request.id.empty()) response.set("X-Request-Id", request.id);
  return response;
}

}  // namespace

Response Gate::pass(const Request& request, const Next& next) const {
  const auto needed = needed_scope(request.method, request.path);
  if (!needed || keys_.empty()) {
    Response response = next("local");
    if (needed) write_down(request, response, "local");
    return response;
  }
  const ApiKey* key = find_key(keys_, request.header("Authorization"));
  Response response = [&] {
    if (key == nullptr) {
      return refusal(request, HttpError(401, "Send a key of this server: Authorization: Bearer TOKEN.",
                                        {{"WWW-Authenticate", "Bearer realm=\"spherule\""}}));
    }
    if (key->scope < *needed) {
      return refusal(
          request, HttpError(403,
                             "This needs a key with the scope " + std::string(to_string(*needed)) +
                                 ", and this one has " + std::string(to_string(key->scope)) + ".",
                             {{"WWW-Authenticate", "Bearer realm=\"spherule\", error=\"insufficient_scope\", scope=\"" +
                                                       std::string(to_string(*needed)) + "\""}}));
    }
    return next(key->name);
  }();
  write_down(request, response, key == nullptr ? std::string() : key->name);
  return response;
}

void Gate::write_down(const Request& request, const Response& response, const std::string& who) const {
  const bool denied = response.status == 401 || response.status == 403;
  std::string object = id_in(response.header("Location"));
  if (object.empty()) object = id_in(request.path);
  if (!denied && !changes(request) && (object.empty() || object.starts_with("job_"))) return;
  LogLine line("audit");
  line.add_if("who", who)
      .add("action", (changes(request) ? request.method : "GET") + " " + std::string(response.route))
      .add_if("object", object)
      .add("outcome", denied                   ? "denied"
                      : response.status >= 400 ? "failed"
                                               : "allowed")
      .add("status", std::int64_t{response.status})
      .add_if("request", request.id)
      .add_if("trace", trace_of(request));
  // An event that the audit log cannot take is not lost with it.
  if (!audit_.append(line, changes(request) && !denied)) log(line.add("problem", "the audit log cannot be written"));
}

}  // namespace spherule::server
