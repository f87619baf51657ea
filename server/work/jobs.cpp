// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every transition is made under one mutex: first in the catalogue, then in memory. The catalogue's fsync is thereby
// waited for under the mutex; transitions are rare (a few a job), so simplicity wins. Only new jobs, of which many may
// come at once, are stored without it, so that nobody who asks for another job waits for them.
#include "server/work/jobs.h"

#include <algorithm>
#include <condition_variable>
#include <deque>
#include <exception>
#include <list>
#include <mutex>
#include <new>
#include <set>
#include <string>
#include <thread>
#include <unordered_map>
#include <utility>

#include "core/base/check.h"
#include "server/work/fair_queue.h"

namespace spherule::server {

namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr std::size_t max_warnings = 100;
constexpr std::size_t kept_finished_jobs = 256;  // with their events; older ones are read from the catalogue
constexpr double progress_event_step = 0.01;
constexpr double least_progress_to_judge_by = 0.02;
constexpr std::chrono::milliseconds hearing{800};  // that runners have for coming back once they are stopped

// Event numbers: the attempt in the high bits, so that they ascend over restarts without being stored.
std::uint64_t first_event(const JobRecord& job) { return std::uint64_t{job.attempts} << 32; }
std::uint64_t end_event(const JobRecord& job) { return (std::uint64_t{job.attempts + 1} << 32) - 1; }

JobError fault() { return {{}, "The server failed at this work because of a fault of its own; please report it."}; }

Error not_found() { return {ErrorCode::not_found, "There is no job under this id."}; }

// Logs what can be logged: a log that fails must not change what it tells of.
void tell(const auto& write) {
  try {
    write();
  } catch (...) {  // there is nobody else to tell
  }
}

double seconds(auto duration) { return std::chrono::duration<double>(duration).count(); }

struct Job {
  JobRecord record;
  SteadyClock::time_point run_began;
  std::stop_source stop;
  std::uint64_t last_number;
  double announced_progress = 0;
  std::vector<JobEvent> events;     // bounded: states, warnings, and at most one of progress
  std::optional<JobError> verdict;  // why it was stopped, where that was not the requesters' wish
  std::uint64_t holds = 0;          // of memory, while it runs
  bool again = false;               // it gives its turn back, until there is more memory

  explicit Job(JobRecord r) : record(std::move(r)), last_number(first_event(record)) {}

  void announce(JobEvent::Type type, std::string warning = {}) {
    if (type == JobEvent::Type::progress) {
      // Only the latest is kept: enough for whoever comes late, and bounded for jobs that run for hours.
      announced_progress = record.progress;
      std::erase_if(events, [](const JobEvent& event) { return event.type == JobEvent::Type::progress; });
    }
    last_number = type == JobEvent::Type::end ? end_event(record) : last_number + 1;
    events.push_back({last_number, type, record.state, record.stage, record.progress, std::move(warning)});
  }
};

/// Memory that is given out. Not thread safe.
struct Budget {
  std::uint64_t bytes;
  std::uint64_t taken = 0;          // may be more, by one that was let in because nobody had anything
  std::list<std::uint64_t> line{};  // who waits for it within a request, first come first

  std::uint64_t free() const { return bytes - std::min(taken, bytes); }
  bool fits(std::uint64_t wanted) const { return taken == 0 || wanted <= free(); }
};

// Work within a request that is small, as a part of the jobs' memory, and what all such work has together.
constexpr std::uint64_t kSmallPart = 64, kSmallTogetherPart = 16;

/// Of a job that is not in memory.
JobRecord status_of(JobRecord record) {
  if (record.started && record.finished) record.elapsed_s = std::max(0.0, seconds(*record.finished - *record.started));
  return record;
}

}  // namespace

struct JobPool::State {
  using JobPtr = std::shared_ptr<Job>;

  const JobPoolOptions options;
  Catalog& catalog;
  BlobStore& blobs;
  const JobRunner runner;
  const FaultLog log;
  const EndLog ended_log;

  mutable std::mutex mutex;
  std::condition_variable work;      // a job was queued, memory became free, or the pool stops
  std::condition_variable changed;   // an event, or the pool stops
  std::condition_variable begun;     // a job started to run, or the pool stops
  std::condition_variable_any room;  // memory became free, or the pool stops
  FairQueue<JobPtr> queue;
  std::unordered_map<std::string, JobPtr> jobs;       // unfinished and some finished ones
  std::unordered_map<std::string, JobPtr> by_result;  // those that a request for the same result may join
  std::deque<std::string> finished;                   // oldest first
  std::unordered_map<std::string, JobPtr> arriving;   // by id: the catalogue is just storing them
  std::size_t running = 0;
  Budget memory{options.memory_bytes};  // of those that run and of large work within requests, as estimated
  Budget small{options.memory_bytes / kSmallTogetherPart};
  std::map<std::pair<std::string, JobState>, std::uint64_t> ended_so_far;
  bool stopping = false;
  bool alone = false;  // what runs may be what ended an earlier process
  std::vector<std::jthread> workers;
  std::jthread timekeeper;

  State(JobPoolOptions o, Catalog& c, BlobStore& b, JobRunner r, FaultLog l, EndLog e)
      : options(o), catalog(c), blobs(b), runner(std::move(r)), log(std::move(l)), ended_log(std::move(e)) {}

  // All below but work_on, run, keep_time, take_back and reason: with the mutex held.

  JobPtr find(const std::string& id) const {
    const auto found = jobs.find(id);
    return found == jobs.end() ? nullptr : found->second;
  }

  JobRecord status(const Job& job) const {
    JobRecord status = status_of(job.record);
    if (job.record.state == JobState::queued) {
      status.queue_position = queue.place_of(jobs.at(job.record.id));
    } else if (!is_over(job.record.state)) {
      status.elapsed_s = seconds(SteadyClock::now() - job.run_began);
      if (job.record.state == JobState::running && job.record.progress >= least_progress_to_judge_by)
        status.remaining_s = status.elapsed_s * (1 - job.record.progress) / job.record.progress;
    }
    return status;
  }

  void announce(Job& job, JobEvent::Type type, std::string warning = {}) {
    job.announce(type, std::move(warning));
    changed.notify_all();
  }

  /// Of the exception that is being handled: what is shown of it, and what is not goes to the log.
  JobError reason(const std::string& job) const {
    try {
      throw;
    } catch (const Error& error) {
      return {error.code(), error.what()};
    } catch (const std::bad_alloc&) {
      return {ErrorCode::too_large, "This work needs more memory than the server has; ask for less."};
    } catch (const std::exception& error) {
      if (log) tell([&] { log(job, error.what()); });
    } catch (...) {
      if (log) tell([&] { log(job, "an exception of unknown type"); });
    }
    return fault();
  }

  void enqueue(const JobPtr& job) {
    jobs[job->record.id] = job;
    by_result[job->record.result_id] = job;
    queue.push(job->record.client, job);
    announce(*job, JobEvent::Type::state);
    work.notify_one();
  }

  void await_arrival(std::unique_lock<std::mutex>& lock, const std::string& id) {
    changed.wait(lock, [&] { return !arriving.contains(id); });
  }

  bool may_start_next() const {
    if (queue.empty() || !memory.line.empty()) return false;
    const JobRecord& next = queue.front()->record;
    return (running == 0 || (!alone && next.crashes == 0)) && memory.fits(next.memory_bytes);
  }

  void give_back(Budget& budget, std::uint64_t bytes) {
    budget.taken -= bytes;
    work.notify_all();
    room.notify_all();
  }

  /// See JobContext::expect_memory.
  void revise(Job& job, std::uint64_t bytes);

  /// A newer job for the same result keeps its entry: one may be cancelling while the next is queued.
  void no_longer_joinable(const Job& job) {
    const auto found = by_result.find(job.record.result_id);
    if (found != by_result.end() && found->second.get() == &job) by_result.erase(found);
  }

  /// Where all ends pass.
  void note_end(const Job& job) {
    ++ended_so_far[{job.record.kind, job.record.state}];
    if (ended_log) tell([&] { ended_log(job.record); });
  }

  /// The catalogue knows already.
  void end(Job& job, JobRecord record) {
    job.record = std::move(record);
    note_end(job);
    no_longer_joinable(job);
    announce(job, JobEvent::Type::end);
    finished.push_back(job.record.id);
    if (finished.size() > kept_finished_jobs) {
      jobs.erase(finished.front());
      finished.pop_front();
    }
  }

  /// The record of a job that ends now.
  static JobRecord ended(JobRecord record, JobState state, std::optional<JobError> error = {}) {
    record.state = state;
    record.finished = now();
    record.error = std::move(error);
    if (state == JobState::succeeded) record.progress = 1;
    return record;
  }

  /// Ends a job that adds no resource. When not even that can be stored, the job has failed for those who ask this
  /// process, and the next one runs it again.
  void store_end(Job& job, JobRecord record) {
    try {
      catalog.update_job(record);
      end(job, std::move(record));
    } catch (...) {
      job.record = ended(std::move(record), JobState::failed, reason(job.record.id));
      note_end(job);
      no_longer_joinable(job);
      announce(job, JobEvent::Type::end);  // and stays in `jobs`, since the catalogue would tell otherwise
    }
  }

  /// A job that was stopped before its time.
  void leave_for_next_start(Job& job) {
    JobRecord record = job.record;
    record.state = JobState::queued;
    try {
      catalog.update_job(record);
    } catch (...) {
      // The catalogue still says running: the next start runs it again all the same.
    }
    job.record = std::move(record);
  }

  /// A job that somebody may still change, under this id. Throws not_found, and conflict when it is over.
  JobPtr unfinished(const std::string& id) const {
    const auto job = find(id);
    if (!job && !catalog.find_job(id)) throw not_found();
    if (!job || is_over(job->record.state))
      throw Error(ErrorCode::conflict, "This job is over already; there is nothing to cancel.");
    return job;
  }

  void take_back(const std::vector<std::string>& keys) const {
    for (const std::string& key : keys) try {
        blobs.remove(key);
      } catch (const Error&) {
        // Nobody owns it, so the next start removes it.
      }
  }

  /// Queues a job again that could not finish: with its turn, when that is what it gave back; else for the next start.
  void put_back(const JobPtr& job);

  void take_up_unfinished();
  void work_on();
  bool work_once();
  void run(const JobPtr& job);
  void keep_time();
  JobRecord cancel_now(std::unique_lock<std::mutex>& lock, const JobPtr& job);
};

namespace {

Error too_much(std::uint64_t needed, std::uint64_t there) {
  const auto mib = [](std::uint64_t bytes) { return std::to_string((bytes + (1 << 20) - 1) >> 20) + " MiB"; };
  return {ErrorCode::unusable, "This work needs about " + mib(needed) + " of memory, and this server has " +
                                   mib(there) +
                                   " for it; ask for less, such as a coarser volume, or use a larger server."};
}

JobError too_long(std::chrono::milliseconds limit) {
  const auto seconds = std::chrono::ceil<std::chrono::seconds>(limit).count();
  return {ErrorCode::too_large, "This work was stopped after " + std::to_string(seconds) +
                                    " s, which is as long as one job may run here (max_job_s); ask for less, such as a "
                                    "coarser volume or fewer spheres, or have the limit raised."};
}

class Running final : public JobContext {
 public:
  using Revise = std::function<void(std::uint64_t bytes)>;

  Running(unsigned threads, Job& job, std::mutex& mutex, std::condition_variable& changed, Revise revise)
      : threads_(threads), job_(job), mutex_(mutex), changed_(changed), revise_(std::move(revise)) {}

  Context context(double from, double to) override {
    Context context;
    context.threads = threads_;
    context.cancel = job_.stop.get_token();
    context.progress = [this, from, to](std::string_view stage, double fraction) {
      advance(stage, from + (to - from) * std::clamp(fraction, 0.0, 1.0));
    };
    return context;
  }

  void warn(const std::string& sentence) override {
    const std::lock_guard lock(mutex_);
    if (job_.record.warnings.size() == max_warnings) return;
    job_.record.warnings.push_back(sentence);
    job_.announce(JobEvent::Type::warning, sentence);
    changed_.notify_all();
  }

  void expect_memory(std::uint64_t bytes) override { revise_(bytes); }

 private:
  void advance(std::string_view stage, double progress) {
    const std::lock_guard lock(mutex_);
    const bool new_stage = job_.record.stage != stage;
    if (new_stage) job_.record.stage = stage;
    // In this order a NaN changes nothing.
    job_.record.progress = std::max(job_.record.progress, std::min(progress, 1.0));
    if (!new_stage && job_.record.progress < job_.announced_progress + progress_event_step) return;
    job_.announce(JobEvent::Type::progress);
    changed_.notify_all();
  }

  const unsigned threads_;
  Job& job_;
  std::mutex& mutex_;
  std::condition_variable& changed_;
  const Revise revise_;
};

}  // namespace

void JobPool::State::take_up_unfinished() {
  const std::lock_guard lock(mutex);
  for (JobRecord& record : catalog.unfinished_jobs()) {
    if (record.state == JobState::cancelling) {
      // The cancellation was acknowledged; only the runner had not come back yet.
      catalog.update_job(ended(record, JobState::cancelled));
      continue;
    }
    // An orderly stop leaves running jobs queued, so this one was running when the process died.
    if (record.state == JobState::running) ++record.crashes;
    ++record.attempts;
    if (record.crashes >= options.crash_limit) {
      catalog.update_job(
          ended(record, JobState::failed,
                JobError{ErrorCode::unusable, "The server stopped " + std::to_string(record.crashes) +
                                                  " times during this work and will not try it again; ask for less."}));
      continue;
    }
    record.state = JobState::queued;
    record.stage.clear();
    record.progress = 0;
    record.started.reset();
    record.warnings.clear();
    catalog.update_job(record);
    enqueue(std::make_shared<Job>(std::move(record)));
  }
}

void JobPool::State::work_on() {
  for (;;) try {
      if (!work_once()) return;
    } catch (...) {
      // Memory for a few words was missing; the next job may find it.
      static_cast<void>(reason("pool"));
    }
}

/// False when the pool stops.
bool JobPool::State::work_once() {
  JobPtr job;
  {
    std::unique_lock lock(mutex);
    work.wait(lock, [&] { return stopping || may_start_next(); });
    if (stopping) return false;
    job = queue.pop();
    JobRecord record = job->record;
    record.started = now();
    job->run_began = SteadyClock::now();
    try {
      // Somebody may have made the same thing between the requester's look and the queue.
      if (catalog.find(record.result_id)) {
        store_end(*job, ended(std::move(record), JobState::succeeded));
        return true;
      }
      record.state = JobState::running;
      catalog.update_job(record);
    } catch (...) {
      store_end(*job, ended(std::move(record), JobState::failed, reason(job->record.id)));
      return true;
    }
    job->record = std::move(record);
    ++running;
    job->holds = job->record.memory_bytes;
    memory.taken += job->holds;
    alone = job->record.crashes > 0;
    announce(*job, JobEvent::Type::state);
    begun.notify_all();
  }
  run(job);
  return true;
}

/// Stops what has run for too long.
void JobPool::State::keep_time() {
  std::unique_lock lock(mutex);
  while (!stopping) {
    const auto now = SteadyClock::now();
    auto next = SteadyClock::time_point::max();
    std::vector<JobPtr> late;
    for (const auto& [id, job] : jobs) {
      if (job->record.state != JobState::running || job->verdict) continue;
      const auto deadline = job->run_began + options.longest_run;
      deadline <= now ? late.push_back(job) : static_cast<void>(next = std::min(next, deadline));
    }
    for (const JobPtr& job : late) {
      job->verdict = too_long(options.longest_run);
      no_longer_joinable(*job);
    }
    if (!late.empty()) {
      lock.unlock();
      for (const JobPtr& job : late) job->stop.request_stop();  // runs callbacks, which may ask for the mutex
      lock.lock();
    } else if (next == SteadyClock::time_point::max()) {
      begun.wait(lock);
    } else {
      begun.wait_until(lock, next);
    }
  }
}

void JobPool::State::revise(Job& job, std::uint64_t bytes) {
  if (bytes > options.memory_bytes) throw too_much(bytes, options.memory_bytes);
  const std::lock_guard lock(mutex);
  job.record.memory_bytes = bytes;
  if (bytes > job.holds && bytes - job.holds > memory.free() && memory.taken > job.holds) {
    job.again = true;
    throw Error(ErrorCode::busy, "This work waits until there is more memory.");
  }
  memory.taken += bytes - job.holds;
  job.holds = bytes;
  give_back(memory, 0);
}

void JobPool::State::put_back(const JobPtr& job) {
  leave_for_next_start(*job);
  if (!std::exchange(job->again, false)) return;
  queue.push_front(job->record.client, job);
  announce(*job, JobEvent::Type::state);
}

void JobPool::State::run(const JobPtr& job) {
  // A copy, since requesters that join or leave change the original meanwhile.
  const JobRecord record_at_start = [&] {
    const std::lock_guard lock(mutex);
    return job->record;
  }();
  std::optional<Resource> result;
  std::optional<JobError> error;
  try {
    Running context(std::max(1U, options.threads_per_job), *job, mutex, changed,
                    [&](std::uint64_t bytes) { revise(*job, bytes); });
    Resource made = runner(record_at_start, context);
    SPHERULE_CHECK(made.id == record_at_start.result_id);
    result = std::move(made);
  } catch (...) {
    error = reason(record_at_start.id);
  }

  std::vector<std::string> unneeded;
  if (result) unneeded = result->blobs;
  {
    const std::lock_guard lock(mutex);
    --running;
    alone = false;
    give_back(memory, job->holds);
    if (job->record.state == JobState::cancelling) {
      // Even with a result in hand: the requester was told that it would not come.
      store_end(*job, ended(job->record, JobState::cancelled));
    } else if (result) {
      try {
        JobRecord record = ended(job->record, JobState::succeeded);
        if (catalog.complete_job(record, *result)) {
          settle_all(blobs, unneeded);
          unneeded.clear();
        }
        end(*job, std::move(record));
      } catch (...) {
        const JobError why = reason(job->record.id);
        // After an I/O error the row may yet turn out to be there; then its blobs must be, too.
        if (why.code == ErrorCode::corrupt) unneeded.clear();
        store_end(*job, ended(job->record, JobState::failed, why));
      }
    } else if (job->verdict) {
      // Whatever it threw: libraries report an interruption in ways of their own.
      store_end(*job, ended(job->record, JobState::failed, job->verdict));
    } else if (job->again || (stopping && job->stop.stop_requested())) {
      put_back(job);
    } else {
      store_end(*job, ended(job->record, JobState::failed, std::move(error)));
    }
    changed.notify_all();
  }
  take_back(unneeded);
}

JobPool::JobPool(JobPoolOptions options, Catalog& catalog, BlobStore& blobs, JobRunner runner, FaultLog log,
                 EndLog ended)
    : state_(std::make_unique<State>(options, catalog, blobs, std::move(runner), std::move(log), std::move(ended))) {
  state_->take_up_unfinished();
  for (unsigned i = 0; i < std::max(1U, options.jobs_at_once); ++i)
    state_->workers.emplace_back([state = state_.get()] { state->work_on(); });
  if (options.longest_run < std::chrono::milliseconds::max())
    state_->timekeeper = std::jthread([state = state_.get()] { state->keep_time(); });
}

JobPool::~JobPool() {
  static_cast<void>(stop(std::chrono::milliseconds(0)));
  state_->workers.clear();  // joins
}

JobRecord JobPool::submit(const api::WorkRequest& request, const std::string& result_id, const std::string& client,
                          std::uint64_t memory_bytes) {
  State& s = *state_;
  std::unique_lock lock(s.mutex);
  s.changed.wait(lock, [&] {
    return std::ranges::none_of(s.arriving, [&](const auto& job) { return job.second->record.result_id == result_id; });
  });
  if (s.stopping) throw Error(ErrorCode::busy, "The server is stopping; try again once it is back.");
  if (const auto same = s.by_result.find(result_id); same != s.by_result.end()) {
    Job& job = *same->second;
    JobRecord record = job.record;
    if (!record.requesters.insert(client).second) return s.status(job);
    s.catalog.update_job(record);
    job.record = std::move(record);
    return s.status(job);
  }
  if (memory_bytes > s.options.memory_bytes) throw too_much(memory_bytes, s.options.memory_bytes);
  if (s.queue.size() + s.arriving.size() >= s.options.queue_length)
    throw Error(ErrorCode::busy, "The server has as much work waiting as it accepts; try again in a while.");
  const auto arriving =
      std::ranges::count_if(s.arriving, [&](const auto& job) { return job.second->record.client == client; });
  if (s.queue.size_of(client) + static_cast<std::size_t>(arriving) >= s.options.queue_per_client)
    throw Error(ErrorCode::throttled,
                "You have as many jobs waiting as one client may; try again when some of them are done.");
  JobRecord record;
  record.id = random_id("job");
  record.kind = api::kind_of(request).name;
  record.result_id = result_id;
  record.request = request;
  record.client = client;
  record.requesters = {client};
  record.memory_bytes = memory_bytes;
  record.created = now();
  const auto job = std::make_shared<Job>(std::move(record));
  const std::string& id = job->record.id;
  s.arriving[id] = job;
  lock.unlock();
  try {
    s.catalog.add_job(job->record);
  } catch (...) {
    lock.lock();
    s.arriving.erase(id);
    s.changed.notify_all();
    throw;
  }
  lock.lock();
  s.arriving.erase(id);
  s.enqueue(job);
  return s.status(*job);
}

JobRecord JobPool::status(const std::string& id) const {
  const std::lock_guard lock(state_->mutex);
  if (const auto job = state_->find(id)) return state_->status(*job);
  std::optional<JobRecord> record = state_->catalog.find_job(id);
  if (!record) throw not_found();
  return status_of(std::move(*record));
}

Page<JobRecord> JobPool::list(const std::string& cursor, std::size_t limit) const {
  const std::lock_guard lock(state_->mutex);
  Page<JobRecord> records = state_->catalog.list_jobs(cursor, limit);
  Page<JobRecord> page;
  page.next = std::move(records.next);
  page.damaged = std::move(records.damaged);
  for (JobRecord& record : records.items) {
    const auto job = state_->find(record.id);
    page.items.push_back(job ? state_->status(*job) : status_of(std::move(record)));
  }
  return page;
}

JobRecord JobPool::wait(const std::string& id, std::chrono::milliseconds timeout) const {
  {
    std::unique_lock lock(state_->mutex);
    if (const auto job = state_->find(id)) {
      state_->changed.wait_for(lock, timeout, [&] { return state_->stopping || is_over(job->record.state); });
      return state_->status(*job);
    }
  }
  return status(id);
}

JobEvents JobPool::events(const std::string& id, std::uint64_t after, std::chrono::milliseconds timeout) const {
  std::unique_lock lock(state_->mutex);
  state_->await_arrival(lock, id);
  JobEvents news;
  if (const auto job = state_->find(id)) {
    state_->changed.wait_for(
        lock, timeout, [&] { return state_->stopping || job->last_number > after || is_over(job->record.state); });
    for (const JobEvent& event : job->events)
      if (event.number > after) news.events.push_back(event);
    news.over = is_over(job->record.state);
    news.stopping = state_->stopping && !news.over;
    return news;
  }
  const std::optional<JobRecord> record = state_->catalog.find_job(id);
  if (!record) throw not_found();
  news.over = true;
  if (end_event(*record) > after)
    news.events.push_back(
        {end_event(*record), JobEvent::Type::end, record->state, record->stage, record->progress, {}});
  return news;
}

std::optional<JobRecord> JobPool::cancel(const std::string& id, const std::string& client) {
  State& s = *state_;
  std::unique_lock lock(s.mutex);
  s.await_arrival(lock, id);
  const auto job = s.unfinished(id);
  if (job->record.state == JobState::cancelling) return s.status(*job);
  if (!job->record.requesters.contains(client)) return {};
  if (job->record.requesters.size() == 1) return s.cancel_now(lock, job);
  JobRecord record = job->record;
  record.requesters.erase(client);
  s.catalog.update_job(record);
  job->record = std::move(record);
  return s.status(*job);
}

JobPool::Memory JobPool::reserve(std::uint64_t bytes, std::chrono::milliseconds patience, const std::stop_token& stop) {
  State& s = *state_;
  if (bytes > s.options.memory_bytes) throw too_much(bytes, s.options.memory_bytes);
  Budget& budget = bytes <= s.options.memory_bytes / kSmallPart ? s.small : s.memory;
  std::unique_lock lock(s.mutex);
  const auto place = budget.line.insert(budget.line.end(), bytes);
  s.room.wait_for(lock, stop, patience,
                  [&] { return s.stopping || (place == budget.line.begin() && budget.fits(bytes)); });
  const bool granted = !s.stopping && place == budget.line.begin() && budget.fits(bytes);
  if (granted) budget.taken += bytes;
  budget.line.erase(place);
  s.give_back(budget, 0);  // whoever is next in line may fit, too
  if (!granted && stop.stop_requested())
    throw Error(ErrorCode::cancelled, "The request was given up before there was memory for it.");
  if (!granted && s.stopping) throw Error(ErrorCode::busy, "The server is stopping; try again once it is back.");
  if (!granted) throw Error(ErrorCode::busy, "The server's memory is taken by other work; try again in a while.");
  return {nullptr, [&s, &budget, bytes](const void*) {
            const std::lock_guard held(s.mutex);
            s.give_back(budget, bytes);
          }};
}

JobRecord JobPool::cancel_for_all(const std::string& id) {
  State& s = *state_;
  std::unique_lock lock(s.mutex);
  s.await_arrival(lock, id);
  const auto job = s.unfinished(id);
  return job->record.state == JobState::cancelling ? s.status(*job) : s.cancel_now(lock, job);
}

/// Gives the lock back.
JobRecord JobPool::State::cancel_now(std::unique_lock<std::mutex>& lock, const JobPtr& job) {
  JobRecord record = job->record;
  record.requesters.clear();
  if (record.state == JobState::queued) {
    record = ended(std::move(record), JobState::cancelled);
    catalog.update_job(record);
    queue.erase(job);
    work.notify_all();
    end(*job, std::move(record));
    return status(*job);
  }
  record.state = JobState::cancelling;
  catalog.update_job(record);
  job->record = std::move(record);
  no_longer_joinable(*job);
  announce(*job, JobEvent::Type::state);
  const JobRecord now = status(*job);
  lock.unlock();
  job->stop.request_stop();  // runs the runner's stop callbacks, which may ask for the mutex
  return now;
}

void JobPool::abandon(const std::function<bool(const JobRecord& job)>& pointless, const JobError& reason) {
  State& s = *state_;
  std::vector<State::JobPtr> queued, at_work;
  {
    const std::lock_guard lock(s.mutex);
    for (const auto& [id, job] : s.jobs) {
      if (is_over(job->record.state) || job->verdict || !pointless(job->record)) continue;
      (job->record.state == JobState::queued ? queued : at_work).push_back(job);
    }
    for (const auto& job : queued) {
      s.queue.erase(job);
      s.store_end(*job, State::ended(job->record, JobState::failed, reason));
    }
    for (const auto& job : at_work) {
      job->verdict = reason;
      s.no_longer_joinable(*job);
    }
    s.work.notify_all();
  }
  for (const auto& job : at_work) job->stop.request_stop();
}

bool JobPool::stop(std::chrono::milliseconds grace) {
  State& s = *state_;
  std::vector<std::jthread> workers;
  std::vector<std::shared_ptr<Job>> unfinished;
  const auto at_rest = [&] { return s.running == 0; };
  {
    std::unique_lock lock(s.mutex);
    s.stopping = true;
    s.give_back(s.memory, 0);
    s.changed.notify_all();
    s.begun.notify_all();
    s.changed.wait_for(lock, grace, at_rest);
    for (const auto& [id, job] : s.jobs)
      if (job->record.state == JobState::running) unfinished.push_back(job);
  }
  for (const auto& job : unfinished) job->stop.request_stop();
  {
    std::unique_lock lock(s.mutex);
    if (!s.changed.wait_for(lock, hearing, at_rest)) {
      // Not theirs is the blame should the process be ended now.
      for (const auto& job : unfinished)
        if (job->record.state == JobState::running) s.leave_for_next_start(*job);
      return false;
    }
    workers.swap(s.workers);
  }
  return true;  // joins: what they still tidy up is done
}

JobPool::Load JobPool::load() const {
  const State& s = *state_;
  const std::lock_guard lock(s.mutex);
  return {.queued = s.queue.size() + s.arriving.size(),
          .running = s.running,
          .memory_bytes = s.memory.taken + s.small.taken,
          .reserving = s.memory.line.size() + s.small.line.size(),
          .stopping = s.stopping,
          .ended = s.ended_so_far};
}

}  // namespace spherule::server
