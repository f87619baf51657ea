// SPDX-License-Identifier: GPL-3.0-or-later
//
// One vocabulary for everything that can go wrong because of input, limits or the outside world.
//
// Core throws `Error` and nothing else for such cases; a violated invariant of our own is an assertion
// (check.h), never an Error. The message is one sentence that tells the caller what to do. It is shown to remote users
// as it is, so it must never hold a file system path, a patient's name or a stack trace.
// `api/http/problem.cpp` maps each code to exactly one HTTP status.
#pragma once

#include <stdexcept>
#include <string>
#include <utility>
#include <vector>

namespace spherule {

enum class ErrorCode {
  invalid_argument,  ///< a parameter is missing, unknown, or outside its range
  malformed,         ///< the bytes do not parse as the format that they start like
  unknown_format,    ///< no reader recognises the bytes
  unusable,          ///< readable, but not one scalar volume on a straight grid (or not a usable request for it)
  too_large,         ///< over a configured limit
  not_found,         ///< no such resource
  conflict,          ///< the resource's state forbids it
  no_space,          ///< storage is full
  busy,              ///< try again later
  throttled,         ///< the caller has as much under way as one caller may; try again later
  cancelled,         ///< the caller asked to stop
  corrupt,           ///< stored data failed its checksum
};

/// What is wrong with one field of a request. `pointer` is an RFC 6901 JSON pointer, or a query parameter's name.
struct FieldError {
  std::string pointer;
  std::string detail;
};

/// Thrown by every layer; immutable once made, so safe to carry between threads.
class Error : public std::runtime_error {
 public:
  Error(ErrorCode code, const std::string& sentence, std::vector<FieldError> fields = {})
      : std::runtime_error(sentence), code_(code), fields_(std::move(fields)) {}

  [[nodiscard]] ErrorCode code() const noexcept { return code_; }
  [[nodiscard]] const std::vector<FieldError>& fields() const noexcept { return fields_; }

 private:
  ErrorCode code_;
  std::vector<FieldError> fields_;
};

}  // namespace spherule
