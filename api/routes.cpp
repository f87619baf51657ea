// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/routes.h"

#include <algorithm>
#include <array>
#include <memory>
#include <new>
#include <optional>

#include "api/handlers/handlers.h"
#include "api/http/idempotency.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"

namespace spherule::api {

namespace {

template <Collection collection>
Response list(const Call& call) {
  return list_things(call, collection);
}
template <Collection collection>
Response get(const Call& call) {
  return get_thing(call, collection);
}
template <Collection collection>
Response remove(const Call& call) {
  return delete_thing(call, collection);
}

struct Route {
  Operation operation;
  Response (*handler)(const Call&);
  void (*check_type)(const Request&) = nullptr;  // of the body
};

constexpr auto kRoutes = std::to_array<Route>({
    {{"GET", "/v1/volumes"}, list<Collection::volumes>},
    {{"POST", "/v1/volumes"}, post_volume},
    {{"GET", "/v1/volumes/{volume}"}, get<Collection::volumes>},
    {{"DELETE", "/v1/volumes/{volume}"}, remove<Collection::volumes>},
    {{"GET", "/v1/volumes/{volume}/content"}, get_volume_content},
    {{"GET", "/v1/volumes/{volume}/histogram"}, get_volume_histogram},
    {{"GET", "/v1/volumes/{volume}/slices/{axis}/{index}"}, get_slice},
    {{"POST", "/v1/uploads"}, post_upload, check_first_piece},
    {{"GET", "/v1/uploads/{upload}"}, get_upload},
    {{"PATCH", "/v1/uploads/{upload}"}, patch_upload, check_piece},
    {{"DELETE", "/v1/uploads/{upload}"}, delete_upload},
    {{"GET", "/v1/models"}, list<Collection::models>},
    {{"POST", "/v1/models"}, post_model, check_model_body},
    {{"GET", "/v1/models/{model}"}, get<Collection::models>},
    {{"DELETE", "/v1/models/{model}"}, remove<Collection::models>},
    {{"GET", "/v1/models/{model}/spheres"}, get_spheres},
    {{"GET", "/v1/models/{model}/measures"}, get_measures},
    {{"GET", "/v1/models/{model}/histogram"}, get_radius_histogram},
    {{"GET", "/v1/models/{model}/checks"}, get_checks},
    {{"GET", "/v1/models/{model}/render"}, get_render},
    {{"GET", "/v1/models/{model}/exports/{format}"}, get_export},
    {{"POST", "/v1/models/{model}/simplifications"}, post_simplification, check_simplification_body},
    {{"GET", "/v1/models/{model}/tree"}, get_tree},
    {{"GET", "/v1/registrations"}, list<Collection::registrations>},
    {{"POST", "/v1/registrations"}, post_registration},
    {{"GET", "/v1/registrations/{registration}"}, get_registration},
    {{"DELETE", "/v1/registrations/{registration}"}, remove<Collection::registrations>},
    {{"GET", "/v1/registrations/{registration}/render"}, get_registration_render},
    {{"GET", "/v1/registrations/{registration}/apply"}, get_applied},
    {{"POST", "/v1/registrations/{registration}/apply"}, post_apply},
    {{"GET", "/v1/jobs"}, list_jobs},
    {{"GET", "/v1/jobs/{job}"}, get_job},
    {{"POST", "/v1/jobs/{job}/cancel"}, cancel_job},
    {{"GET", "/v1/jobs/{job}/events"}, get_job_events},
    {{"GET", "/livez"}, get_livez},
    {{"GET", "/readyz"}, get_readyz},
    {{"GET", "/metrics"}, get_metrics},
    {{"GET", "/version"}, get_version},
    {{"GET", "/openapi.yaml"}, get_contract},
    {{"GET", "/docs"}, get_docs},
});

constexpr auto kOperations = [] {
  std::array<Operation, kRoutes.size()> operations{};
  for (std::size_t i = 0; i < kRoutes.size(); ++i) operations[i] = kRoutes[i].operation;
  return operations;
}();

// The path's parameters when it fits the template.
std::optional<std::vector<std::string>> match(std::string_view pattern, std::string_view path) {
  std::vector<std::string> parameters;
  while (!pattern.empty() && !path.empty()) {
    // Both start with a slash here.
    const std::size_t pattern_end = std::min(pattern.find('/', 1), pattern.size());
    const std::size_t path_end = std::min(path.find('/', 1), path.size());
    const std::string_view wanted = pattern.substr(1, pattern_end - 1), given = path.substr(1, path_end - 1);
    if (wanted.starts_with('{')) {
      if (given.empty()) return std::nullopt;
      parameters.emplace_back(given);
    } else if (wanted != given) {
      return std::nullopt;
    }
    pattern.remove_prefix(pattern_end);
    path.remove_prefix(path_end);
  }
  if (!pattern.empty() || !path.empty()) return std::nullopt;
  return parameters;
}

// The row for a request, and what the path holds. Throws HttpError 404 and 405.
struct Found {
  const Route* route = nullptr;  // null for OPTIONS
  std::vector<std::string> parameters{};
  std::string allowed{};  // methods
};
Found find_route(const Request& request, std::string_view& asked) {
  const std::string_view method = request.method == "HEAD" ? std::string_view("GET") : request.method;
  std::string allowed;
  if (request.path.starts_with('/')) {
    for (const Route& route : kRoutes) {
      auto parameters = match(route.operation.path, request.path);
      if (!parameters) continue;
      asked = route.operation.path;
      if (route.operation.method == method) return {.route = &route, .parameters = std::move(*parameters)};
      allowed += (allowed.empty() ? "" : ", ") + std::string(route.operation.method);
      if (route.operation.method == "GET") allowed += ", HEAD";
    }
  }
  if (allowed.empty()) throw HttpError(404, "There is nothing at this path; /openapi.yaml lists what there is.");
  allowed += ", OPTIONS";
  if (request.method == "OPTIONS") return {.allowed = allowed};
  throw HttpError(405, "Use one of the methods " + allowed + " here.", {{"Allow", allowed}});
}

Response dispatch(Service& service, const Request& request, std::string_view& asked) {
  Found found = find_route(request, asked);
  if (found.route != nullptr) return found.route->handler({service, request, std::move(found.parameters)});
  Response response{.status = 204};
  response.set("Allow", found.allowed);
  if (asked.starts_with("/v1/uploads")) describe_uploads(service, response);
  return response;
}

// FNV-1a, 64 bits: tells versions of one document apart.
std::string fingerprint(std::string_view bytes) {
  std::uint64_t hash = 0xcbf29ce484222325U;
  for (const char c : bytes) hash = (hash ^ static_cast<unsigned char>(c)) * 0x100000001b3U;
  std::string tag = "\"0000000000000000\"";
  for (std::size_t i = 16; i > 0; --i, hash >>= 4) tag[i] = "0123456789abcdef"[hash & 15];
  return tag;
}

// The entity tag of an answer to GET: its own, or one of its text; empty for streams.
std::string entity_tag(const Response& response) {
  if (const std::string_view own = response.header("ETag"); !own.empty()) return std::string(own);
  const auto* text = std::get_if<std::string>(&response.body);
  return text == nullptr ? std::string() : fingerprint(*text);
}

[[noreturn]] void refuse_precondition() {
  throw HttpError(412, "The resource is not the one that If-Match names; fetch it again first.");
}

// Before something is deleted: whether it is still what the client has seen.
void check_precondition(Service& service, const Request& request) {
  const std::string_view wanted = request.header("If-Match");
  if (request.method != "DELETE" || wanted.empty()) return;
  Request look = request;
  look.method = "GET";
  look.headers.clear();
  std::string_view ignored;
  if (!matches_etag(wanted, entity_tag(dispatch(service, look, ignored)))) refuse_precondition();
}

void validate_cache(const Request& request, Response& response) {
  if ((request.method != "GET" && request.method != "HEAD") || (response.status != 200 && response.status != 206)) {
    return;
  }
  const std::string tag = entity_tag(response);
  if (tag.empty()) return;
  if (response.header("ETag").empty()) response.set("ETag", tag);
  if (const std::string_view wanted = request.header("If-Match"); !wanted.empty() && !matches_etag(wanted, tag)) {
    refuse_precondition();
  }
  if (response.header("Cache-Control").empty()) response.set("Cache-Control", "private, no-cache");
  const std::string_view known = request.header("If-None-Match");
  if (known.empty() || !matches_etag(known, tag)) return;
  response.status = 304;
  response.body = std::string();
  std::erase_if(response.headers, [](const auto& header) {
    return header.first == "Content-Type" || header.first == "Content-Disposition" || header.first == "Content-Range";
  });
}

// What `f` gives, or the problem that it throws.
template <typename F>
auto or_problem(const Request& request, F&& f) -> decltype(f()) {
  try {
    return f();
  } catch (const Error& error) {
    return problem(error, request.id);
  } catch (const HttpError& error) {
    return problem(error, request.id);
  } catch (const std::bad_alloc&) {
    return problem(Error(ErrorCode::busy, "The server is short of memory; try again later, or with less data."),
                   request.id);
  } catch (...) {
    return problem(500, request.id);
  }
}

Response answer(Service& service, const Request& request, std::string_view& asked) {
  return or_problem(request, [&] {
    check_precondition(service, request);
    Response response =
        answer_once(service, request, [&](const Request& watched) { return dispatch(service, watched, asked); });
    validate_cache(request, response);
    return response;
  });
}

void complete(const Request& request, std::string_view asked, Response& response) {
  response.route = asked;
  if (!request.id.empty()) response.set("X-Request-Id", request.id);
  response.set("X-Content-Type-Options", "nosniff");
}

}  // namespace

std::span<const Operation> operations() { return kOperations; }

Response handle(Service& service, const Request& request) {
  std::string_view asked;
  Response response = answer(service, request, asked);
  complete(request, asked, response);
  return response;
}

std::optional<Response> refused_by_head(const Request& request, std::uint64_t most_bytes) {
  std::string_view asked;
  std::optional<Response> refused = or_problem(request, [&]() -> std::optional<Response> {
    const Found found = find_route(request, asked);
    if (request.body != nullptr && request.body->announced() > most_bytes) {
      throw Error(ErrorCode::too_large, "The body is larger than the " + std::to_string(most_bytes) +
                                            " bytes that this server accepts; send less.");
    }
    if (found.route != nullptr && found.route->check_type != nullptr) found.route->check_type(request);
    return {};
  });
  if (refused) complete(request, asked, *refused);
  return refused;
}

std::string_view route_of(std::string_view path) {
  const auto found = std::ranges::find_if(
      kRoutes, [&](const Route& route) { return path.starts_with('/') && match(route.operation.path, path); });
  return found == kRoutes.end() ? std::string_view() : found->operation.path;
}

}  // namespace spherule::api
