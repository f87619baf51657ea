// SPDX-License-Identifier: GPL-3.0-or-later
//
// What several handlers answer with: documents, stored contents and parts of them, results and jobs.
#include <algorithm>
#include <array>
#include <memory>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "api/json/documents.h"
#include "api/paths.h"

namespace spherule::api {

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

std::string json_body(const Call& call) {
  constexpr std::uint64_t most = 1 << 20;
  std::string text;
  call.request.body->read(most, [&](std::string_view piece) { text += piece; });
  return text;
}

Wait agreed_wait(const Call& call, bool waits_unasked) {
  const std::chrono::seconds cap = call.service.limits().longest_wait;
  const auto preferred = preferred_wait(call.request);
  return {std::min(preferred.value_or(waits_unasked ? cap : std::chrono::seconds(0)), cap), preferred.has_value()};
}

namespace {

Response accepted(const JobInfo& job) {
  Response response{.status = 202, .body = job_document(job)};
  response.set("Content-Type", "application/json");
  response.set("Location", "/v1/jobs/" + job.id);
  response.set("Retry-After", "1");
  return response;
}

}  // namespace

Response worked(const Call& call, const WorkRequest& request, const Wait& wait, const Present& present) {
  Outcome outcome = call.service.submit(request, wait.granted);
  const auto* job = std::get_if<JobInfo>(&outcome);
  Response response = job != nullptr ? accepted(*job) : present(std::get<Made>(std::move(outcome)));
  // Nothing where the wait was not granted.
  if (wait.asked && (job == nullptr || job->awaited || wait.granted.count() == 0))
    response.set("Preference-Applied", "wait=" + std::to_string(wait.granted.count()));
  return response;
}

Response stored(const Call& call, std::string document, bool already_stored, const std::string& location) {
  Response response = json_response(call, std::move(document), already_stored ? 200 : 201);
  response.set("Location", location);
  return response;
}

Response made(const Call& call, const WorkRequest& request) {
  return worked(call, request, agreed_wait(call, false), [&](const Made& result) {
    if (const auto* model = std::get_if<Stored<ModelInfo>>(&result))
      return stored(call, document_of(model->thing), model->already_stored, path_of(request, model->thing.id));
    const auto& registration = std::get<Stored<RegistrationInfo>>(result);
    return stored(call, registration.thing.document, registration.already_stored,
                  path_of(request, registration.thing.id));
  });
}

Response derived(const Call& call, const DerivedRequest& request, std::string_view type, const std::string& filename) {
  negotiate(call.request.header("Accept"), std::span(&type, 1));
  return worked(call, request, agreed_wait(call, true), [&](Made result) {
    return content_response(call, std::get<Content>(std::move(result)), std::string(type), filename);
  });
}

std::string text_of(const Content& content) {
  std::string text(content.bytes, '\0');
  text.resize(content.read_at(0, text));
  return text;
}

}  // namespace spherule::api
