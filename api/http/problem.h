// SPDX-License-Identifier: GPL-3.0-or-later
//
// Everything that goes wrong, as application/problem+json (RFC 9457). The one table that maps errors to HTTP statuses.
#pragma once

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

#include "api/http/http.h"
#include "core/base/error.h"

namespace spherule::api {

/// What only HTTP knows to be wrong: a method, a media type, a range, a key. Thrown inside api/ alone.
class HttpError : public std::runtime_error {
 public:
  HttpError(int status, const std::string& sentence, std::vector<std::pair<std::string, std::string>> headers = {})
      : std::runtime_error(sentence), status_(status), headers_(std::move(headers)) {}
  int status() const noexcept { return status_; }
  const std::vector<std::pair<std::string, std::string>>& headers() const noexcept { return headers_; }

 private:
  int status_;
  std::vector<std::pair<std::string, std::string>> headers_;
};

/// The HTTP status of an error code.
int status_of(ErrorCode code);

/// The problem document of an error, with the first ten of its fields and how many there are beyond. `instance` is the
/// request's id (left out when empty).
std::string problem_document(const Error& error, const std::string& instance);

/// The response of an error.
Response problem(const Error& error, const std::string& instance);
Response problem(const HttpError& error, const std::string& instance);
/// A status that has no Error behind it: what the HTTP library refuses by itself, and 500 for our own defects.
Response problem(int status, const std::string& instance);

}  // namespace spherule::api
