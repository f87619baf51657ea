// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which job starts when: turns of clients, and memory.
#include <gtest/gtest.h>

#include <condition_variable>
#include <map>
#include <mutex>
#include <set>

#include "server/jobs.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using test::error_of;

class Admission : public testing::Test {
 protected:
  test::ScratchCatalog catalog;
  test::MemoryBlobStore blobs;
  std::mutex mutex;
  std::condition_variable_any changed;
  std::vector<std::string> started;              // result ids, in order
  std::map<std::string, std::uint64_t> revised;  // estimates that a job announces once it runs
  std::set<std::string> finish;                  // jobs that may end

  /// Runs until let_end() names it.
  JobRunner runner() {
    return [this](const JobRecord& job, JobContext& context) {
      const Context work = context.context(0, 1);
      std::unique_lock lock(mutex);
      started.push_back(job.result_id);
      changed.notify_all();
      if (const auto bytes = revised.find(job.result_id); bytes != revised.end()) {
        lock.unlock();
        context.expect_memory(bytes->second);
        lock.lock();
      }
      changed.wait(lock, work.cancel, [&] { return finish.contains(job.result_id) || finish.contains("everything"); });
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
  static std::string over(JobPool& pool, const JobStatus& job) {
    return std::string(to_string(pool.wait(job.record.id, 60s).record.state));
  }
};

using Names = std::vector<std::string>;

TEST_F(Admission, ClientsTakeTurns) {
  JobPool pool({}, catalog, blobs, runner());
  std::vector<JobStatus> jobs;
  pool.submit("model", "a1", "", "a");
  await_started(1);
  for (const char* name : {"a2", "a3", "b1", "c1", "b2"}) jobs.push_back(pool.submit("model", name, "", {name[0]}));
  EXPECT_EQ(pool.status(jobs[1].record.id).queue_position, 3U) << "a3 after a2 b1 c1";
  EXPECT_EQ(pool.status(jobs[2].record.id).queue_position, 1U);
  let_end({"everything"});
  EXPECT_EQ(await_started(6), (Names{"a1", "a2", "b1", "c1", "a3", "b2"}));
}

TEST_F(Admission, AClientHasAPartOfTheQueue) {
  JobPool pool({.queue_length = 4, .queue_per_client = 2}, catalog, blobs, runner());
  pool.submit("model", "running", "", "a");
  await_started(1);
  pool.submit("model", "a1", "", "a");
  pool.submit("model", "a2", "", "a");
  EXPECT_EQ(error_of([&] { pool.submit("model", "a3", "", "a"); }), ErrorCode::throttled);
  EXPECT_FALSE(error_of([&] { pool.submit("model", "a2", "", "a"); })) << "joining needs no place";
  pool.submit("model", "b1", "", "b");
  pool.submit("model", "b2", "", "b");
  EXPECT_EQ(error_of([&] { pool.submit("model", "c1", "", "c"); }), ErrorCode::busy);
}

TEST_F(Admission, WorkThatCanNeverFitIsRefusedWithTheEstimate) {
  JobPool pool({.memory_bytes = 10 << 20}, catalog, blobs, runner());
  try {
    pool.submit("model", "large", "", "a", (10 << 20) + 1);
    FAIL() << "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::unusable);
    EXPECT_NE(std::string(error.what()).find("about 11 MiB of memory, and this server has 10 MiB"), std::string::npos);
  }
  EXPECT_TRUE(catalog.list_jobs("", 10).items.empty());
  pool.submit("model", "all of it", "", "a", 10 << 20);
  await_started(1);
}

TEST_F(Admission, WorkThatDoesNotFitYetWaitsAndIsNotOvertaken) {
  JobPool pool({.jobs_at_once = 3, .memory_bytes = 100}, catalog, blobs, runner());
  pool.submit("model", "60", "", "a", 60);
  await_started(1);
  const JobStatus large = pool.submit("model", "50", "", "b", 50);
  const JobStatus small = pool.submit("model", "10", "", "c", 10);
  EXPECT_EQ(pool.load().memory_bytes, 60U);
  EXPECT_EQ(pool.wait(small.record.id, 50ms).record.state, JobState::queued) << "its turn comes after";
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
  const JobStatus first = pool.submit("model", "shrinks", "", "a", 90);
  const JobStatus second = pool.submit("model", "second", "", "a", 80);
  EXPECT_EQ(await_started(2), (Names{"shrinks", "second"}));
  const JobStatus grows = pool.submit("model", "grows", "", "a", 1);
  let_end({"shrinks", "second"});
  EXPECT_EQ(over(pool, first), "succeeded");
  EXPECT_EQ(over(pool, second), "succeeded");
  EXPECT_EQ(over(pool, grows), "failed");
  const JobRecord failed = pool.status(grows.record.id).record;
  ASSERT_TRUE(failed.error && failed.error->code);
  EXPECT_EQ(failed.error->code, ErrorCode::unusable);
  EXPECT_EQ(pool.load().memory_bytes, 0U);
}

TEST_F(Admission, CancellingTheNextLetsTheOneAfterStart) {
  JobPool pool({.jobs_at_once = 2, .memory_bytes = 100}, catalog, blobs, runner());
  pool.submit("model", "60", "", "a", 60);
  await_started(1);
  const JobStatus large = pool.submit("model", "50", "", "b", 50);
  pool.submit("model", "10", "", "c", 10);
  pool.cancel(large.record.id);
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
