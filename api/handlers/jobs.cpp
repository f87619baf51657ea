// SPDX-License-Identifier: GPL-3.0-or-later
#include <charconv>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "api/http/query.h"
#include "api/json/documents.h"

namespace spherule::api {

namespace {

std::string_view name(JobEvent::Type type) {
  constexpr std::array<std::string_view, 4> names = {"state", "progress", "warning", "end"};
  return names[static_cast<std::size_t>(type)];
}

void append(std::string& out, std::uint64_t& last, const JobEvents& events) {
  for (const JobEvent& event : events.events) {
    last = event.number;
    out += "id: " + std::to_string(event.number) + "\nevent: " + std::string(name(event.type)) +
           "\ndata: " + event_data(event) + "\n\n";
  }
}

}  // namespace

Response list_jobs(const Call& call) {
  const PageRequest wanted = page_request(Query(call.request, {"limit", "cursor"}));
  const Page<JobInfo> page = call.service.jobs(wanted);
  Response response = json_response(call, job_list_document(page));
  link_next(response, "/v1/jobs", wanted, page.next);
  return response;
}

Response get_job(const Call& call) {
  const Query query(call.request, {});
  return json_response(call, job_document(call.service.job(call.id())));
}

Response cancel_job(const Call& call) {
  const Query query(call.request, {});
  const std::optional<JobInfo> job = call.service.cancel_job(call.id());
  if (!job) {
    throw HttpError(403, "Only who asked for this job may cancel it: use their key, or one with the scope admin.");
  }
  return json_response(call, job_document(*job), 202);
}

Response get_job_events(const Call& call) {
  const Query query(call.request, {});
  constexpr std::array<std::string_view, 1> types = {"text/event-stream"};
  negotiate(call.request.header("Accept"), types);
  std::uint64_t last = 0;
  const std::string_view seen = call.request.header("Last-Event-ID");
  if (!seen.empty()) {
    const auto [end, error] = std::from_chars(seen.data(), seen.data() + seen.size(), last);
    constexpr auto most = static_cast<std::uint64_t>(ranges::bytes.most);
    if (error != std::errc{} || end != seen.data() + seen.size() || last > most) {
      throw Error(ErrorCode::invalid_argument, "Give the number of an event as Last-Event-ID, or leave it out.");
    }
  }
  const JobEvents first = call.service.job_events(call.id(), last, std::chrono::seconds(0));
  // Tells an EventSource not to connect again.
  if (first.over && first.events.empty()) return {.status = 204};
  std::string opening = "retry: 2000\n\n";
  append(opening, last, first);
  Response response;
  response.set("Content-Type", "text/event-stream");
  response.set("Cache-Control", "no-store");
  response.body = EventSource([&service = call.service, id = call.id(), last, opening = std::move(opening),
                               over = first.over](std::string& out) mutable {
    if (!opening.empty()) {
      out += opening;
      opening.clear();
      return !over;
    }
    const JobEvents events = service.job_events(id, last, std::chrono::seconds(15));
    if (events.events.empty()) out += ":\n\n";
    append(out, last, events);
    // Who goes on listening connects again, and by then to a server that is back.
    return !events.over && !events.stopping;
  });
  return response;
}

}  // namespace spherule::api
