// SPDX-License-Identifier: GPL-3.0-or-later
//
// Everything that api/ reads of a request: path, query, headers (Range, Accept, Prefer, tus's …) and JSON bodies. An
// input is a request as text, "GET /v1/models?limit=5", a line for every header, an empty line, the body; forms have
// "%%name" before each part. Whatever it says, there is an answer, never 500, and every error is a problem document.
#include <cstdint>
#include <cstdlib>
#include <string>
#include <string_view>

#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "api/routes.h"
#include "tests/api/stub.h"

namespace {

using namespace spherule;

void require(bool holds) {
  if (!holds) std::abort();
}

// What stands before the next `mark`, which is skipped too.
std::string_view take(std::string_view& text, std::string_view mark) {
  const std::size_t end = text.find(mark);
  const std::string_view front = text.substr(0, end);
  text.remove_prefix(end == std::string_view::npos ? text.size() : end + mark.size());
  return front;
}

class FuzzedBody final : public api::Body {
 public:
  explicit FuzzedBody(std::string_view text) : text_(text) {}
  bool present() const override { return !text_.empty(); }
  std::uint64_t announced() const override { return text_.size() % 2 == 0 ? text_.size() : 0; }
  void read(std::uint64_t limit, const Take& take) override {
    if (text_.size() > limit) throw Error(ErrorCode::too_large, "The body is larger than this server accepts.");
    const std::size_t half = text_.size() / 2;
    if (half > 0) take(text_.substr(0, half));
    if (!text_.empty()) take(text_.substr(half));
  }
  void read_parts(std::uint64_t, const BeginPart& begin, const Take& take_bytes) override {
    std::string_view rest = text_;
    take(rest, "%%");
    while (!rest.empty()) {
      std::string_view part = take(rest, "%%");
      const std::string_view name = take(part, "\n");
      begin(name.substr(0, name.size() / 2), name);
      take_bytes(part);
    }
  }

 private:
  std::string_view text_;
};

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  std::string_view text(reinterpret_cast<const char*>(data), size);
  std::string_view head = take(text, "\n\n");
  std::string_view line = take(head, "\n");
  api::Request request;
  request.method = take(line, " ");
  request.path = take(line, "?");
  while (!line.empty()) {
    std::string_view parameter = take(line, "&");
    const std::string_view name = take(parameter, "=");
    request.query.emplace_back(name, parameter);
  }
  while (!head.empty()) {
    std::string_view header = take(head, "\n");
    const std::string_view name = take(header, ": ");
    request.headers.emplace_back(name, header);
  }
  request.id = "req_0";
  FuzzedBody body(text);
  request.body = &body;

  test::StubService service;
  service.finished = size % 2 == 0;
  service.events.over = true;
  const api::Response response = api::handle(service, request);
  require(response.status >= 200 && response.status < 600 && response.status != 500);
  if (response.status >= 400) {
    require(response.header("Content-Type") == "application/problem+json");
    const auto* problem = std::get_if<std::string>(&response.body);
    require(problem != nullptr && problem->starts_with('{') && api::is_utf8(*problem));
  }
  for (const auto& [name, value] : response.headers) {
    require(!name.empty() && value.find_first_of("\r\n") == std::string::npos);
  }
  if (const auto* events = std::get_if<api::EventSource>(&response.body)) {
    std::string out;
    for (int i = 0; i < 100 && (*events)(out); ++i) require(out.size() < (1 << 20));
  }
  if (const auto* part = std::get_if<api::ContentPart>(&response.body)) {
    require(part->offset <= part->content.bytes && part->length <= part->content.bytes - part->offset);
  }
  return 0;
}
