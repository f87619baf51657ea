// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/access/auth.h"

#include <arpa/inet.h>
#include <openssl/crypto.h>

#include <algorithm>
#include <array>

#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/http/head.h"

namespace spherule::server {

namespace {

constexpr std::array<std::string_view, 3> scope_names = {"read", "write", "admin"};
constexpr std::size_t digest_digits = 64;

bool is_name(std::string_view text) {
  return !text.empty() && text.size() <= 64 && std::ranges::all_of(text, [](char c) {
    return (c >= 'a' && c <= 'z') || (c >= 'A' && c <= 'Z') || (c >= '0' && c <= '9') || c == '.' || c == '_' ||
           c == '-';
  });
}

bool is_digest(std::string_view text) {
  return text.size() == digest_digits &&
         std::ranges::all_of(text, [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); });
}

}  // namespace

std::string_view to_string(Scope scope) { return scope_names[static_cast<std::size_t>(scope)]; }

Scope scope_from(std::string_view text) {
  const auto found = std::ranges::find(scope_names, text);
  if (found == scope_names.end()) {
    throw Error(ErrorCode::invalid_argument, "A key's scope is read, write or admin.");
  }
  return static_cast<Scope>(found - scope_names.begin());
}

ApiKey key_from(std::string_view text) {
  const std::size_t first = text.find(':'), last = text.rfind(':');
  if (first == last || !is_name(text.substr(0, first)) || !is_digest(text.substr(last + 1))) {
    throw Error(
        ErrorCode::invalid_argument,
        "A key is written NAME:SCOPE:SHA256, with a name of letters, digits and ._- and 64 lower-case hex digits; "
        "`spheruled key NAME` makes one.");
  }
  return {std::string(text.substr(0, first)), scope_from(text.substr(first + 1, last - first - 1)),
          std::string(text.substr(last + 1))};
}

std::string to_string(const ApiKey& key) {
  return key.name + ":" + std::string(to_string(key.scope)) + ":" + key.sha256;
}

std::string new_token() { return random_id("sph") + random_id("").substr(1); }

const ApiKey* find_key(std::span<const ApiKey> keys, std::string_view authorization) {
  constexpr std::string_view scheme = "bearer ";
  const bool bearer = authorization.size() > scheme.size() &&
                      std::ranges::equal(authorization.substr(0, scheme.size()), scheme, {},
                                         [](char c) { return c >= 'A' && c <= 'Z' ? c + 32 : c; });
  if (!bearer) return nullptr;
  const std::string shown = sha256_hex(authorization.substr(scheme.size()));
  const ApiKey* found = nullptr;
  for (const ApiKey& key : keys) {
    if (CRYPTO_memcmp(key.sha256.data(), shown.data(), digest_digits) == 0) found = &key;
  }
  return found;
}

std::optional<Scope> needed_scope(std::string_view method, std::string_view path) {
  constexpr std::array<std::string_view, 4> open = {"/livez", "/readyz", "/openapi.yaml", "/docs"};
  if (method == "OPTIONS" || std::ranges::find(open, path) != open.end()) return {};
  if (method == "GET" || method == "HEAD") return Scope::read;
  // Who may send an upload may also end it.
  return method == "DELETE" && !path.starts_with("/v1/uploads/") ? Scope::admin : Scope::write;
}

bool is_loopback(const std::string& host) {
  if (host == "localhost") return true;
  in_addr four{};
  if (::inet_pton(AF_INET, host.c_str(), &four) == 1) return ntohl(four.s_addr) >> 24 == 127;
  in6_addr six{};
  return ::inet_pton(AF_INET6, host.c_str(), &six) == 1 && IN6_IS_ADDR_LOOPBACK(&six);
}

bool is_loopback_name(std::string_view name) {
  if (name.starts_with('[') && name.ends_with(']')) return is_loopback(std::string(name.substr(1, name.size() - 2)));
  return name == "localhost" || name.ends_with(".localhost") || is_loopback(std::string(name));
}

std::vector<std::string> hosts_from(std::string_view list) {
  std::vector<std::string> hosts;
  while (!list.empty()) {
    const std::size_t end = std::min(list.find(','), list.size());
    std::string_view one = list.substr(0, end);
    while (one.starts_with(' ')) one.remove_prefix(1);
    while (one.ends_with(' ')) one.remove_suffix(1);
    if (const auto name = host_name(one)) {
      hosts.push_back(*name);
    } else if (!one.empty()) {
      throw Error(ErrorCode::invalid_argument,
                  "Give names of this server such as spherule.example, with commas between.");
    }
    list.remove_prefix(std::min(end + 1, list.size()));
  }
  return hosts;
}

}  // namespace spherule::server
