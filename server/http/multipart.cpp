// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/multipart.h"

#include <algorithm>

#include "core/base/error.h"
#include "server/http/head.h"

namespace spherule::server {

namespace {

constexpr std::size_t kLongestBoundary = 70;  // RFC 2046, 5.1.1
constexpr std::size_t kLongestHead = 1 << 13;

[[noreturn]] void refuse(const char* sentence) { throw Error(ErrorCode::malformed, sentence); }
constexpr const char* kNoForm = "The multipart body is cut short or malformed; send it again whole.";

bool same(std::string_view a, std::string_view b) {
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; };
  return std::ranges::equal(a, b, {}, lower, lower);
}

// The value of a parameter after the first word: `; name=token` or `; name="text with \" in it"`.
std::string parameter(std::string_view text, std::string_view wanted) {
  std::size_t at = text.find(';');
  while (at < text.size()) {
    at = text.find_first_not_of("; \t", at);
    if (at == text.npos) break;
    const std::size_t equals = text.find('=', at);
    if (equals == text.npos) break;
    const std::string_view name = text.substr(at, equals - at);
    std::string value;
    at = equals + 1;
    if (at < text.size() && text[at] == '"') {
      for (++at; at < text.size() && text[at] != '"'; ++at) {
        // Other backslashes are part of a name.
        if (text[at] == '\\' && at + 1 < text.size() && (text[at + 1] == '"' || text[at + 1] == '\\')) ++at;
        value += text[at];
      }
      ++at;
    } else {
      const std::size_t end = std::min(text.find_first_of("; \t", at), text.size());
      value = text.substr(at, end - at);
      at = end;
    }
    if (same(name, wanted)) return value;
  }
  return {};
}

struct Part {
  std::string name, filename;
};
Part parse_head(std::string_view head) {
  Part part;
  bool named = false;
  while (!head.empty()) {
    const std::size_t end = std::min(head.find("\r\n"), head.size());
    const auto field = parse_field(head.substr(0, end));
    if (!field) refuse(kNoForm);
    if (same(field->first, "Content-Disposition")) {
      named = true;
      part = {parameter(field->second, "name"), parameter(field->second, "filename")};
    }
    head.remove_prefix(std::min(end + 2, head.size()));
  }
  if (!named) refuse(kNoForm);
  return part;
}

}  // namespace

MultipartReader::MultipartReader(std::string_view content_type) {
  const std::string boundary = parameter(content_type, "boundary");
  if (boundary.empty() || boundary.size() > kLongestBoundary) {
    refuse("Give the boundary of the multipart body in its Content-Type.");
  }
  delimiter_ = "\r\n--" + boundary;
  held_ = "\r\n";  // as if a line came before the first delimiter
}

void MultipartReader::feed(std::string_view bytes, const api::Body::BeginPart& begin, const api::Body::Take& take) {
  if (ended()) return;  // what follows the end means nothing
  held_ += bytes;
  while (step(begin, take)) {
  }
}

// One step further; false when that needs more bytes.
bool MultipartReader::step(const api::Body::BeginPart& begin, const api::Body::Take& take) {
  switch (state_) {
    case State::preamble:
    case State::content: {
      const std::size_t at = held_.find(delimiter_);
      // What may be the beginning of a delimiter waits.
      const std::size_t sure = at != held_.npos ? at : held_.size() - std::min(held_.size(), delimiter_.size() - 1);
      if (state_ == State::content && sure > 0) take(std::string_view(held_).substr(0, sure));
      if (state_ == State::preamble) preamble_ += sure;
      if (preamble_ > kLongestHead) refuse(kNoForm);
      held_.erase(0, at != held_.npos ? at + delimiter_.size() : sure);
      if (at == held_.npos) return false;
      state_ = State::delimiter;
      return true;
    }
    case State::delimiter: {
      const std::size_t end = held_.find_first_not_of(" \t");
      if (end == held_.npos || held_.size() - end < 2) {
        if (held_.size() > kLongestHead) refuse(kNoForm);
        return false;
      }
      const std::string_view next = std::string_view(held_).substr(end, 2);
      if (next != "\r\n" && (end > 0 || next != "--")) refuse(kNoForm);
      state_ = next == "--" ? State::epilogue : State::head;
      // The line's end stays: with it, a head without fields ends like any other.
      held_.erase(0, end);
      return state_ == State::head;
    }
    case State::head: {
      const std::size_t end = held_.find("\r\n\r\n");
      if (std::min(end, held_.size()) > kLongestHead) refuse("Send shorter headers with each part of the form.");
      if (end == held_.npos) return false;
      const Part part =
          parse_head(std::string_view(held_).substr(std::min<std::size_t>(2, end), end < 2 ? 0 : end - 2));
      held_.erase(0, end + 4);
      begin(part.name, part.filename);
      // The delimiter's first line break may follow the head at once.
      state_ = State::content;
      return true;
    }
    case State::epilogue: break;
  }
  return false;
}

}  // namespace spherule::server
