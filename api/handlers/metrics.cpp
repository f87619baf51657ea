// SPDX-License-Identifier: GPL-3.0-or-later
//
// GET /metrics, in Prometheus' text format 0.0.4.
#include <array>
#include <cmath>
#include <cstdio>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"

namespace spherule::api {

namespace {

std::string number(double value) {
  if (std::isinf(value)) return value > 0 ? "+Inf" : "-Inf";
  std::array<char, 40> text{};
  std::snprintf(text.data(), text.size(), "%.17g", value);
  return text.data();
}

std::string escaped(std::string_view text) {
  std::string out;
  for (const char c : text) {
    if (c == '\\' || c == '"') out += '\\';
    c == '\n' ? out += "\\n" : out += c;
  }
  return out;
}

}  // namespace

Response get_metrics(const Call& call) {
  const Query query(call.request, {});
  constexpr std::array<std::string_view, 1> types = {"text/plain"};
  negotiate(call.request.header("Accept"), types);
  std::string text;
  for (const Metric& metric : call.service.metrics()) {
    text += "# HELP " + metric.name + " " + metric.help + "\n# TYPE " + metric.name + " " + metric.type + "\n";
    for (const Metric::Sample& sample : metric.samples) {
      text += metric.name + sample.suffix;
      for (std::size_t i = 0; i < sample.labels.size(); ++i) {
        text += (i == 0 ? "{" : ",") + sample.labels[i].first + "=\"" + escaped(sample.labels[i].second) + "\"";
      }
      text += (sample.labels.empty() ? " " : "} ") + number(sample.value) + "\n";
    }
  }
  Response response{.status = 200, .body = std::move(text)};
  response.set("Content-Type", "text/plain; version=0.0.4; charset=utf-8");
  response.set("Cache-Control", "no-store");
  return response;
}

}  // namespace spherule::api
