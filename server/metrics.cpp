// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/metrics.h"

#include <algorithm>
#include <cstdio>

namespace spherule::server {

namespace {

std::string route_of(const AccessRecord& request) { return request.route.empty() ? "none" : request.route; }

std::string number(double value) {
  std::array<char, 32> text{};
  std::snprintf(text.data(), text.size(), "%g", value);
  return text.data();
}

api::Metric single(std::string name, std::string type, std::string help, double value) {
  return {std::move(name), std::move(type), std::move(help), {{"", {}, value}}};
}

}  // namespace

api::Metric gauge(std::string name, std::string help, double value) {
  return single(std::move(name), "gauge", std::move(help), value);
}

std::vector<api::Metric> metrics_of(const Listener::Load& load) {
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  return {gauge("spherule_http_connections", "Connections that are open.", count(load.connections)),
          gauge("spherule_http_requests_waiting", "Requests that wait for a thread.", count(load.waiting)),
          gauge("spherule_http_requests_answering", "Requests that are being answered.", count(load.answering)),
          gauge("spherule_http_threads", "Threads that answer requests.", count(load.threads)),
          gauge("spherule_http_streams", "Event streams that are open.", count(load.streams)),
          single("spherule_http_received_bytes_total", "counter", "Bytes received.", count(load.received)),
          single("spherule_http_sent_bytes_total", "counter", "Bytes sent.", count(load.sent))};
}

std::vector<api::Metric> metrics_of(const std::string& cache, const CacheStats& stats) {
  const auto count = [](std::uint64_t n) { return static_cast<double>(n); };
  const std::string name = "spherule_" + cache + "_cache_";
  return {single(name + "hits_total", "counter", "Look-ups that were found in memory.", count(stats.hits)),
          single(name + "misses_total", "counter", "Look-ups that were not.", count(stats.misses)),
          gauge(name + "bytes", "Memory in use.", count(stats.bytes))};
}

void RequestMetrics::count(const AccessRecord& request) {
  const std::lock_guard lock(mutex_);
  ++requests_[{request.method, route_of(request), request.status}];
  Durations& durations = durations_[route_of(request)];
  const auto bucket = std::ranges::lower_bound(bounds, request.seconds) - bounds.begin();
  ++durations.counts[static_cast<std::size_t>(bucket)];
  durations.sum += request.seconds;
}

std::vector<api::Metric> RequestMetrics::collect() const {
  api::Metric requests{"spherule_http_requests_total", "counter", "Requests answered.", {}};
  api::Metric durations{
      "spherule_http_request_duration_seconds", "histogram", "Seconds from a request's head to its answer.", {}};
  const std::lock_guard lock(mutex_);
  for (const auto& [key, count] : requests_) {
    const auto& [method, route, status] = key;
    requests.samples.push_back(
        {"", {{"method", method}, {"route", route}, {"status", std::to_string(status)}}, static_cast<double>(count)});
  }
  for (const auto& [route, times] : durations_) {
    std::uint64_t total = 0;
    for (std::size_t i = 0; i < times.counts.size(); ++i) {
      total += times.counts[i];
      durations.samples.push_back({"_bucket",
                                   {{"route", route}, {"le", i < bounds.size() ? number(bounds[i]) : "+Inf"}},
                                   static_cast<double>(total)});
    }
    durations.samples.push_back({"_sum", {{"route", route}}, times.sum});
    durations.samples.push_back({"_count", {{"route", route}}, static_cast<double>(total)});
  }
  return {std::move(requests), std::move(durations)};
}

}  // namespace spherule::server
