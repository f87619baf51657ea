// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where the body of a request ends (RFC 9112, 6 and 7): by its length, or by its chunks, which are read strictly.
#pragma once

#include <cstddef>
#include <cstdint>
#include <string>
#include <string_view>

#include "server/http/head.h"

namespace spherule::server {

/// Takes a body apart as it arrives, in pieces of any size: the result does not depend on the cuts. Needs no memory but
/// for one line of a trailer. What chunks carry besides content (extensions and trailers) is checked, bounded and
/// dropped.
class BodyFraming {
 public:
  /// No body.
  BodyFraming() = default;
  explicit BodyFraming(const Head& head);

  struct Step {
    std::size_t taken = 0;     ///< of the bytes given; 0 only for none, or once finished() or bad()
    std::string_view content;  ///< part of what was taken
  };
  Step next(std::string_view bytes);
  /// The bytes that follow are the next request's.
  bool finished() const { return state_ == State::finished; }
  /// What came is no body, and where the next request would begin is not known.
  bool bad() const { return state_ == State::bad; }

 private:
  enum class State {
    finished,
    bad,
    counted,
    size,
    extension,
    size_end,
    data,
    data_end,
    data_over,
    trailer,
    trailer_end
  };

  State take(char c);

  State state_ = State::finished;
  std::uint64_t left_ = 0;  // of the body, or the chunk
  std::size_t digits_ = 0, extra_ = 0;
  std::string line_;  // of the trailer
};

}  // namespace spherule::server
