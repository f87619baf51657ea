// SPDX-License-Identifier: GPL-3.0-or-later
//
// Jobs: the work on requests that takes longer than its asker waits.
#pragma once

#include <chrono>
#include <cstdint>
#include <optional>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "api/work.h"
#include "core/base/error.h"

namespace spherule::api {

/// Stored to the microsecond, UTC.
using Time = std::chrono::sys_time<std::chrono::microseconds>;

enum class JobState : std::uint8_t { queued, running, cancelling, succeeded, failed, cancelled };
/// Whether the job can change no more.
constexpr bool is_over(JobState s) { return s >= JobState::succeeded; }
/// "queued", "running", …
std::string_view name(JobState state);

struct JobError {
  std::optional<ErrorCode> code;  ///< nothing: a fault of this program
  std::string sentence;
};

struct JobInfo {
  std::string id;
  std::string kind;                    ///< kind_of(request)
  std::string result_id;               ///< id of what it makes, known beforehand because ids are content addresses
  std::optional<WorkRequest> request;  ///< nothing when its record cannot be read, such as one with options of old
  JobState state = JobState::queued;
  std::string stage;    ///< of the work: "read", "boundary" …; empty before it runs, kept when it ends
  double progress = 0;  ///< 0 … 1 over all stages; never goes back while one process runs it; 1 when succeeded
  Time created{};
  std::optional<Time> started, finished;  ///< of the last run; finished: once it is over
  std::vector<std::string> warnings;
  std::optional<JobError> error;  ///< of a failed job
  // Of the moment.
  std::optional<std::size_t> queue_position;  ///< jobs ahead of a queued one
  double elapsed_s = 0;                       ///< of the last run, so far or until its end
  std::optional<double> remaining_s;          ///< estimate while running, once there is enough progress to judge by
  bool awaited = false;  ///< whether the request that gives it has waited for it as long as it was to
};

/// Something that happened to a job. Numbers ascend within a job, also over restarts, but may have gaps.
struct JobEvent {
  enum class Type : std::uint8_t { state, progress, warning, end };
  std::uint64_t number = 0;
  Type type = Type::state;
  JobState state = JobState::queued;
  std::string stage{};
  double progress = 0;
  std::string warning{};  ///< of Type::warning only
};
struct JobEvents {
  std::vector<JobEvent> events;  ///< ascending
  bool over = false;             ///< nothing will follow; the last event of every job has Type::end
  bool stopping = false;         ///< the server stops: more follows once it is back
};

}  // namespace spherule::api
