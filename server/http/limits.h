// SPDX-License-Identifier: GPL-3.0-or-later
//
// What connections may cost.
#pragma once

#include <chrono>
#include <cstddef>

namespace spherule::server {

struct ConnectionLimits {
  std::size_t connections = 4096;              ///< open at once; one more closes the one that has been idle longest
  std::size_t threads = 640;                   ///< requests answered at once; further ones wait
  std::size_t requests = 10'000;               ///< answered on one connection before it is closed
  std::size_t head_bytes = 1 << 15;            ///< of a request; longer ones are refused with 431
  std::chrono::milliseconds head{10'000};      ///< from the first byte of a head to its last; then 408
  std::chrono::milliseconds idle{60'000};      ///< between requests
  std::chrono::milliseconds read{15'000};      ///< for the next piece of a body
  std::chrono::milliseconds write{30'000};     ///< for the next piece of an answer to be taken
  std::size_t slowest_bytes_per_second = 256;  ///< beside these two: who makes us wait longer in all is cut off
};

}  // namespace spherule::server
