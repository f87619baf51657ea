// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which job starts when: turns of clients, and memory.
#include <gtest/gtest.h>

#include <algorithm>
#include <condition_variable>
#include <map>
#include <mutex>
#include <optional>
#include <set>
#include <thread>

#include "server/work/jobs.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using test::asks;
using test::error_of;

class Admission : public testing::Test {
 protected:
  test::ScratchCatalog catalog;
  test::MemoryBlobStore blobs;
  std::mutex mutex;
  std::condition_variable_any changed;
  std::vector<std::string> started;              // result ids, in order
  std::map<std::string, std::uint64_t> revised;  // estimates that a job announces once it runs
  std::size_t grow_together = 0;                 // how many have started before any announces it
  std::uint64_t grown = 0;                       // what those that run have announced
  std::set<std::string> finish;                  // jobs that may end

  /// Runs until let_end() names it.
  JobRunner runner() {
    return [this](const JobRecord& job, JobContext& context) {
      const Context work = context.context(0, 1);
      std::unique_lock lock(mutex);
      started.push_back(job.result_id);
      changed.notify_all();
      if (const auto bytes = revised.find(job.result_id); bytes != revised.end()) {
        EXPECT_TRUE(changed.wait_for(lock, 60s, [&] { return started.size() >= grow_together; }));
        lock.unlock();
        context.expect_memory(bytes->second);
        lock.lock();
        EXPECT_LE(grown += bytes->second, 100U) << "more than all jobs may have";
      }
      changed.wait(lock, work.cancel, [&] { return finish.contains(job.result_id) || finish.contains("everything"); });
      grown = 0;  // only one at a time has any
      work.throw_if_cancelled();
      Resource result;
      result.id = job.result_id;
      result.collection = "models";
      return result;
    };
  }
  void let_end(const std::set<std::string>& ids) {
    const std::lock_guard lock(mutex);
    finish.insert(ids.begin(), ids.end());
    changed.notify_all();
  }
  std::vector<std::string> await_started(std::size_t count) {
    std::unique_lock lock(mutex);
    EXPECT_TRUE(changed.wait_for(lock, 60s, [&] { return started.size() >= count; }));
    return started;
  }
  /// A job of 40 bytes that runs, and beside it one that grows from 10 to 70, which is returned.
  JobRecord start_growing(JobPool& pool) {
    revised = {{"grows", 70}};
    pool.submit(asks(), "40", "a", 40);
    await_started(1);
    JobRecord grows = pool.submit(asks(), "grows", "b", 10);
    await_started(2);
    return grows;
  }
  static JobRecord await(const JobPool& pool, const JobRecord& job, JobState state) {
    for (std::uint64_t seen = 0; pool.status(job.id).state != state;) {
      const JobEvents news = pool.events(job.id, seen, 60s);
      if (news.events.empty() || news.over) break;
      seen = news.events.back().number;
    }
    EXPECT_EQ(pool.status(job.id).state, state);
    return pool.status(job.id);
  }
  static std::string over(JobPool& pool, const JobRecord& job) {
    return std::string(api::name(pool.wait(job.id, 60s).state));
  }
};

using Names = std::vector<std::string>;

TEST_F(Admission, ClientsTakeTurns) {
  JobPool pool({}, catalog, blobs, runner());
  std::vector<JobRecord> jobs;
  pool.submit(asks(), "a1", "a");
  await_started(1);
  for (const char* name : {"a2", "a3", "b1", "c1", "b2"}) jobs.push_back(pool.submit(asks(), name, {name[0]}));
  EXPECT_EQ(pool.status(jobs[1].id).queue_position, 3U) << "a3 after a2 b1 c1";
  EXPECT_EQ(pool.status(jobs[2].id).queue_position, 1U);
  let_end({"everything"});
  EXPECT_EQ(await_started(6), (Names{"a1", "a2", "b1", "c1", "a3", "b2"}));
}

TEST_F(Admission, AClientHasAPartOfTheQueue) {
  JobPool pool({.queue_length = 4, .queue_per_client = 2}, catalog, blobs, runner());
  pool.submit(asks(), "running", "a");
  await_started(1);
  pool.submit(asks(), "a1", "a");
  pool.submit(asks(), "a2", "a");
  EXPECT_EQ(error_of([&] { pool.submit(asks(), "a3", "a"); }), ErrorCode::throttled);
  EXPECT_FALSE(error_of([&] { pool.submit(asks(), "a2", "a"); })) << "joining needs no place";
  pool.submit(asks(), "b1", "b");
  pool.submit(asks(), "b2", "b");
  EXPECT_EQ(error_of([&] { pool.submit(asks(), "c1", "c"); }), ErrorCode::busy);
}

TEST_F(Admission, WorkThatCanNeverFitIsRefusedWithTheEstimate) {
  JobPool pool({.memory_bytes = 10 << 20}, catalog, blobs, runner());
  try {
    pool.submit(asks(), "large", "a", (10 << 20) + 1);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unusable);
    EXPECT_NE(std::string(error.what()).find("about 11 MiB of memory, and this server has 10 MiB"), std::string::npos);
  }
  EXPECT_TRUE(catalog.list_jobs("", 10).items.empty());
  pool.submit(asks(), "all of it", "a", 10 << 20);
  await_started(1);
}

TEST_F(Admission, WorkThatDoesNotFitYetWaitsAndIsNotOvertaken) {
  JobPool pool({.jobs_at_once = 3, .memory_bytes = 100}, catalog, blobs, runner());
  pool.submit(asks(), "60", "a", 60);
  await_started(1);
  const JobRecord large = pool.submit(asks(), "50", "b", 50);
  const JobRecord small = pool.submit(asks(), "10", "c", 10);
  EXPECT_EQ(pool.load().memory_bytes, 60U);
  EXPECT_EQ(pool.wait(small.id, 50ms).state, JobState::queued) << "its turn comes after";
  let_end({"60"});
  await_started(3);
  EXPECT_EQ(pool.load().memory_bytes, 60U);
  let_end({"everything"});
  EXPECT_EQ(over(pool, large), "succeeded");
  EXPECT_EQ(over(pool, small), "succeeded");
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

TEST_F(Admission, EstimatesAreCorrectedWhileTheWorkRuns) {
  revised = {{"shrinks", 20}, {"grows", 101}};
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  const JobRecord first = pool.submit(asks(), "shrinks", "a", 90);
  const JobRecord second = pool.submit(asks(), "second", "a", 80);
  EXPECT_EQ(await_started(2), (Names{"shrinks", "second"}));
  const JobRecord grows = pool.submit(asks(), "grows", "a", 1);
  let_end({"shrinks", "second"});
  EXPECT_EQ(over(pool, first), "succeeded");
  EXPECT_EQ(over(pool, second), "succeeded");
  EXPECT_EQ(over(pool, grows), "failed");
  const JobRecord failed = pool.status(grows.id);
  ASSERT_TRUE(failed.error && failed.error->code);
  EXPECT_EQ(failed.error->code, ErrorCode::unusable);
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

// What a job holds when it learns that it needs more, and that it does not fit beside the others, is freed.
TEST_F(Admission, AJobThatGrowsBeyondWhatIsLeftWaitsForTheOthers) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  const JobRecord grows = start_growing(pool);
  EXPECT_EQ(await(pool, grows, JobState::queued).queue_position, 0U);
  EXPECT_EQ(pool.load().memory_bytes, 40U);
  EXPECT_EQ(catalog.find_job(grows.id)->memory_bytes, 70U) << "for the next start";
  const JobRecord later = pool.submit(asks(), "later", "c", 10);
  EXPECT_EQ(pool.wait(later.id, 50ms).state, JobState::queued) << "it has had its turn already";
  let_end({"40", "grows"});
  EXPECT_EQ(over(pool, grows), "succeeded");
  let_end({"everything"});
  EXPECT_EQ(over(pool, later), "succeeded");
  EXPECT_EQ(await_started(4), (Names{"40", "grows", "grows", "later"}));
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

// Neither waits for the other while it holds memory, and none runs more than twice.
TEST_F(Admission, JobsThatAllGrowComeOneAfterTheOther) {
  constexpr unsigned jobs = 4;
  revised = {{"0", 80}, {"1", 80}, {"2", 80}, {"3", 80}};
  grow_together = jobs;
  JobPool pool({.jobs_at_once = jobs, .memory_bytes = 100}, catalog, blobs, runner());
  std::vector<JobRecord> all;
  for (unsigned i = 0; i < jobs; ++i) all.push_back(pool.submit(asks(), std::to_string(i), "a", 20));
  let_end({"everything"});
  for (const JobRecord& job : all) EXPECT_EQ(over(pool, job), "succeeded");
  for (const JobRecord& job : all) EXPECT_LE(std::ranges::count(started, job.result_id), 2);
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

TEST_F(Admission, AJobThatGaveItsTurnBackCanBeCancelled) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  const JobRecord grows = start_growing(pool);
  await(pool, grows, JobState::queued);
  EXPECT_EQ(pool.cancel(grows.id, "b")->state, JobState::cancelled);
  EXPECT_EQ(pool.load().memory_bytes, 40U);
}

TEST_F(Admission, RequestsTakeMemoryFromTheSameBudget) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 128}, catalog, blobs, runner());
  const JobRecord job = pool.submit(asks(), "100", "a", 100);
  await_started(1);
  EXPECT_EQ(error_of([&] { pool.reserve(129, 60s); }), ErrorCode::unusable);
  EXPECT_EQ(error_of([&] { pool.reserve(29, 1ms); }), ErrorCode::busy);
  std::optional<JobPool::Memory> held = pool.reserve(28, 0ms);
  EXPECT_EQ(pool.load().memory_bytes, 128U);
  EXPECT_EQ(error_of([&] { pool.reserve(3, 1ms); }), ErrorCode::busy);
  held.reset();
  EXPECT_EQ(pool.load().memory_bytes, 100U);
  let_end({"100"});
  over(pool, job);
  const JobPool::Memory all = pool.reserve(128, 60s);
  const JobRecord waits = pool.submit(asks(), "waits", "a", 1);
  EXPECT_EQ(pool.wait(waits.id, 50ms).state, JobState::queued);
}

TEST_F(Admission, SmallRequestsDoNotWaitBehindLargeOnes) {
  JobPool pool({.memory_bytes = 128}, catalog, blobs, runner());
  const JobPool::Memory large = pool.reserve(128, 0ms);
  std::vector<JobPool::Memory> small;
  for (int i = 0; i < 4; ++i) small.push_back(pool.reserve(2, 0ms));
  EXPECT_EQ(error_of([&] { pool.reserve(2, 1ms); }), ErrorCode::busy) << "a sixteenth is theirs";
  small.pop_back();
  pool.reserve(2, 0ms);
}

TEST_F(Admission, ARequestThatWaitsComesBeforeJobsThatDo) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 128}, catalog, blobs, runner());
  pool.submit(asks(), "100", "a", 100);
  await_started(1);
  std::optional<JobPool::Memory> held;
  std::jthread request([&] { held = pool.reserve(100, 60s); });
  while (pool.load().reserving == 0) std::this_thread::yield();
  const JobRecord job = pool.submit(asks(), "20", "b", 20);
  EXPECT_EQ(pool.wait(job.id, 50ms).state, JobState::queued);
  let_end({"everything"});
  request.join();
  EXPECT_EQ(over(pool, job), "succeeded");
  held.reset();
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

TEST_F(Admission, WaitingForMemoryEndsWithTheRequestAndWithThePool) {
  JobPool pool({.memory_bytes = 128}, catalog, blobs, runner());
  const JobPool::Memory all = pool.reserve(128, 0ms);
  std::optional<ErrorCode> first, second;
  std::stop_source gone;
  std::jthread one([&] { first = error_of([&] { pool.reserve(100, 60s, gone.get_token()); }); });
  std::jthread two([&] { second = error_of([&] { pool.reserve(100, 60s); }); });
  while (pool.load().reserving < 2) std::this_thread::yield();
  gone.request_stop();
  one.join();
  pool.stop(0ms);
  two.join();
  EXPECT_EQ(first, ErrorCode::cancelled);
  EXPECT_EQ(second, ErrorCode::busy);
}

TEST_F(Admission, CancellingTheNextLetsTheOneAfterStart) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  pool.submit(asks(), "60", "a", 60);
  await_started(1);
  const JobRecord large = pool.submit(asks(), "50", "b", 50);
  pool.submit(asks(), "10", "c", 10);
  pool.cancel(large.id, "b");
  EXPECT_EQ(await_started(2), (Names{"60", "10"}));
}

TEST_F(Admission, ARestartKeepsClientsAndEstimates) {
  for (const char* name : {"a1", "a2", "b1"}) {
    JobRecord job;
    job.id = std::string("job_") + name;
    job.kind = "model";
    job.result_id = name;
    job.client = name[0];
    job.memory_bytes = 60;
    job.created = now();
    catalog.add_job(job);
  }
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  await_started(1);
  EXPECT_EQ(pool.load().running, 1U) << "two do not fit";
  let_end({"everything"});
  EXPECT_EQ(await_started(3), (Names{"a1", "b1", "a2"}));
}

}  // namespace
}  // namespace spherule::server
