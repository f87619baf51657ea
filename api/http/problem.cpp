// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/http/problem.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <span>

namespace spherule::api {

namespace {

using Json = nlohmann::ordered_json;

// What is told of: an answer is not much longer than what it is about.
constexpr std::size_t kMostErrors = 10;

struct Kind {
  int status;
  const char* type;  // the last part of the stable URN
  const char* title;
};

Kind kind_of(ErrorCode code) {
  switch (code) {
    case ErrorCode::invalid_argument: return {400, "invalid-argument", "Invalid parameter"};
    case ErrorCode::malformed: return {400, "malformed", "Malformed content"};
    case ErrorCode::unknown_format: return {415, "unknown-format", "Unknown format"};
    case ErrorCode::unusable: return {422, "unusable", "Unusable content"};
    case ErrorCode::too_large: return {413, "too-large", "Over a limit"};
    case ErrorCode::not_found: return {404, "not-found", "Not found"};
    case ErrorCode::conflict: return {409, "conflict", "Conflict with the resource's state"};
    case ErrorCode::no_space: return {507, "no-space", "Storage is full"};
    case ErrorCode::busy: return {503, "busy", "Busy"};
    case ErrorCode::throttled: return {429, "throttled", "Too much at once"};
    case ErrorCode::cancelled: return {409, "cancelled", "Cancelled"};
    case ErrorCode::corrupt: return {500, "corrupt", "Stored data is damaged"};
  }
  return {500, "internal", "Internal error"};
}

// Statuses that come from HTTP itself.
struct HttpKind {
  Kind kind;
  const char* detail;
};
HttpKind kind_of(int status) {
  switch (status) {
    case 400: return {{400, "bad-request", "Bad request"}, "Send a well-formed HTTP/1.1 request."};
    case 401: return {{401, "unauthorized", "Unauthorized"}, "Send a key of this server: Authorization: Bearer TOKEN."};
    case 403: return {{403, "forbidden", "Forbidden"}, "Use a key that has the scope for this."};
    case 404: return {{404, "not-found", "Not found"}, "Use a path that /openapi.yaml lists."};
    case 405: return {{405, "method-not-allowed", "Method not allowed"}, "Use a method that the Allow header lists."};
    case 406: return {{406, "not-acceptable", "Not acceptable"}, "Ask for a media type that this resource has."};
    case 408: return {{408, "request-timeout", "Request timeout"}, "Send the whole request without pauses."};
    case 409: return {{409, "conflict", "Conflict"}, "Wait for the other request to end."};
    case 411: return {{411, "length-required", "Length required"}, "Send a Content-Length or a chunked body."};
    case 412: return {{412, "precondition-failed", "Precondition failed"}, "Fetch the resource again first."};
    case 413: return {{413, "too-large", "Over a limit"}, "Send a smaller body."};
    case 414: return {{414, "uri-too-long", "URI too long"}, "Send a shorter URL."};
    case 415: return {{415, "unsupported-media-type", "Unsupported media type"}, "Send a media type that is accepted."};
    case 416: return {{416, "range-not-satisfiable", "Range not satisfiable"}, "Ask for a range within the content."};
    case 417: return {{417, "expectation-failed", "Expectation failed"}, "Send no Expect header but 100-continue."};
    case 422: return {{422, "key-reused", "Idempotency key used before"}, "Use a new key for a new request."};
    case 431: return {{431, "headers-too-large", "Headers too large"}, "Send fewer or shorter headers."};
    case 503: return {{503, "busy", "Busy"}, "Try again in a few seconds."};
    default: break;
  }
  return {{status, "internal", "Internal error"},
          "This is a defect of the server; report it with the instance given here."};
}

Json document(const Kind& kind, const std::string& detail, const std::string& instance) {
  Json json{{"type", std::string("urn:spherule:problem:") + kind.type},
            {"title", kind.title},
            {"status", kind.status},
            {"detail", detail}};
  if (!instance.empty()) json["instance"] = instance;
  return json;
}

std::string text(const Json& json) { return json.dump(2, ' ', false, Json::error_handler_t::replace) + "\n"; }

Response response(int status, std::string body) {
  Response r{.status = status, .body = std::move(body)};
  r.set("Content-Type", "application/problem+json");
  if (status == 503 || status == 429) r.set("Retry-After", "5");
  return r;
}

}  // namespace

int status_of(ErrorCode code) { return kind_of(code).status; }

std::string problem_document(const Error& error, const std::string& instance) {
  Json json = document(kind_of(error.code()), error.what(), instance);
  if (!error.fields().empty()) {
    const std::size_t told = std::min(error.fields().size(), kMostErrors);
    Json& fields = json["errors"] = Json::array();
    for (const FieldError& field : std::span(error.fields()).first(told)) {
      fields.push_back({{"pointer", field.pointer}, {"detail", field.detail}});
    }
    if (error.fields().size() > told) json["more_errors"] = error.fields().size() - told;
  }
  return text(json);
}

Response problem(const Error& error, const std::string& instance) {
  return response(status_of(error.code()), problem_document(error, instance));
}

Response problem(const HttpError& error, const std::string& instance) {
  Response r = response(error.status(), text(document(kind_of(error.status()).kind, error.what(), instance)));
  for (const auto& [name, value] : error.headers()) r.set(name, value);
  return r;
}

Response problem(int status, const std::string& instance) {
  const HttpKind http = kind_of(status);
  return response(status, text(document(http.kind, http.detail, instance)));
}

}  // namespace spherule::api
