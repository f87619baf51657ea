// SPDX-License-Identifier: GPL-3.0-or-later
//
// Plain fork and join over an index range.
#pragma once

#include <algorithm>
#include <atomic>
#include <cstddef>
#include <exception>
#include <mutex>
#include <thread>
#include <vector>

#include "core/base/context.h"

namespace spherule {

/// Calls body(begin, end) for consecutive pieces of [0, count), each at most `grain` long, on up to context.threads
/// threads, and returns when all are done. Pieces are the same for every thread count, so a caller that writes one
/// result per piece is deterministic. Cancellation is polled and `stage`'s progress reported between pieces.
/// The first exception thrown by a piece (or the cancellation) is rethrown here after all threads have stopped.
template <typename Body>
void parallel_for(const Context& context, std::string_view stage, std::size_t count, std::size_t grain, Body&& body) {
  if (count == 0) return;
  const std::size_t pieces = (count + grain - 1) / grain;
  std::atomic<std::size_t> next{0};
  std::atomic<bool> failed{false};
  std::exception_ptr error;
  std::mutex error_mutex;
  const auto work = [&](bool reports) {
    try {
      for (std::size_t piece; !failed && (piece = next++) < pieces;) {
        context.throw_if_cancelled();
        body(piece * grain, std::min(count, (piece + 1) * grain));
        if (reports && !stage.empty())
          context.report(stage, static_cast<double>(piece + 1) / static_cast<double>(pieces));
      }
    } catch (...) {
      const std::lock_guard lock(error_mutex);
      if (!failed.exchange(true)) error = std::current_exception();
    }
  };
  {
    std::vector<std::jthread> helpers;
    const std::size_t wanted = std::min<std::size_t>(std::max(1U, context.threads), pieces);
    for (std::size_t i = 1; i < wanted; ++i) helpers.emplace_back(work, false);
    work(true);
  }
  if (error) std::rethrow_exception(error);
}

}  // namespace spherule
