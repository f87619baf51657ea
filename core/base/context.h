// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a long computation needs from whoever started it: how many threads, whom to tell, when to stop.
#pragma once

#include <functional>
#include <stop_token>
#include <string_view>

#include "core/base/error.h"

namespace spherule {

/// Passed by const reference to every stage that can take longer than a few milliseconds. Results never depend on it.
struct Context {
  /// Threads that a stage may use, itself included. At least 1.
  unsigned threads = 1;

  /// Stages poll this at least every few tens of milliseconds, except inside one call of a library that cannot
  /// be interrupted (each such place says so).
  std::stop_token cancel;

  /// Called with the stage's name and the part of it that is done, 0 to 1, never going back. Only the thread
  /// that called the stage calls it. May be empty. Must not throw.
  std::function<void(std::string_view stage, double fraction)> progress;

  void report(std::string_view stage, double fraction) const {
    if (progress) progress(stage, fraction);
  }

  /// Throws Error(cancelled) once a stop was requested.
  void throw_if_cancelled() const {
    if (cancel.stop_requested()) throw Error(ErrorCode::cancelled, "The work was cancelled.");
  }
};

}  // namespace spherule
