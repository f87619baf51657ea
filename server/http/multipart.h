// SPDX-License-Identifier: GPL-3.0-or-later
//
// multipart/form-data (RFC 7578) as a stream.
#pragma once

#include <cstddef>
#include <string>
#include <string_view>

#include "api/http/http.h"

namespace spherule::server {

/// Takes a form apart as it arrives, in pieces of any size. Keeps no more than one head of a part.
class MultipartReader {
 public:
  /// Goes by the boundary in `content_type`; throws malformed when there is none.
  explicit MultipartReader(std::string_view content_type);

  /// Hands parts on as far as they are known. Throws malformed when this is no form, or a part's head is too long.
  void feed(std::string_view bytes, const api::Body::BeginPart& begin, const api::Body::Take& take);
  /// The closing delimiter has come.
  bool ended() const { return state_ == State::epilogue; }

 private:
  enum class State { preamble, delimiter, head, content, epilogue };

  bool step(const api::Body::BeginPart& begin, const api::Body::Take& take);

  std::string delimiter_;  // CR LF -- boundary
  std::string held_;       // not understood yet
  State state_ = State::preamble;
  std::size_t preamble_ = 0;  // bytes of it
};

}  // namespace spherule::server
