// SPDX-License-Identifier: GPL-3.0-or-later
//
// Time, for what is kept.
#pragma once

#include <chrono>
#include <functional>

namespace spherule::server {

/// Stored to the microsecond, UTC.
using Time = std::chrono::sys_time<std::chrono::microseconds>;

/// By the clock on the wall, which an operator or a time server may set.
inline Time now() { return std::chrono::time_point_cast<std::chrono::microseconds>(std::chrono::system_clock::now()); }

/// What tells the time; tests stand in clocks of their own. Thread safe.
struct Clocks {
  std::function<Time()> wall = now;
  /// Goes on evenly, from any beginning, whatever happens to the wall's clock.
  std::function<std::chrono::microseconds()> steady = [] {
    return std::chrono::duration_cast<std::chrono::microseconds>(std::chrono::steady_clock::now().time_since_epoch());
  };
};

}  // namespace spherule::server
