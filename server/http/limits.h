// SPDX-License-Identifier: GPL-3.0-or-later
//
// What connections may cost.
#pragma once

#include <chrono>
#include <cstddef>

#include "server/http/head.h"

namespace spherule::server {

struct ConnectionLimits {
  std::size_t connections = 4096;               ///< open at once; one more closes the one that has been idle longest
  std::size_t of_one_address = 1024;            ///< of these, likewise; loopback addresses are not counted
  std::size_t threads = 640;                    ///< requests answered at once; further ones wait
  std::size_t requests = 10'000;                ///< answered on one connection before it is closed
  HeadLimits head_size{};                       ///< of a request
  std::size_t body_bytes = 1 << 16;             ///< of a body arrive before a thread takes it up
  std::chrono::milliseconds head{10'000};       ///< from the first byte of a head to its last; then 408
  std::chrono::milliseconds idle{60'000};       ///< between requests
  std::chrono::milliseconds read{15'000};       ///< for the next piece of a body
  std::chrono::milliseconds write{30'000};      ///< for the next piece of an answer to be taken
  std::chrono::milliseconds linger{2'000};      ///< for what a refused client still sends, so that it sees why
  std::size_t slowest_bytes_per_second = 1024;  ///< beside read and write: who makes us wait longer in all is cut off
  std::size_t fair_bytes_per_second = 1 << 16;  ///< who is slower makes way when threads are short
};

}  // namespace spherule::server
