// SPDX-License-Identifier: GPL-3.0-or-later
//
// Resumable uploads by the tus protocol 1.0.0 (https://tus.io/protocols/resumable-upload): core, creation,
// creation-with-upload, expiration and termination. POST /v1/volumes?upload= makes a volume of finished ones.
#include <array>
#include <charconv>
#include <ctime>
#include <optional>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "api/http/query.h"
#include "api/json/documents.h"

namespace spherule::api {

namespace {

constexpr std::string_view kVersion = "1.0.0";
constexpr std::string_view kPieceType = "application/offset+octet-stream";

void check_version(const Request& request) {
  const std::string_view version = request.header("Tus-Resumable");
  if (!version.empty() && version != kVersion) {
    throw HttpError(412, "Speak version 1.0.0 of the tus protocol.", {{"Tus-Version", std::string(kVersion)}});
  }
}

// A header that is a count of bytes.
std::optional<std::uint64_t> byte_count(const Request& request, std::string_view name) {
  const std::string_view text = request.header(name);
  if (text.empty()) return std::nullopt;
  std::uint64_t value = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  constexpr auto most = static_cast<std::uint64_t>(ranges::bytes.most);
  if (error != std::errc{} || end != text.data() + text.size() || value > most) {
    throw Error(ErrorCode::invalid_argument,
                "Give a whole number of bytes " + ranges::bytes.words() + " as " + std::string(name) + ".");
  }
  return value;
}

std::string from_base64(std::string_view text) {
  constexpr std::string_view alphabet = "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
  while (text.ends_with('=')) text.remove_suffix(1);
  std::string out;
  unsigned bits = 0, count = 0;
  for (const char c : text) {
    const std::size_t digit = alphabet.find(c);
    if (digit == alphabet.npos) {
      throw Error(ErrorCode::invalid_argument, "Write the values of Upload-Metadata in base64.");
    }
    bits = (bits << 6 | static_cast<unsigned>(digit)) & 0xffffU;
    count += 6;
    if (count >= 8) {
      count -= 8;
      out += static_cast<char>(bits >> count & 0xffU);
    }
  }
  return out;
}

// `filename` of "key base64, key base64"; what else is there is the client's own business.
std::string filename_of(std::string_view metadata) {
  while (!metadata.empty()) {
    std::string_view pair = metadata.substr(0, metadata.find(','));
    metadata.remove_prefix(std::min(pair.size() + 1, metadata.size()));
    while (pair.starts_with(' ')) pair.remove_prefix(1);
    const std::size_t space = std::min(pair.find(' '), pair.size());
    if (pair.substr(0, space) != "filename") continue;
    std::string name = from_base64(pair.substr(std::min(space + 1, pair.size())));
    if (!is_utf8(name)) throw Error(ErrorCode::invalid_argument, "Name the file in UTF-8.");
    return name;
  }
  return {};
}

// RFC 9110's date.
std::string http_date(Time time) {
  const std::time_t seconds = std::chrono::system_clock::to_time_t(time);
  std::tm parts{};
  gmtime_r(&seconds, &parts);
  constexpr std::array days = {"Sun", "Mon", "Tue", "Wed", "Thu", "Fri", "Sat"};
  constexpr std::array months = {"Jan", "Feb", "Mar", "Apr", "May", "Jun", "Jul", "Aug", "Sep", "Oct", "Nov", "Dec"};
  std::array<char, 40> text{};
  std::snprintf(text.data(), text.size(), "%s, %02d %s %04d %02d:%02d:%02d GMT",
                days.at(static_cast<std::size_t>(parts.tm_wday)), parts.tm_mday,
                months.at(static_cast<std::size_t>(parts.tm_mon)), parts.tm_year + 1900, parts.tm_hour, parts.tm_min,
                parts.tm_sec);
  return text.data();
}

void tell(Response& response, const UploadInfo& upload) {
  response.set("Tus-Resumable", std::string(kVersion));
  response.set("Upload-Offset", std::to_string(upload.offset));
  response.set("Upload-Expires", http_date(upload.expires));
  response.set("Cache-Control", "no-store");
}

// Appends the body. All that arrives of it stays, also when it breaks off.
UploadInfo append(const Call& call, const std::string& id, std::uint64_t offset) {
  return call.service.partial_uploads().append(id, offset, [&](const Body::Take& take) {
    if (call.request.body != nullptr) call.request.body->read(call.service.limits().upload_bytes, take);
  });
}

bool has_body(const Request& request) { return request.body != nullptr && request.body->present(); }

}  // namespace

void check_first_piece(const Request& request) {
  if (has_body(request) && media_type(request.header("Content-Type")) != kPieceType) {
    throw HttpError(415, "Send the first bytes as " + std::string(kPieceType) + ", or none.");
  }
}

void check_piece(const Request& request) {
  if (media_type(request.header("Content-Type")) != kPieceType) {
    throw HttpError(415, "Send the bytes as " + std::string(kPieceType) + ".");
  }
}

void describe_uploads(Service& service, Response& response) {
  response.set("Tus-Resumable", std::string(kVersion));
  response.set("Tus-Version", std::string(kVersion));
  response.set("Tus-Extension", "creation,creation-with-upload,expiration,termination");
  response.set("Tus-Max-Size", std::to_string(service.limits().upload_bytes));
}

Response post_upload(const Call& call) {
  const Query query(call.request, {});
  check_version(call.request);
  const auto length = byte_count(call.request, "Upload-Length");
  if (!length) throw Error(ErrorCode::invalid_argument, "Announce the size of the whole upload as Upload-Length.");
  check_first_piece(call.request);
  UploadInfo upload =
      call.service.partial_uploads().create(*length, filename_of(call.request.header("Upload-Metadata")));
  if (has_body(call.request)) upload = append(call, upload.id, 0);
  Response response = json_response(call, upload_document(upload), 201);
  response.set("Location", "/v1/uploads/" + upload.id);
  tell(response, upload);
  return response;
}

Response get_upload(const Call& call) {
  const Query query(call.request, {});
  check_version(call.request);
  const UploadInfo upload = call.service.partial_uploads().find(call.id());
  Response response = json_response(call, upload_document(upload));
  response.set("Upload-Length", std::to_string(upload.length));
  tell(response, upload);
  return response;
}

Response patch_upload(const Call& call) {
  const Query query(call.request, {});
  check_version(call.request);
  check_piece(call.request);
  const auto offset = byte_count(call.request, "Upload-Offset");
  if (!offset) throw Error(ErrorCode::invalid_argument, "Say by Upload-Offset where these bytes belong.");
  const UploadInfo upload = append(call, call.id(), *offset);
  Response response{.status = 204};
  tell(response, upload);
  return response;
}

Response delete_upload(const Call& call) {
  const Query query(call.request, {});
  check_version(call.request);
  call.service.partial_uploads().remove(call.id());
  Response response{.status = 204};
  response.set("Tus-Resumable", std::string(kVersion));
  return response;
}

}  // namespace spherule::api
