// SPDX-License-Identifier: GPL-3.0-or-later
//
// Cancellation within loops and sorts that are not cut into pieces.
#pragma once

#include <cstdint>
#include <stop_token>

#include "core/base/context.h"

namespace spherule {

/// Counts what it is called for and looks for a cancellation every so often. One for each thread. Copies of its
/// `Polled` comparators share it, so that std::sort can be cancelled: what it was sorting is then in some order.
class Poll {
 public:
  /// `every` is the number of calls between two looks: of steps that take 5 ns the default makes about 0.2 ms.
  explicit Poll(const Context& context, std::uint32_t every = 1U << 15)
      : cancel_(context.cancel), every_(every), left_(every) {}

  /// Throws cancelled.
  void operator()() {
    if (--left_ == 0) look();
  }
  /// For a step that took as long as `steps` of them.
  void operator()(std::uint64_t steps) {
    if (steps < left_) {
      left_ -= static_cast<std::uint32_t>(steps);
    } else {
      look();
    }
  }

 private:
  void look() {
    left_ = every_;
    Context{.threads = 1, .cancel = cancel_, .progress = {}}.throw_if_cancelled();
  }

  std::stop_token cancel_;
  std::uint32_t every_, left_;
};

/// A comparison that polls.
template <typename Less>
class Polled {
 public:
  Polled(Poll& poll, Less less) : poll_(&poll), less_(less) {}

  template <typename T>
  bool operator()(const T& a, const T& b) const {
    (*poll_)();
    return less_(a, b);
  }

 private:
  Poll* poll_;
  Less less_;
};

}  // namespace spherule
