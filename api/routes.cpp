// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/routes.h"

#include <algorithm>
#include <array>
#include <memory>
#include <new>
#include <optional>

#include "api/handlers/handlers.h"
#include "api/http/idempotency.h"
#include "api/http/problem.h"
#include "api/requests.h"

namespace spherule::api {

namespace {

struct Route {
  Operation operation;
  Response (*handler)(const Call&);
  void (*check_type)(const Request&) = nullptr;  // of the body
};

constexpr auto kRoutes = std::to_array<Route>({
    {{"GET", "/v1/volumes"}, list_volumes},
    {{"POST", "/v1/volumes"}, post_volume},
    {{"GET", "/v1/volumes/{volume}"}, get_volume},
    {{"DELETE", "/v1/volumes/{volume}"}, delete_volume},
    {{"GET", "/v1/volumes/{volume}/content"}, get_volume_content},
    {{"GET", "/v1/volumes/{volume}/histogram"}, get_volume_histogram},
    {{"GET", "/v1/volumes/{volume}/slices/{axis}/{index}"}, get_slice},
    {{"POST", "/v1/uploads"}, post_upload, check_first_piece},
    {{"GET", "/v1/uploads/{upload}"}, get_upload},
    {{"PATCH", "/v1/uploads/{upload}"}, patch_upload, check_piece},
    {{"DELETE", "/v1/uploads/{upload}"}, delete_upload},
    {{"GET", "/v1/models"}, list_models},
    {{"POST", "/v1/models"}, post_model, check_model_body},
    {{"GET", "/v1/models/{model}"}, get_model},
    {{"DELETE", "/v1/models/{model}"}, delete_model},
    {{"GET", "/v1/models/{model}/spheres"}, get_spheres},
    {{"GET", "/v1/models/{model}/measures"}, get_measures},
    {{"GET", "/v1/models/{model}/histogram"}, get_radius_histogram},
    {{"GET", "/v1/models/{model}/checks"}, get_checks},
    {{"GET", "/v1/models/{model}/render"}, get_render},
    {{"GET", "/v1/models/{model}/exports/{format}"}, get_export},
    {{"POST", "/v1/models/{model}/simplifications"}, post_simplification, check_simplification_body},
    {{"GET", "/v1/models/{model}/tree"}, get_tree},
    {{"GET", "/v1/registrations"}, list_registrations},
    {{"POST", "/v1/registrations"}, post_registration},
    {{"GET", "/v1/registrations/{registration}"}, get_registration},
    {{"DELETE", "/v1/registrations/{registration}"}, delete_registration},
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

Response json_response(const Call& call, std::string document, int status) {
  constexpr std::array<std::string_view, 1> types = {"application/json"};
  negotiate(call.request.header("Accept"), types);
  Response response{.status = status, .body = std::move(document)};
  response.set("Content-Type", "application/json");
  return response;
}

namespace {

std::string content_range(const ByteRange& range, std::uint64_t bytes) {
  return "bytes " + std::to_string(range.offset) + "-" + std::to_string(range.offset + range.length - 1) + "/" +
         std::to_string(bytes);
}

// Several ranges of a content as one: multipart/byteranges (RFC 9110, 14.6).
class Multipart {
 public:
  Multipart(Content content, const std::vector<ByteRange>& ranges, const std::string& type, const std::string& boundary)
      : content_(std::move(content)) {
    for (const ByteRange& range : ranges) {
      pieces_.push_back({.text = "\r\n--" + boundary + "\r\nContent-Type: " + type +
                                 "\r\nContent-Range: " + content_range(range, content_.bytes) + "\r\n\r\n",
                         .range = {}});
      pieces_.push_back({.text = {}, .range = range});
    }
    pieces_.push_back({.text = "\r\n--" + boundary + "--\r\n", .range = {}});
  }

  std::uint64_t bytes() const {
    std::uint64_t sum = 0;
    for (const Piece& piece : pieces_) sum += piece.bytes();
    return sum;
  }

  /// As Content's.
  std::size_t read_at(std::uint64_t offset, std::span<char> out) const {
    std::size_t done = 0;
    for (const Piece& piece : pieces_) {
      if (offset >= piece.bytes()) {
        offset -= piece.bytes();
        continue;
      }
      const auto wanted = out.subspan(done, std::min<std::uint64_t>(out.size() - done, piece.bytes() - offset));
      const std::size_t n = piece.range.length > 0 ? content_.read_at(piece.range.offset + offset, wanted)
                                                   : piece.text.copy(wanted.data(), wanted.size(), offset);
      done += n;
      if (n < wanted.size() || done == out.size()) break;
      offset = 0;
    }
    return done;
  }

 private:
  // A text of ours, or else a range of the content.
  struct Piece {
    std::string text;
    ByteRange range;
    std::uint64_t bytes() const { return text.size() + range.length; }
  };

  Content content_;
  std::vector<Piece> pieces_;
};

}  // namespace

Response content_response(const Call& call, Content content, std::string type, const std::string& filename) {
  const std::string etag = "\"" + content.sha256 + "\"";
  const std::string_view if_range = call.request.header("If-Range");
  ContentPart part{.content = std::move(content), .offset = 0, .length = 0};
  part.length = part.content.bytes;
  Response response;
  std::vector<ByteRange> ranges;
  if (if_range.empty() || if_range == etag) ranges = byte_ranges(call.request.header("Range"), part.content.bytes);
  if (!ranges.empty()) response.status = 206;
  if (ranges.size() == 1) {
    response.set("Content-Range", content_range(ranges.front(), part.content.bytes));
    part.offset = ranges.front().offset;
    part.length = ranges.front().length;
  } else if (ranges.size() > 1) {
    // No content can be expected to hold its own digest.
    const std::string boundary = part.content.sha256;
    const auto parts = std::make_shared<const Multipart>(std::move(part.content), ranges, type, boundary);
    part.content = {.bytes = parts->bytes(), .sha256 = {}, .read_at = [parts](std::uint64_t at, std::span<char> out) {
                      return parts->read_at(at, out);
                    }};
    part.length = parts->bytes();
    type = "multipart/byteranges; boundary=" + boundary;
  }
  response.set("Content-Type", std::move(type));
  response.set("ETag", etag);
  response.set("Accept-Ranges", "bytes");
  if (!filename.empty()) response.set("Content-Disposition", "attachment; filename=\"" + filename + "\"");
  response.body = std::move(part);
  return response;
}

void link_next(Response& response, const std::string& path, const PageRequest& page, const std::string& next) {
  if (next.empty()) return;
  std::string cursor;
  for (const char c : next) {
    constexpr std::string_view hex = "0123456789ABCDEF";
    const auto byte = static_cast<unsigned char>(c);
    if ((c >= '0' && c <= '9') || (c >= 'A' && c <= 'Z') || (c >= 'a' && c <= 'z') || c == '-' || c == '_' ||
        c == '.') {
      cursor += c;
    } else {
      cursor += {'%', hex[byte >> 4], hex[byte & 15]};
    }
  }
  response.set("Link", "<" + path + "?limit=" + std::to_string(page.limit) + "&cursor=" + cursor + ">; rel=\"next\"");
}

}  // namespace spherule::api
