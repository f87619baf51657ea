// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/access/gate.h"

#include <algorithm>
#include <array>

#include "api/http/problem.h"
#include "api/routes.h"
#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/http/head.h"

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
  constexpr std::array<std::string_view, 5> prefixes = {"vol", "mdl", "reg", "upl", "job"};
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

template <typename Problem>
Response refused_as(const Request& request, const Problem& error) {
  Response response = api::problem(error, request.id);
  response.route = api::route_of(request.path);
  if (!request.id.empty()) response.set("X-Request-Id", request.id);
  return response;
}

std::string lower(std::string_view text) {
  std::string result(text);
  std::ranges::transform(result, result.begin(),
                         [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  return result;
}

}  // namespace

std::optional<Response> Gate::misplaced(const Request& request) const {
  const bool open = options_.keys.empty();
  if (!open && options_.hosts.empty()) return {};
  const std::string_view host = request.header("Host");
  if (!host.empty()) {
    const auto name = host_name(host);
    if (!name || (!is_loopback_name(*name) && std::ranges::find(options_.hosts, *name) == options_.hosts.end())) {
      return refused_as(request, HttpError(403,
                                           "Ask for this server by the name localhost, or by one that its operator has "
                                           "listed as its own (hosts)."));
    }
  }
  if (!open || !changes(request)) return {};
  const std::string_view origin = request.header("Origin"), site = request.header("Sec-Fetch-Site");
  const bool own = origin.empty()
                       ? site.empty() || site == "same-origin" || site == "none"
                       : lower(origin) == "http://" + lower(host) || lower(origin) == "https://" + lower(host);
  if (own || api::is_allowed(options_.origins, origin)) return {};
  return refused_as(request,
                    HttpError(403,
                              "Pages of other origins may change nothing here, unless the server's operator has "
                              "listed theirs (cors_origins)."));
}

Gate::Judgement Gate::judge(const Request& request) const {
  if (auto refused = misplaced(request)) return {.client = {}, .refused = std::move(refused)};
  const auto needed = needed_scope(request.method, request.path);
  if (!needed || options_.keys.empty()) return {.client = "local"};
  const ApiKey* key = find_key(options_.keys, request.header("Authorization"));
  if (key == nullptr) {
    return {.client = {},
            .refused = refused_as(request, HttpError(401, "Send a key of this server: Authorization: Bearer TOKEN.",
                                                     {{"WWW-Authenticate", "Bearer realm=\"spherule\""}}))};
  }
  if (key->scope >= *needed) return {.client = key->name};
  const std::string scope(to_string(*needed));
  return {
      .client = key->name,
      .refused = refused_as(
          request, HttpError(403,
                             "This needs a key with the scope " + scope + ", and this one has " +
                                 std::string(to_string(key->scope)) + ".",
                             {{"WWW-Authenticate",
                               "Bearer realm=\"spherule\", error=\"insufficient_scope\", scope=\"" + scope + "\""}}))};
}

std::optional<Response> Gate::refusal(const Request& request) const {
  Judgement judged = judge(request);
  if (judged.refused) write_down(request, *judged.refused, judged.client);
  return std::move(judged.refused);
}

Response Gate::pass(const Request& request, const Next& next) const {
  const Judgement judged = judge(request);
  if (judged.refused) {
    write_down(request, *judged.refused, judged.client);
    return *judged.refused;
  }
  Response response = with_place(request, next(judged.client), judged.client);
  if (needed_scope(request.method, request.path)) write_down(request, response, judged.client);
  return response;
}

Response Gate::with_place(const Request& request, Response response, const std::string& client) const {
  auto* events = std::get_if<api::EventSource>(&response.body);
  if (events == nullptr) return response;
  {
    const std::lock_guard lock(places_->mutex);
    std::size_t& taken = places_->taken[client];
    if (taken >= options_.streams_of_client) {
      return refused_as(request, Error(ErrorCode::throttled,
                                       "You have too many event streams open; close some, or poll the job instead."));
    }
    ++taken;
  }
  // Given back with the last copy of the source.
  const std::shared_ptr<void> place(nullptr, [places = places_, client](void*) {
    const std::lock_guard lock(places->mutex);
    --places->taken[client];
  });
  response.body = [place, next = std::move(*events)](std::string& out) { return next(out); };
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
