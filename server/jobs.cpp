// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every transition is made under one mutex: first in the catalogue, then in memory. The catalogue's fsync is thereby
// waited for under the mutex; transitions are rare (a few a job), so simplicity wins. Only new jobs, of which many may
// come at once, are stored without it, so that nobody who asks for another job waits for them.
#include "server/jobs.h"

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
#include "server/fair_queue.h"

namespace spherule::server {

namespace {

using SteadyClock = std::chrono::steady_clock;

constexpr std::size_t max_warnings = 100;
constexpr std::size_t kept_finished_jobs = 256;  // with their events; older ones are read from the catalogue
constexpr double progress_event_step = 0.01;
constexpr double least_progress_to_judge_by = 0.02;

// Event numbers: the attempt in the high bits, so that they ascend over restarts without being stored.
std::uint64_t first_event(const JobRecord& job) { return std::uint64_t{job.attempts} << 32; }
std::uint64_t end_event(const JobRecord& job) { return (std::uint64_t{job.attempts + 1} << 32) - 1; }

JobError fault() { return {{}, "The server failed at this work because of a fault of its own; please report it."}; }

Error not_found() { return {ErrorCode::not_found, "There is no job under this id."}; }

double seconds(auto duration) { return std::chrono::duration<double>(duration).count(); }

struct Job {
  JobRecord record;
  SteadyClock::time_point run_began;
  std::stop_source stop;
  std::uint64_t last_number;
  double announced_progress = 0;
  std::vector<JobEvent> events;   // bounded: states, warnings, and at most one of progress
  std::set<std::string> pollers;  // clients that are counted already
  std::uint64_t holds = 0;        // of memory, while it runs
  bool again = false;             // it gives its turn back, until there is more memory

  explicit Job(JobRecord r) : record(std::move(r)), last_number(first_event(record)), pollers{record.client} {}

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
JobStatus status_of(JobRecord record) {
  JobStatus status;
  status.record = std::move(record);
  if (status.record.started && status.record.finished)
    status.elapsed_s = std::max(0.0, seconds(*status.record.finished - *status.record.started));
  return status;
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
  std::vector<std::jthread> workers;

  State(JobPoolOptions o, Catalog& c, BlobStore& b, JobRunner r, FaultLog l, EndLog e)
      : options(o), catalog(c), blobs(b), runner(std::move(r)), log(std::move(l)), ended_log(std::move(e)) {}

  // All below but work_on, run and take_back: with the mutex held.

  JobPtr find(const std::string& id) const {
    const auto found = jobs.find(id);
    return found == jobs.end() ? nullptr : found->second;
  }

  JobStatus status(const Job& job) const {
    JobStatus status = status_of(job.record);
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
    return !queue.empty() && memory.line.empty() && memory.fits(queue.front()->record.memory_bytes);
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
    if (ended_log) ended_log(job.record);
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
    } catch (const Error& error) {
      record = ended(std::move(record), JobState::failed, JobError{error.code(), error.what()});
      job.record = std::move(record);
      note_end(job);
      no_longer_joinable(job);
      announce(job, JobEvent::Type::end);  // and stays in `jobs`, since the catalogue would tell otherwise
    }
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
  void run(const JobPtr& job);
};

namespace {

Error too_much(std::uint64_t needed, std::uint64_t there) {
  const auto mib = [](std::uint64_t bytes) { return std::to_string((bytes + (1 << 20) - 1) >> 20) + " MiB"; };
  return {ErrorCode::unusable, "This work needs about " + mib(needed) + " of memory, and this server has " +
                                   mib(there) +
                                   " for it; ask for less, such as a coarser volume, or use a larger server."};
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
  for (;;) {
    JobPtr job;
    {
      std::unique_lock lock(mutex);
      work.wait(lock, [&] { return stopping || may_start_next(); });
      if (stopping) return;
      job = queue.pop();
      JobRecord record = job->record;
      record.started = now();
      job->run_began = SteadyClock::now();
      try {
        // Somebody may have made the same thing between the requester's look and the queue.
        if (catalog.find(record.result_id)) {
          store_end(*job, ended(std::move(record), JobState::succeeded));
          continue;
        }
        record.state = JobState::running;
        catalog.update_job(record);
      } catch (const Error& error) {
        store_end(*job, ended(std::move(record), JobState::failed, JobError{error.code(), error.what()}));
        continue;
      }
      job->record = std::move(record);
      ++running;
      job->holds = job->record.memory_bytes;
      memory.taken += job->holds;
      announce(*job, JobEvent::Type::state);
    }
    run(job);
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
  JobRecord record = job->record;
  record.state = JobState::queued;
  try {
    catalog.update_job(record);
  } catch (const Error&) {
    // The catalogue still says running: the next start runs it again all the same.
  }
  job->record = std::move(record);
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
    result = runner(record_at_start, context);
    SPHERULE_CHECK(result->id == record_at_start.result_id);
  } catch (const Error& thrown) {
    error = JobError{thrown.code(), thrown.what()};
  } catch (const std::bad_alloc&) {
    error = JobError{ErrorCode::too_large, "This work needs more memory than the server has; ask for less."};
  } catch (const std::exception& thrown) {
    error = fault();
    if (log) log(record_at_start.id, thrown.what());
  } catch (...) {
    error = fault();
    if (log) log(record_at_start.id, "an exception of unknown type");
  }

  std::vector<std::string> unneeded;
  if (result) unneeded = result->blobs;
  {
    const std::lock_guard lock(mutex);
    --running;
    give_back(memory, job->holds);
    if (job->record.state == JobState::cancelling) {
      // Even with a result in hand: the requester was told that it would not come.
      store_end(*job, ended(job->record, JobState::cancelled));
    } else if (result) {
      try {
        JobRecord record = ended(job->record, JobState::succeeded);
        if (catalog.complete_job(record, *result)) unneeded.clear();
        end(*job, std::move(record));
      } catch (const Error& thrown) {
        // After an I/O error the row may yet turn out to be there; then its blobs must be, too.
        if (thrown.code() == ErrorCode::corrupt) unneeded.clear();
        store_end(*job, ended(job->record, JobState::failed, JobError{thrown.code(), thrown.what()}));
      }
    } else if (job->again || (stopping && job->stop.stop_requested())) {
      // Whatever it threw: libraries report an interruption in ways of their own.
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
}

JobPool::~JobPool() { stop(std::chrono::milliseconds(0)); }

JobStatus JobPool::submit(const std::string& kind, const std::string& result_id, const std::string& request,
                          const std::string& client, std::uint64_t memory_bytes, bool poll) {
  State& s = *state_;
  std::unique_lock lock(s.mutex);
  s.changed.wait(lock, [&] {
    return std::ranges::none_of(s.arriving, [&](const auto& job) { return job.second->record.result_id == result_id; });
  });
  if (s.stopping) throw Error(ErrorCode::busy, "The server is stopping; try again once it is back.");
  if (const auto same = s.by_result.find(result_id); same != s.by_result.end()) {
    Job& job = *same->second;
    if (poll && job.pollers.contains(client)) return s.status(job);
    JobRecord record = job.record;
    ++record.requesters;
    s.catalog.update_job(record);
    job.record = std::move(record);
    if (poll) job.pollers.insert(client);
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
  record.kind = kind;
  record.result_id = result_id;
  record.request = request;
  record.client = client;
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

JobStatus JobPool::status(const std::string& id) const {
  const std::lock_guard lock(state_->mutex);
  if (const auto job = state_->find(id)) return state_->status(*job);
  std::optional<JobRecord> record = state_->catalog.find_job(id);
  if (!record) throw not_found();
  return status_of(std::move(*record));
}

Page<JobStatus> JobPool::list(const std::string& cursor, std::size_t limit) const {
  const std::lock_guard lock(state_->mutex);
  Page<JobRecord> records = state_->catalog.list_jobs(cursor, limit);
  Page<JobStatus> page;
  page.next = std::move(records.next);
  for (JobRecord& record : records.items) {
    const auto job = state_->find(record.id);
    page.items.push_back(job ? state_->status(*job) : status_of(std::move(record)));
  }
  return page;
}

JobStatus JobPool::wait(const std::string& id, std::chrono::milliseconds timeout) const {
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

JobStatus JobPool::cancel(const std::string& id, const std::string& client) {
  State& s = *state_;
  const Error over(ErrorCode::conflict, "This job is over already; there is nothing to cancel.");
  std::unique_lock lock(s.mutex);
  s.await_arrival(lock, id);
  const auto job = s.find(id);
  if (!job) {
    if (!s.catalog.find_job(id)) throw not_found();
    throw over;
  }
  if (is_over(job->record.state)) throw over;
  if (job->record.state == JobState::cancelling) return s.status(*job);
  JobRecord record = job->record;
  --record.requesters;
  if (record.requesters > 0) {
    s.catalog.update_job(record);
    job->record = std::move(record);
    job->pollers.erase(client);
  } else if (record.state == JobState::queued) {
    record = State::ended(std::move(record), JobState::cancelled);
    s.catalog.update_job(record);
    s.queue.erase(job);
    s.work.notify_all();
    s.end(*job, std::move(record));
  } else {
    record.state = JobState::cancelling;
    s.catalog.update_job(record);
    job->record = std::move(record);
    s.no_longer_joinable(*job);
    s.announce(*job, JobEvent::Type::state);
    const JobStatus status = s.status(*job);
    lock.unlock();
    job->stop.request_stop();  // runs the runner's stop callbacks, which may ask for the mutex
    return status;
  }
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
            const std::lock_guard lock(s.mutex);
            s.give_back(budget, bytes);
          }};
}

void JobPool::stop(std::chrono::milliseconds grace) {
  State& s = *state_;
  std::vector<std::jthread> workers;
  std::vector<std::shared_ptr<Job>> unfinished;
  {
    std::unique_lock lock(s.mutex);
    s.stopping = true;
    s.give_back(s.memory, 0);
    s.changed.notify_all();
    s.changed.wait_for(lock, grace, [&] { return s.running == 0; });
    for (const auto& [id, job] : s.jobs)
      if (job->record.state == JobState::running) unfinished.push_back(job);
    workers.swap(s.workers);
  }
  for (const auto& job : unfinished) job->stop.request_stop();
  workers.clear();  // joins
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
