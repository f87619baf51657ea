// SPDX-License-Identifier: GPL-3.0-or-later
//
// SHA-256 and the ids made from it. A content id names what a thing is, so the same request has the same id on any
// machine; a random id names an event (a job), which can happen twice.
#pragma once

#include <memory>
#include <string>
#include <string_view>

namespace spherule::server {

/// Running SHA-256. Not thread safe; movable.
class Sha256 {
 public:
  Sha256();
  ~Sha256();
  Sha256(Sha256&&) noexcept;
  Sha256& operator=(Sha256&&) noexcept;

  void update(std::string_view bytes);

  /// The digest of everything so far as 64 lower-case hex digits; more may be appended afterwards.
  [[nodiscard]] std::string hex() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

/// 64 lower-case hex digits.
std::string sha256_hex(std::string_view bytes);

/// `<prefix>_` and the first 32 hex digits of the SHA-256 of `bytes`: content_id("mdl", canonical_request).
std::string content_id(std::string_view prefix, std::string_view bytes);

/// `<prefix>_` and 32 hex digits from the system's random source.
std::string random_id(std::string_view prefix);

/// True when `text` has the form of an id with this prefix. Anything else in a URL is simply not found.
bool is_id(std::string_view prefix, std::string_view text);

}  // namespace spherule::server
