// SPDX-License-Identifier: GPL-3.0-or-later
//
// Long work: queued, run on a bounded pool, watched, cancelled, and run again after a crash. Knows nothing of what the
// work is: one runner, given at construction, turns a request into a resource.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <functional>
#include <limits>
#include <map>
#include <memory>
#include <optional>
#include <stop_token>
#include <string>
#include <utility>
#include <vector>

#include "core/base/context.h"
#include "server/bytes/blob_store.h"
#include "server/records/catalog.h"

namespace spherule::server {

struct JobPoolOptions {
  unsigned jobs_at_once = 1;      ///< worker threads, each running one job
  unsigned threads_per_job = 1;   ///< what a job's Context allows it
  std::size_t queue_length = 64;  ///< jobs that wait; one more is refused with busy
  std::size_t queue_per_client = std::numeric_limits<std::size_t>::max();  ///< one client's; then throttled
  std::uint64_t memory_bytes = std::numeric_limits<std::uint64_t>::max();  ///< for all running jobs, as they estimate
  unsigned crash_limit = 2;  ///< a job that ran while the process died this often fails instead of running once more
  std::chrono::milliseconds longest_run = std::chrono::milliseconds::max();  ///< of one job; then it fails. max: no end
};

using api::JobEvent;
using api::JobEvents;

/// What a runner may do to its job. Valid during the call only.
class JobContext {
 public:
  /// For the next stages of the work: their own progress 0 to 1 becomes the job's `from` to `to`, and the names that
  /// they report become the job's stage. Has the job's thread budget and stop token. Call its `progress` from the
  /// runner's thread only.
  [[nodiscard]] virtual Context context(double from, double to) = 0;

  /// One sentence for the requester; no line breaks. At most 100 are kept.
  virtual void warn(const std::string& sentence) = 0;

  /// Corrects the job's estimate of its memory, now that more is known and before that much is taken. Less lets others
  /// start sooner. More is granted while it fits beside what others have. Where it does not, this throws, and the
  /// runner lets that pass: what the job holds is freed, and it is run again as the next of all, once there is room for
  /// the new estimate. So nobody waits while holding memory, two that grow cannot wait for each other, and a job comes
  /// back at most once for each larger estimate. Throws unusable when it is more than all jobs together may have.
  virtual void expect_memory(std::uint64_t bytes) = 0;

 protected:
  ~JobContext() = default;
};

/// Does the work of one job and returns the resource to add, its blobs committed and its id the record's result_id.
/// Called from several threads at once. Throws Error (shown to the requester as it is) or anything else (shown as a
/// fault of the server). After a stop request it should throw Error(cancelled) soon.
using JobRunner = std::function<Resource(const JobRecord& job, JobContext& context)>;

/// Called with the text of an exception that is not an Error, for the log; never shown to requesters. Thread safe.
using FaultLog = std::function<void(const std::string& job_id, const std::string& what)>;

/// Called when a job is over, with the record as it was stored; for the log. Thread safe.
using EndLog = std::function<void(const JobRecord& job)>;

/// Thread safe. `catalog` and `blobs` outlive the pool.
///
/// Order: clients take turns (FairQueue). Admission: a job starts when its estimate fits beside what the jobs that run
/// and reserve() have, or when nobody has anything; the next in turn is waited for and never overtaken, so that large
/// work is not starved. A job that ran when the process died runs alone, so that no other is blamed should it die
/// again.
///
/// Requesters: a job is wanted by a set of clients, each counted once however often it asks, and stops when the last of
/// them has cancelled. It is also stopped, and fails with a sentence that says so, when it has run for longest_run, and
/// by abandon(). A runner hears of a stop by its Context only: a stage that does not look holds its thread.
///
/// Durability: a job that submit() returned runs, or ends with a reason, whatever happens to the process; `succeeded`
/// is seen only after the result is in the catalogue. Should the catalogue refuse to store an end (full disk), the job
/// fails with that reason, and runs again after a restart.
class JobPool {
 public:
  /// Takes up all unfinished jobs of the catalogue, oldest first (they may exceed the queue's length), then starts.
  JobPool(JobPoolOptions options, Catalog& catalog, BlobStore& blobs, JobRunner runner, FaultLog log = {},
          EndLog ended = {});

  /// As stop(0 s).
  ~JobPool();

  /// Queues work, or joins the unfinished job that makes the same result. The caller has looked for a finished result
  /// before. Returns the job's status; its requesters tell who wants it now. `client` is whose turn it takes,
  /// `memory_bytes` an estimate of what the work needs at its peak. Throws busy when the queue is full or the pool
  /// stops, throttled when this client's part of it is, and unusable, with the estimate, when the work can never fit.
  JobRecord submit(const api::WorkRequest& request, const std::string& result_id, const std::string& client = {},
                   std::uint64_t memory_bytes = 0);

  /// Throws not_found.
  [[nodiscard]] JobRecord status(const std::string& id) const;

  /// All jobs ever accepted, newest first; see Catalog::list.
  [[nodiscard]] Page<JobRecord> list(const std::string& cursor, std::size_t limit) const;

  /// Returns when the job is over, the time has passed or the pool stops, whichever comes first. Throws not_found.
  JobRecord wait(const std::string& id, std::chrono::milliseconds timeout) const;

  /// Events after number `after` (0: from the start), as soon as there are any; none when the time passes first or the
  /// pool stops. A reader that comes late sees the kept ones: all states and warnings, the latest progress.
  /// Throws not_found.
  JobEvents events(const std::string& id, std::uint64_t after, std::chrono::milliseconds timeout) const;

  /// Takes this client's request back; nothing when it is none of the job's requesters. The last one stops the work: a
  /// queued job is cancelled at once, a running one is cancelling until the runner returns. Durable: it will not run
  /// again. Throws not_found; conflict when it is over or its result is just being stored.
  std::optional<JobRecord> cancel(const std::string& id, const std::string& client = {});

  /// The same for all requesters at once.
  JobRecord cancel_for_all(const std::string& id);

  /// Ends every unfinished job that this is true of (asked under the pool's lock): a queued one fails with this reason
  /// at once, a running one as soon as its runner returns. None of them is joined any more.
  void abandon(const std::function<bool(const JobRecord& job)>& pointless, const JobError& reason);

  /// Memory that work within a request holds, until the last copy goes, which must be before the pool.
  using Memory = std::shared_ptr<const void>;

  /// Takes memory beside the jobs' for work within a request: from the same budget, first come, first served, and
  /// before jobs that have not started. What needs at most a 64th of the budget never waits behind the rest: for it
  /// there is a 16th on top. Throws unusable, with the estimate, when it can never fit; busy when `patience` has passed
  /// or the pool stops; cancelled on a stop request.
  Memory reserve(std::uint64_t bytes, std::chrono::milliseconds patience, const std::stop_token& stop = {});

  /// Accepts nothing more, starts nothing more, lets running jobs finish for up to `grace`, then stops them and waits
  /// for a second at most: false when one has not heard by then. Unfinished jobs stay queued in the catalogue for the
  /// next start. Wakes every wait() and events(). After false, the destructor still waits for the runners.
  bool stop(std::chrono::milliseconds grace);

  struct Load {
    std::size_t queued = 0, running = 0;  ///< queued: with those that submit() is just storing
    std::uint64_t memory_bytes = 0;       ///< of the running jobs and of reserve(), as estimated
    std::size_t reserving = 0;            ///< requests that wait in reserve()
    bool stopping = false;
    std::map<std::pair<std::string, JobState>, std::uint64_t> ended;  ///< by kind and end, since the pool was made
  };
  [[nodiscard]] Load load() const;

 private:
  struct State;
  std::unique_ptr<State> state_;
};

}  // namespace spherule::server
