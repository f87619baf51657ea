// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/head.h"

#include <strings.h>

#include <algorithm>
#include <charconv>

namespace spherule::server {

namespace {

bool is_digit(char c) { return c >= '0' && c <= '9'; }
bool is_letter(char c) { return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z'); }
// RFC 9110, 5.6.2.
bool is_token_character(char c) {
  return is_letter(c) || is_digit(c) || std::string_view("!#$%&'*+-.^_`|~").find(c) != std::string_view::npos;
}
bool is_token(std::string_view text) { return !text.empty() && std::ranges::all_of(text, is_token_character); }
// RFC 9110, 5.5: visible, white space between, or above ASCII.
bool is_value_character(char c) { return c == '\t' || (static_cast<unsigned char>(c) >= 0x20 && c != 0x7f); }
bool is_target_character(char c) { return static_cast<unsigned char>(c) > 0x20 && c != 0x7f && c != '#'; }

bool same(std::string_view a, std::string_view b) {
  return a.size() == b.size() && ::strncasecmp(a.data(), b.data(), a.size()) == 0;
}

std::string_view trimmed(std::string_view text) {
  while (!text.empty() && (text.front() == ' ' || text.front() == '\t')) text.remove_prefix(1);
  while (!text.empty() && (text.back() == ' ' || text.back() == '\t')) text.remove_suffix(1);
  return text;
}

// Whether a list with commas between has this member.
bool lists(std::string_view list, std::string_view member) {
  while (!list.empty()) {
    const std::size_t end = std::min(list.find(','), list.size());
    if (same(trimmed(list.substr(0, end)), member)) return true;
    list.remove_prefix(std::min(end + 1, list.size()));
  }
  return false;
}

constexpr HeadRefusal kLine{400, "End every line of a request's head with CR LF, and use neither of them elsewhere."};
constexpr HeadRefusal kRequestLine{400, "Begin a request with a line such as: GET /v1/volumes HTTP/1.1."};
constexpr HeadRefusal kField{
    400, "Write every header as NAME: VALUE on a line of its own, without spaces before the colon or control codes."};
constexpr HeadRefusal kLength{400, "Send one Content-Length, or Transfer-Encoding: chunked, and not both."};
constexpr HeadRefusal kHost{400, "Send one Host header that names this server."};
constexpr HeadRefusal kLong{431, "Send fewer or shorter headers."};
constexpr HeadRefusal kTarget{414, "Send a shorter URL."};
constexpr HeadRefusal kExpect{417, "Send no Expect header but 100-continue."};

using Refused = std::optional<HeadRefusal>;

// http://host/path names the host itself, into `authority`.
Refused take_target(std::string_view target, Head& head, std::string& authority) {
  if (!std::ranges::all_of(target, is_target_character)) return kRequestLine;
  for (const std::string_view scheme : {"http://", "https://"}) {
    if (target.size() < scheme.size() || !same(target.substr(0, scheme.size()), scheme)) continue;
    target.remove_prefix(scheme.size());
    const std::size_t end = std::min(target.find_first_of("/?"), target.size());
    authority = target.substr(0, end);
    if (!host_name(authority)) return kRequestLine;
    target.remove_prefix(end);
    head.target = target.starts_with('/') ? "" : "/";
    head.target += target;
    return {};
  }
  if (!target.starts_with('/') && target != "*") return kRequestLine;
  head.target = target;
  return {};
}

Refused take_request_line(std::string_view line, const HeadLimits& limits, Head& head, std::string& authority) {
  const std::size_t first = line.find(' '), last = line.rfind(' ');
  if (first == line.npos || first == last) return kRequestLine;
  const std::string_view method = line.substr(0, first), target = line.substr(first + 1, last - first - 1),
                         version = line.substr(last + 1);
  if (!is_token(method) || (version != "HTTP/1.1" && version != "HTTP/1.0")) return kRequestLine;
  if (target.size() > limits.target) return kTarget;
  head.method = method;
  head.version_1_0 = version == "HTTP/1.0";
  return take_target(target, head, authority);
}

Refused take_lengths(Head& head) {
  std::size_t lengths = 0, codings = 0;
  for (const auto& [name, value] : head.fields) {
    if (same(name, "Content-Length")) {
      const bool digits = std::ranges::all_of(value, is_digit);
      const auto [end, error] = std::from_chars(value.data(), value.data() + value.size(), head.length);
      if (++lengths > 1 || !digits || error != std::errc{} || end != value.data() + value.size()) return kLength;
    } else if (same(name, "Transfer-Encoding")) {
      head.chunked = true;
      if (++codings > 1 || !same(value, "chunked")) return kLength;
    }
  }
  // HTTP/1.0 knows no chunks: who stands between us and such a client may see another request (RFC 9112, 6.1).
  if (codings > 0 && (lengths > 0 || head.version_1_0)) return kLength;
  return {};
}

// What the fields mean for the connection, once all are there.
Refused conclude(Head& head, const std::string& authority) {
  std::size_t hosts = 0;
  bool close = false, keep = false;
  for (auto& [name, value] : head.fields) {
    if (same(name, "Host")) {
      if (++hosts > 1 || !host_name(value)) return kHost;
      // The target's goes before it (RFC 9112, 3.2.2).
      if (!authority.empty()) value = authority;
    }
    if (same(name, "Connection")) {
      close = close || lists(value, "close");
      keep = keep || lists(value, "keep-alive");
    }
    if (same(name, "Expect")) {
      if (!same(value, "100-continue")) return kExpect;
      head.expects_continue = !head.version_1_0;
    }
  }
  if (hosts == 0 && !head.version_1_0) return kHost;
  if (hosts == 0 && !authority.empty()) head.fields.emplace_back("Host", authority);
  head.persistent = !close && (keep || !head.version_1_0);
  return take_lengths(head);
}

}  // namespace

std::string_view Head::field(std::string_view name) const {
  const auto found = std::ranges::find_if(fields, [&](const auto& field) { return same(field.first, name); });
  return found == fields.end() ? std::string_view() : std::string_view(found->second);
}

std::optional<std::pair<std::string, std::string>> parse_field(std::string_view line) {
  const std::size_t colon = line.find(':');
  if (colon == line.npos || !is_token(line.substr(0, colon))) return {};
  const std::string_view value = trimmed(line.substr(colon + 1));
  if (!std::ranges::all_of(value, is_value_character)) return {};
  return std::pair(std::string(line.substr(0, colon)), std::string(value));
}

std::optional<std::string> host_name(std::string_view authority) {
  std::size_t end = std::min(authority.find(':'), authority.size());
  if (authority.starts_with('[')) {
    end = authority.find(']');
    if (end == authority.npos) return {};
    const std::string_view address = authority.substr(1, end - 1);
    if (address.empty() || address.find_first_not_of("0123456789abcdefABCDEF:.") != address.npos) return {};
    ++end;
  } else if (end == 0 || !std::ranges::all_of(authority.substr(0, end), [](char c) {
               return is_letter(c) || is_digit(c) ||
                      std::string_view("-._~%!$&'()*+,;=").find(c) != std::string_view::npos;
             })) {
    return {};
  }
  const std::string_view port = authority.substr(end);
  if (!port.empty() && (port.front() != ':' || !std::ranges::all_of(port.substr(1), is_digit))) return {};
  std::string name(authority.substr(0, end));
  std::ranges::transform(name, name.begin(),
                         [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; });
  return name;
}

std::size_t HeadReader::feed(std::string_view bytes) {
  std::size_t taken = 0;
  while (taken < bytes.size() && !complete_ && !refusal_) {
    const std::string_view rest = bytes.substr(taken);
    const std::size_t end = rest.find('\n');
    const std::size_t count = end == rest.npos ? rest.size() : end + 1;
    if (count > limits_.bytes - read_) {
      refusal_ = head_.method.empty() ? kTarget : kLong;
      break;
    }
    line_.append(rest.substr(0, count));
    read_ += count;
    taken += count;
    if (end == rest.npos) break;
    if (line_.size() < 2 || line_[line_.size() - 2] != '\r') {
      refusal_ = kLine;
      break;
    }
    const std::string line = std::exchange(line_, {});
    take_line(std::string_view(line).substr(0, line.size() - 2));
  }
  return taken;
}

void HeadReader::take_line(std::string_view line) {
  if (line.find('\r') != line.npos) {
    refusal_ = kLine;
  } else if (head_.method.empty()) {
    // One empty line before a request is forgiven (RFC 9112, 2.2).
    if (line.empty() && read_ == 2) return;
    refusal_ = take_request_line(line, limits_, head_, authority_);
  } else if (!line.empty()) {
    auto field = parse_field(line);
    if (!field) {
      refusal_ = kField;
    } else if (head_.fields.size() == limits_.fields) {
      refusal_ = kLong;
    } else {
      head_.fields.push_back(std::move(*field));
    }
  } else {
    refusal_ = conclude(head_, authority_);
    complete_ = !refusal_;
  }
}

Head HeadReader::take() {
  complete_ = false;
  read_ = 0;
  authority_.clear();
  return std::exchange(head_, {});
}

Target parse_target(std::string_view target) {
  const auto decoded = [](std::string_view text, bool plus) {
    const auto digit = [](char c) -> int {
      return is_digit(c) ? c - '0' : c >= 'a' && c <= 'f' ? c - 'a' + 10 : c >= 'A' && c <= 'F' ? c - 'A' + 10 : -1;
    };
    std::string out;
    for (std::size_t i = 0; i < text.size(); ++i) {
      if (text[i] == '%' && i + 2 < text.size() && digit(text[i + 1]) >= 0 && digit(text[i + 2]) >= 0) {
        out += static_cast<char>(digit(text[i + 1]) * 16 + digit(text[i + 2]));
        i += 2;
      } else {
        out += plus && text[i] == '+' ? ' ' : text[i];
      }
    }
    return out;
  };
  const std::size_t mark = std::min(target.find('?'), target.size());
  Target result{.path = decoded(target.substr(0, mark), false), .query = {}};
  target.remove_prefix(std::min(mark + 1, target.size()));
  while (!target.empty()) {
    const std::string_view pair = target.substr(0, target.find('&'));
    target.remove_prefix(std::min(pair.size() + 1, target.size()));
    const std::size_t equals = std::min(pair.find('='), pair.size());
    if (pair.empty()) continue;
    result.query.emplace_back(decoded(pair.substr(0, equals), true),
                              decoded(pair.substr(std::min(equals + 1, pair.size())), true));
  }
  return result;
}

}  // namespace spherule::server
