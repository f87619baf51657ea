// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/framing.h"

#include <algorithm>

namespace spherule::server {

namespace {

// 60 bits: no sum of two overflows.
constexpr std::size_t kMostDigits = 15;
// Of extensions and trailers, in a whole body. Nobody here makes use of either.
constexpr std::size_t kMostExtra = 4096;

}  // namespace

BodyFraming::BodyFraming(const Head& head)
    : state_(head.chunked      ? State::size
             : head.length > 0 ? State::counted
                               : State::finished),
      left_(head.length) {}

BodyFraming::Step BodyFraming::next(std::string_view bytes) {
  Step step;
  while (step.taken < bytes.size() && step.content.empty() && !finished() && !bad()) {
    if (state_ == State::counted || state_ == State::data) {
      const auto count = static_cast<std::size_t>(std::min<std::uint64_t>(left_, bytes.size() - step.taken));
      step.content = bytes.substr(step.taken, count);
      step.taken += count;
      left_ -= count;
      if (left_ == 0) state_ = state_ == State::counted ? State::finished : State::data_end;
    } else {
      state_ = take(bytes[step.taken++]);
    }
  }
  return step;
}

BodyFraming::State BodyFraming::take(char c) {
  const auto digit = [c]() -> int {
    return c >= '0' && c <= '9'   ? c - '0'
           : c >= 'a' && c <= 'f' ? c - 'a' + 10
           : c >= 'A' && c <= 'F' ? c - 'A' + 10
                                  : -1;
  };
  switch (state_) {
    case State::size:
      if (const int value = digit(); value >= 0) {
        if (++digits_ > kMostDigits) return State::bad;
        left_ = left_ * 16 + static_cast<std::uint64_t>(value);
        return State::size;
      }
      if (digits_ == 0) return State::bad;
      return c == ';' ? State::extension : c == '\r' ? State::size_end : State::bad;
    case State::extension:
      if (c == '\r') return State::size_end;
      return ++extra_ > kMostExtra || (c != '\t' && static_cast<unsigned char>(c) < 0x20) || c == 0x7f
                 ? State::bad
                 : State::extension;
    case State::size_end: digits_ = 0; return c != '\n' ? State::bad : left_ > 0 ? State::data : State::trailer;
    case State::data_end: return c == '\r' ? State::data_over : State::bad;
    case State::data_over: return c == '\n' ? State::size : State::bad;
    case State::trailer:
      if (c == '\r') return State::trailer_end;
      if (c == '\n' || ++extra_ > kMostExtra) return State::bad;
      line_ += c;
      return State::trailer;
    case State::trailer_end:
      if (c != '\n') return State::bad;
      if (line_.empty()) return State::finished;
      return parse_field(std::exchange(line_, {})) ? State::trailer : State::bad;
    case State::finished:
    case State::bad:
    case State::counted:
    case State::data: break;
  }
  return State::bad;
}

}  // namespace spherule::server
