// SPDX-License-Identifier: GPL-3.0-or-later
//
// Who may do what. A client shows a key (Authorization: Bearer TOKEN); the server knows only the key's digest.
//
// SHA-256 without salt or stretching is enough here: a token has 256 random bits, so there is no dictionary that a slow
// hash would slow down, and no two tokens are ever the same.
#pragma once

#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

namespace spherule::server {

/// Each includes the ones before. read: every GET; write: also upload, compute and cancel; admin: also delete, which
/// takes along what others have derived from the same scan.
enum class Scope : std::uint8_t { read, write, admin };

/// "read", "write" or "admin".
std::string_view to_string(Scope scope);
/// Throws invalid_argument naming the three.
Scope scope_from(std::string_view text);

struct ApiKey {
  std::string name;  ///< of whoever holds it: appears in logs, never with a patient's data; [A-Za-z0-9._-]{1,64}
  Scope scope = Scope::read;
  std::string sha256;  ///< of the token, 64 lower-case hex digits

  friend bool operator==(const ApiKey&, const ApiKey&) = default;
};

/// A key as configurations write it, "NAME:SCOPE:SHA256". Throws invalid_argument for anything else.
ApiKey key_from(std::string_view text);
std::string to_string(const ApiKey& key);

/// A new token: "sph_" and 64 hex digits from the system's random source.
std::string new_token();

/// The key that the value of an Authorization header shows. Takes the same time whichever key it is, or none: every
/// digest is compared in full.
const ApiKey* find_key(std::span<const ApiKey> keys, std::string_view authorization);

/// The scope that a request needs; nothing for those that anybody may make (health and the contract).
std::optional<Scope> needed_scope(std::string_view method, std::string_view path);

/// Whether a server that listens on this address is reached from its own machine only.
bool is_loopback(const std::string& host);

/// Whether a name in a Host header (host_name() of http/head.h) leads to the machine itself, whatever name servers say:
/// loopback addresses, localhost, and all below it (RFC 6761, 6.3).
bool is_loopback_name(std::string_view name);

/// Reads a list of host names with commas between, to compare with such names; a port after a name means nothing.
/// Throws invalid_argument for what is no name.
std::vector<std::string> hosts_from(std::string_view list);

}  // namespace spherule::server
