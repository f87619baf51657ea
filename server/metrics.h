// SPDX-License-Identifier: GPL-3.0-or-later
//
// Counts of answered requests, by route and status, with a histogram of how long they took.
#pragma once

#include <array>
#include <cstdint>
#include <map>
#include <mutex>
#include <string>
#include <tuple>
#include <vector>

#include "api/service.h"
#include "server/base/cache.h"
#include "server/http/listener.h"

namespace spherule::server {

/// Thread safe. Labels are methods, templates of paths and statuses: their number is bounded, and none tells of an
/// object.
class RequestMetrics {
 public:
  void count(const AccessRecord& request);
  std::vector<api::Metric> collect() const;

 private:
  /// Upper bounds, seconds; the last bucket has none.
  static constexpr std::array<double, 12> bounds = {0.001, 0.0025, 0.005, 0.01, 0.025, 0.05, 0.1, 0.25, 1, 5, 15, 60};
  struct Durations {
    std::array<std::uint64_t, bounds.size() + 1> counts{};
    double sum = 0;
  };

  mutable std::mutex mutex_;
  std::map<std::tuple<std::string, std::string, int>, std::uint64_t> requests_;  // method, route, status
  std::map<std::string, Durations> durations_;                                   // by route
};

/// What the listener, and a memory cache of this name, tell of themselves.
std::vector<api::Metric> metrics_of(const Listener::Load& load);
std::vector<api::Metric> metrics_of(const std::string& cache, const CacheStats& stats);

/// One figure without labels.
api::Metric gauge(std::string name, std::string help, double value);

}  // namespace spherule::server
