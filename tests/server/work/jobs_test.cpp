// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/jobs.h"

#include <gtest/gtest.h>

#include <atomic>
#include <cmath>
#include <condition_variable>
#include <latch>
#include <mutex>
#include <random>
#include <set>
#include <thread>

#include "core/base/check.h"
#include "server/records/sqlite.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using test::asked;
using test::asks;
using test::error_of;

constexpr auto forever = 60s;

/// Opens once; whoever passes waits until then, or until its work is stopped.
class Gate {
 public:
  void open() {
    const std::lock_guard lock(mutex_);
    open_ = true;
    changed_.notify_all();
  }
  void pass(const Context& context) {
    std::unique_lock lock(mutex_);
    changed_.wait(lock, context.cancel, [&] { return open_; });
    context.throw_if_cancelled();
  }
  void pass() { pass(Context()); }

 private:
  std::mutex mutex_;
  std::condition_variable_any changed_;
  bool open_ = false;
};

class Jobs : public testing::Test {
 protected:
  test::ScratchCatalog catalog;
  test::MemoryBlobStore blobs;

  /// As a process that ended leaves a job.
  void leave(const std::string& id, JobState state, unsigned crashes) {
    JobRecord job;
    job.id = id;
    job.kind = "model";
    job.result_id = "mdl_" + id;
    job.request = asks(id);
    job.state = state;
    job.crashes = crashes;
    job.created = now();
    catalog.add_job(job);
  }

  /// What a well-behaved runner returns.
  Resource result_of(const JobRecord& job) {
    Resource result;
    result.id = job.result_id;
    result.collection = "models";
    result.document = asked(job);
    result.blobs = {blobs.put("models/x", asked(job))};
    return result;
  }

  JobRunner at_once() {
    return [this](const JobRecord& job, JobContext&) { return result_of(job); };
  }

  JobRunner behind(Gate& gate) {
    return [this, &gate](const JobRecord& job, JobContext& context) {
      gate.pass(context.context(0, 1));
      return result_of(job);
    };
  }

  static void await_state(const JobPool& pool, const std::string& id, JobState state) {
    std::uint64_t seen = 0;
    for (;;) {
      const JobEvents news = pool.events(id, seen, forever);
      for (const JobEvent& event : news.events)
        if (event.state == state) return;
      ASSERT_FALSE(news.over || news.events.empty()) << "never " << api::name(state);
      seen = news.events.back().number;
    }
  }
};

TEST_F(Jobs, SucceedsWithADurableResult) {
  JobPool pool({}, catalog, blobs, at_once());
  const JobRecord accepted = pool.submit(asks("{}"), "mdl_1");
  EXPECT_TRUE(is_id("job", accepted.id));
  EXPECT_EQ(accepted.requesters, std::set<std::string>{""});
  const JobRecord done = pool.wait(accepted.id, forever);
  EXPECT_EQ(done.state, JobState::succeeded);
  EXPECT_EQ(done.progress, 1);
  EXPECT_TRUE(done.started && done.finished);
  EXPECT_LE(*done.started, *done.finished);
  EXPECT_EQ(blobs.read(catalog.find("mdl_1")->blobs.at(0)), "{}");
  EXPECT_EQ(catalog.find_job(accepted.id)->state, JobState::succeeded);
  EXPECT_EQ(error_of([&] { (void)pool.status("job_none"); }), ErrorCode::not_found);
  EXPECT_EQ(error_of([&] { (void)pool.wait("job_none", 0ms); }), ErrorCode::not_found);
  EXPECT_EQ(error_of([&] { (void)pool.events("job_none", 0, 0ms); }), ErrorCode::not_found);
  EXPECT_EQ(error_of([&] { pool.cancel("job_none"); }), ErrorCode::not_found);
}

TEST_F(Jobs, FailsWithTheErrorsSentenceAndHidesFaults) {
  std::string logged;
  JobPool pool(
      {}, catalog, blobs,
      [](const JobRecord& job, JobContext& context) -> Resource {
        context.context(0, 1).report("boundary", 0.5);
        if (asked(job) == "error") throw Error(ErrorCode::unusable, "There is no object at this threshold.");
        if (asked(job) == "memory") throw std::bad_alloc();
        if (asked(job) == "odd") throw 7;
        throw std::runtime_error("/etc/secret: bug");
      },
      [&](const std::string&, const std::string& what) { logged += what + "\n"; });
  const auto fate = [&](const char* request) {
    const JobRecord over = pool.wait(pool.submit(asks(request), request).id, forever);
    EXPECT_EQ(over.state, JobState::failed);
    EXPECT_EQ(over.stage, "boundary");
    EXPECT_EQ(over.progress, 0.5);
    return over.error.value();
  };
  EXPECT_EQ(fate("error").code, ErrorCode::unusable);
  EXPECT_EQ(fate("error").sentence, "There is no object at this threshold.");
  EXPECT_EQ(fate("memory").code, ErrorCode::too_large);
  EXPECT_FALSE(fate("bug").code);
  EXPECT_EQ(fate("bug").sentence.find("secret"), std::string::npos);
  EXPECT_FALSE(fate("odd").code);
  EXPECT_EQ(logged, "/etc/secret: bug\n/etc/secret: bug\nan exception of unknown type\n");
}

TEST_F(Jobs, TheQueueIsBoundedAndInOrder) {
  Gate gate;
  std::vector<std::string> order;
  JobPool pool({.queue_length = 2}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    gate.pass(context.context(0, 1));
    order.push_back(job.result_id);  // one worker: no race
    return result_of(job);
  });
  const std::string running = pool.submit(asks(), "a").id;
  await_state(pool, running, JobState::running);
  const JobRecord next = pool.submit(asks(), "b");
  const JobRecord last = pool.submit(asks(), "c");
  EXPECT_EQ(next.queue_position, 0U);
  EXPECT_EQ(last.queue_position, 1U);
  EXPECT_FALSE(pool.status(running).queue_position);
  EXPECT_EQ(pool.load().queued, 2U);
  EXPECT_EQ(pool.load().running, 1U);
  EXPECT_EQ(error_of([&] { pool.submit(asks(), "d"); }), ErrorCode::busy);
  EXPECT_FALSE(error_of([&] { pool.submit(asks(), "c"); })) << "joining needs no place";
  EXPECT_EQ(pool.list("", 10).items.size(), 3U);
  gate.open();
  EXPECT_EQ(pool.wait(last.id, forever).state, JobState::succeeded);
  EXPECT_EQ(order, (std::vector<std::string>{"a", "b", "c"}));
}

// Another connection keeps the catalogue from storing the second job.
TEST_F(Jobs, NobodyWaitsForAnotherJobToBeStored) {
  const test::TemporaryFolder folder;
  Catalog slow(folder.path() / "catalog.sqlite");
  Gate gate;
  JobPool pool({}, slow, blobs, [&](const JobRecord& job, JobContext& context) {
    if (job.result_id == "b") gate.pass(context.context(0, 1));
    return result_of(job);
  });
  const std::string first = pool.submit(asks(), "a").id;
  pool.wait(first, forever);
  std::string second, same;
  {
    sqlite::Connection other(folder.path() / "catalog.sqlite", sqlite::Connection::Mode::write);
    other.run("BEGIN IMMEDIATE");
    std::jthread submits([&] { second = pool.submit(asks(), "b", "ann").id; });
    const auto late = std::chrono::steady_clock::now() + 4s;  // before the catalogue gives up
    while (pool.load().queued == 0 && std::chrono::steady_clock::now() < late) std::this_thread::yield();
    EXPECT_EQ(pool.load().queued, 1U);
    EXPECT_EQ(pool.status(first).state, JobState::succeeded);
    EXPECT_TRUE(pool.events(first, 0, 0ms).over);
    std::jthread joins([&] { same = pool.submit(asks(), "b", "ben").id; });
    other.run("ROLLBACK");
  }
  EXPECT_EQ(second, same);
  EXPECT_EQ(pool.status(second).requesters, (std::set<std::string>{"ann", "ben"}));
  gate.open();
  EXPECT_EQ(pool.wait(second, forever).state, JobState::succeeded);
}

TEST_F(Jobs, IdenticalRequestsShareOneJob) {
  Gate gate;
  std::atomic<int> runs{0};
  JobPool pool({.jobs_at_once = 2}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    ++runs;
    gate.pass(context.context(0, 1));
    return result_of(job);
  });
  const std::string id = pool.submit(asks(), "same", "ann").id;
  await_state(pool, id, JobState::running);
  const JobRecord joined = pool.submit(asks(), "same", "ben");
  const std::set<std::string> both{"ann", "ben"};
  EXPECT_EQ(joined.id, id);
  EXPECT_EQ(joined.requesters, both);
  EXPECT_EQ(catalog.find_job(id)->requesters, both);
  gate.open();
  EXPECT_EQ(pool.wait(id, forever).state, JobState::succeeded);
  EXPECT_EQ(runs, 1);
  // A request that comes too late to join finds the result made.
  const JobRecord late = pool.submit(asks(), "same");
  EXPECT_NE(late.id, id);
  EXPECT_EQ(pool.wait(late.id, forever).state, JobState::succeeded);
  EXPECT_EQ(runs, 1);
  EXPECT_EQ(blobs.keys().size(), 1U);
}

TEST_F(Jobs, CancellingDetachesAndStopsWithTheLast) {
  Gate gate;
  JobPool pool({}, catalog, blobs, behind(gate));
  const std::string id = pool.submit(asks(), "a", "ann").id;
  await_state(pool, id, JobState::running);
  pool.submit(asks(), "a", "ben");
  EXPECT_EQ(pool.cancel(id, "ann")->state, JobState::running);
  EXPECT_EQ(pool.status(id).requesters, std::set<std::string>{"ben"});
  EXPECT_EQ(pool.cancel(id, "ben")->state, JobState::cancelling);
  EXPECT_EQ(pool.wait(id, forever).state, JobState::cancelled);
  EXPECT_EQ(catalog.find_job(id)->state, JobState::cancelled);
  EXPECT_EQ(error_of([&] { pool.cancel(id, "ben"); }), ErrorCode::conflict);
  EXPECT_FALSE(catalog.find("a"));
  EXPECT_TRUE(blobs.keys().empty());
}

TEST_F(Jobs, AClientIsOneRequesterHoweverOftenItAsks) {
  Gate gate;
  JobPool pool({}, catalog, blobs, behind(gate));
  const auto ask = [&](const char* client) { return pool.submit(asks(), "a", client); };
  const std::string id = ask("ann").id;
  await_state(pool, id, JobState::running);
  for (int i = 0; i < 10; ++i) EXPECT_EQ(ask("ann").requesters.size(), 1U);
  EXPECT_EQ(ask("ben").requesters.size(), 2U);
  EXPECT_EQ(ask("ben").requesters.size(), 2U);
  EXPECT_EQ(pool.cancel(id, "ann")->requesters, std::set<std::string>{"ben"});
  EXPECT_FALSE(pool.cancel(id, "ann")) << "it wants nothing any more";
  EXPECT_EQ(ask("ann").requesters.size(), 2U) << "one that left may come back";
  pool.cancel(id, "ann");
  EXPECT_EQ(pool.cancel(id, "ben")->state, JobState::cancelling);
  EXPECT_EQ(pool.wait(id, forever).state, JobState::cancelled);
}

TEST_F(Jobs, OnlyRequestersCancel) {
  Gate gate;
  std::string running, queued;
  {
    JobPool pool({}, catalog, blobs, behind(gate));
    running = pool.submit(asks(), "a", "ann").id;
    pool.submit(asks(), "a", "ben");
    await_state(pool, running, JobState::running);
    queued = pool.submit(asks(), "b", "ann").id;
    for (const std::string& id : {running, queued}) {
      EXPECT_FALSE(pool.cancel(id, "eve"));
      EXPECT_FALSE(is_over(pool.status(id).state));
    }
  }
  // The next process knows who they were.
  JobPool pool({}, catalog, blobs, behind(gate));
  await_state(pool, running, JobState::running);
  EXPECT_FALSE(pool.cancel(running, "eve"));
  EXPECT_EQ(pool.cancel(running, "ben")->requesters, std::set<std::string>{"ann"});
  EXPECT_EQ(pool.cancel_for_all(running).state, JobState::cancelling);
  EXPECT_EQ(pool.cancel_for_all(queued).state, JobState::cancelled);
  EXPECT_EQ(error_of([&] { pool.cancel_for_all(queued); }), ErrorCode::conflict);
  EXPECT_EQ(error_of([&] { pool.cancel_for_all("job_none"); }), ErrorCode::not_found);
  EXPECT_EQ(pool.wait(running, forever).state, JobState::cancelled);
}

TEST_F(Jobs, AJobThatRunsTooLongFailsAndMakesRoom) {
  Gate never;
  JobPool pool({.longest_run = 30ms}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    if (job.result_id == "odd") {
      never.pass(context.context(0, 1));
    } else if (job.result_id == "endless") {
      std::condition_variable_any stopped;
      std::mutex mutex;
      std::unique_lock lock(mutex);
      stopped.wait(lock, context.context(0, 1).cancel, [] { return false; });
      throw std::runtime_error("libraries report an interruption in ways of their own");
    }
    return result_of(job);
  });
  for (const char* work : {"odd", "endless"}) {
    const JobRecord late = pool.wait(pool.submit(asks(), work).id, forever);
    EXPECT_EQ(late.state, JobState::failed);
    ASSERT_TRUE(late.error);
    EXPECT_EQ(late.error->code, ErrorCode::too_large);
    EXPECT_NE(late.error->sentence.find("after 1 s"), std::string::npos) << late.error->sentence;
    EXPECT_NE(late.error->sentence.find("max_job_s"), std::string::npos);
  }
  EXPECT_EQ(pool.wait(pool.submit(asks(), "quick").id, forever).state, JobState::succeeded);
  EXPECT_EQ(pool.load().running, 0U);
}

TEST_F(Jobs, WorkWithoutPurposeEndsWithTheReason) {
  Gate never, gate;
  JobPool pool({.jobs_at_once = 2}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    (asked(job) == "vol_1" ? never : gate).pass(context.context(0, 1));
    return result_of(job);
  });
  const std::string gone = pool.submit(asks("vol_1"), "a").id;
  const std::string other = pool.submit(asks("vol_2"), "b").id;
  await_state(pool, gone, JobState::running);
  await_state(pool, other, JobState::running);
  const std::string queued = pool.submit(asks("vol_1"), "c").id;
  const std::string last = pool.submit(asks("vol_2"), "d").id;
  JobState heard{};
  {
    std::jthread waiter([&] { heard = pool.wait(gone, forever).state; });
    pool.abandon([](const JobRecord& job) { return asked(job) == "vol_1"; },
                 {ErrorCode::conflict, "What it is made from was deleted."});
  }
  EXPECT_EQ(heard, JobState::failed);
  for (const std::string& id : {gone, queued}) {
    const JobRecord over = pool.wait(id, forever);
    EXPECT_EQ(over.state, JobState::failed);
    EXPECT_EQ(over.error->code, ErrorCode::conflict);
    EXPECT_EQ(catalog.find_job(id)->error->sentence, "What it is made from was deleted.");
  }
  gate.open();
  EXPECT_EQ(pool.wait(other, forever).state, JobState::succeeded);
  EXPECT_EQ(pool.wait(last, forever).state, JobState::succeeded);
}

TEST_F(Jobs, AQueuedJobIsCancelledAtOnce) {
  Gate gate;
  JobPool pool({.queue_length = 1}, catalog, blobs, behind(gate));
  const std::string running = pool.submit(asks(), "a").id;
  await_state(pool, running, JobState::running);
  const std::string waiting = pool.submit(asks(), "b").id;
  EXPECT_EQ(pool.cancel(waiting)->state, JobState::cancelled);
  EXPECT_EQ(pool.load().queued, 0U);
  EXPECT_EQ(pool.status(running).state, JobState::running);
  EXPECT_FALSE(error_of([&] { pool.submit(asks(), "b"); })) << "its place is free again";
  gate.open();
}

TEST_F(Jobs, ARequestAfterCancellingStartsAnew) {
  std::latch entered(1), stubborn(1);
  std::atomic<bool> first{true};
  JobPool pool({.jobs_at_once = 2}, catalog, blobs, [&](const JobRecord& job, JobContext&) {
    if (first.exchange(false)) {
      entered.count_down();
      stubborn.wait();  // does not look at the stop token
    }
    return result_of(job);
  });
  const std::string id = pool.submit(asks(), "a").id;
  entered.wait();
  EXPECT_EQ(pool.cancel(id)->state, JobState::cancelling);
  EXPECT_EQ(pool.cancel(id)->state, JobState::cancelling);
  const std::string again = pool.submit(asks(), "a").id;
  EXPECT_NE(again, id);
  EXPECT_EQ(pool.wait(again, forever).state, JobState::succeeded);
  stubborn.count_down();
  EXPECT_EQ(pool.wait(id, forever).state, JobState::cancelled) << "though it returned a result";
  pool.stop(forever);
  EXPECT_EQ(blobs.keys(), catalog.find("a")->blobs);
}

TEST_F(Jobs, ProgressNeverGoesBackAndHasBoundedEvents) {
  std::vector<double> seen;
  JobPool* pool_of_runner = nullptr;
  Gate ready;
  JobPool pool({.threads_per_job = 3}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    ready.pass();
    const Context first = context.context(0, 0.25), second = context.context(0.25, 1);
    EXPECT_EQ(first.threads, 3U);
    const auto report = [&](const Context& c, const char* stage, double fraction) {
      c.report(stage, fraction);
      seen.push_back(pool_of_runner->status(job.id).progress);
    };
    report(first, "boundary", 0.5);
    report(first, "boundary", 0.25);
    report(first, "boundary", std::nan(""));
    report(first, "boundary", 7);
    EXPECT_EQ(pool_of_runner->status(job.id).stage, "boundary");
    for (int i = 0; i <= 10'000; ++i) second.report("delaunay", i / 10'000.0 / 2);
    report(second, "delaunay", 0.5);
    EXPECT_TRUE(pool_of_runner->status(job.id).remaining_s);
    for (int i = 0; i < 1000; ++i) context.warn("Warning " + std::to_string(i) + ".");
    return result_of(job);
  });
  pool_of_runner = &pool;
  const std::string id = pool.submit(asks(), "a").id;
  ready.open();
  const JobRecord done = pool.wait(id, forever);
  EXPECT_EQ(seen, (std::vector<double>{0.125, 0.125, 0.125, 0.25, 0.625}));
  EXPECT_EQ(done.warnings.size(), 100U);
  EXPECT_EQ(done.warnings.at(7), "Warning 7.");
  EXPECT_EQ(done.stage, "delaunay");
  const JobEvents all = pool.events(id, 0, 0ms);
  EXPECT_TRUE(all.over);
  EXPECT_EQ(all.events.size(), 2U + 1U + 100U + 1U);  // queued, running; one of progress; warnings; end
}

TEST_F(Jobs, EventsCanBeFollowedAndResumed) {
  Gate gate;
  JobPool pool({}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    context.context(0, 1).report("boundary", 0.5);
    context.warn("Mind the gap.");
    gate.pass();
    return result_of(job);
  });
  const std::string id = pool.submit(asks(), "a").id;
  std::vector<JobEvent> followed;
  std::uint64_t last = 0;
  for (bool over = false; !over;) {
    const JobEvents news = pool.events(id, last, forever);
    ASSERT_FALSE(news.events.empty());
    for (const JobEvent& event : news.events) {
      EXPECT_GT(event.number, last);
      last = event.number;
      followed.push_back(event);
      if (event.type == JobEvent::Type::warning) gate.open();
    }
    over = news.over;
  }
  std::set<JobEvent::Type> types;
  for (const JobEvent& event : followed) types.insert(event.type);
  EXPECT_EQ(types.size(), 4U);
  EXPECT_EQ(followed.back().type, JobEvent::Type::end);
  EXPECT_EQ(followed.back().state, JobState::succeeded);
  const std::uint64_t before_end = followed[followed.size() - 2].number;
  ASSERT_EQ(pool.events(id, before_end, 0ms).events.size(), 1U);
  EXPECT_TRUE(pool.events(id, last, 0ms).events.empty());
  EXPECT_TRUE(pool.events(id, last, 0ms).over);
  // Another process knows the end under the same number.
  pool.stop(0ms);
  const JobPool next({}, catalog, blobs, at_once());
  const JobEvents resumed = next.events(id, before_end, 0ms);
  ASSERT_EQ(resumed.events.size(), 1U);
  EXPECT_EQ(resumed.events[0].number, last);
  EXPECT_TRUE(next.events(id, last, 0ms).over);
}

TEST_F(Jobs, WaitingEndsWithTheTime) {
  Gate gate;
  JobPool pool({}, catalog, blobs, behind(gate));
  const std::string id = pool.submit(asks(), "a").id;
  await_state(pool, id, JobState::running);
  EXPECT_EQ(pool.wait(id, 1ms).state, JobState::running);
  const std::uint64_t last = pool.events(id, 0, 0ms).events.back().number;
  const JobEvents none = pool.events(id, last, 1ms);
  EXPECT_TRUE(none.events.empty());
  EXPECT_FALSE(none.over);
  gate.open();
}

TEST_F(Jobs, StoppingKeepsUnfinishedJobsForTheNextStart) {
  Gate never, gate;
  std::string running, queued;
  {
    JobPool pool({}, catalog, blobs, behind(never));
    running = pool.submit(asks("A"), "a").id;
    await_state(pool, running, JobState::running);
    queued = pool.submit(asks("B"), "b").id;
    std::jthread waiter([&] { pool.wait(queued, forever); });  // is woken, or this test takes a minute
    pool.stop(0ms);
    EXPECT_EQ(error_of([&] { pool.submit(asks(), "c"); }), ErrorCode::busy);
    EXPECT_EQ(pool.status(running).state, JobState::queued);
  }
  EXPECT_EQ(catalog.find_job(running)->state, JobState::queued);
  EXPECT_EQ(catalog.find_job(queued)->state, JobState::queued);
  {
    JobPool pool({.queue_length = 1}, catalog, blobs, at_once());
    EXPECT_EQ(pool.wait(running, forever).state, JobState::succeeded);
    const JobRecord done = pool.wait(queued, forever);
    EXPECT_EQ(done.state, JobState::succeeded);
    EXPECT_EQ(done.attempts, 2U);
    EXPECT_EQ(done.crashes, 0U);
    EXPECT_GT(pool.events(queued, 0, 0ms).events.front().number, std::uint64_t{2} << 32);
  }
  EXPECT_EQ(catalog.find("b")->document, "B");
}

TEST_F(Jobs, StoppingLetsRunningJobsFinishWithinTheGrace) {
  Gate gate;
  JobPool pool({}, catalog, blobs, behind(gate));
  const std::string running = pool.submit(asks(), "a").id;
  await_state(pool, running, JobState::running);
  const std::string queued = pool.submit(asks(), "b").id;
  std::jthread opener([&] {
    pool.wait(running, forever);  // returns when the pool stops
    gate.open();
  });
  pool.stop(forever);
  EXPECT_EQ(pool.status(running).state, JobState::succeeded);
  EXPECT_EQ(pool.status(queued).state, JobState::queued);
}

TEST_F(Jobs, StreamsEndWhenThePoolStops) {
  Gate gate;
  JobPool pool({}, catalog, blobs, behind(gate));
  const std::string id = pool.submit(asks(), "a").id;
  await_state(pool, id, JobState::running);
  const std::uint64_t last = pool.events(id, 0, 0ms).events.back().number;
  EXPECT_FALSE(pool.events(id, last, 0ms).stopping);
  std::jthread stops([&] { pool.stop(forever); });
  while (!pool.load().stopping) std::this_thread::yield();
  const JobEvents none = pool.events(id, last, forever);
  EXPECT_TRUE(none.stopping) << "or whoever follows asks again and again";
  EXPECT_FALSE(none.over);
  gate.open();
  pool.wait(id, forever);
}

// A stage that does not hear a stop holds up neither the process nor its own next run.
TEST_F(Jobs, StoppingDoesNotWaitForTheDeaf) {
  std::latch entered(1), heard(1);
  JobPool pool({}, catalog, blobs, [&](const JobRecord& job, JobContext&) {
    entered.count_down();
    heard.wait();
    return result_of(job);
  });
  const std::string id = pool.submit(asks(), "a").id;
  entered.wait();
  const auto start = std::chrono::steady_clock::now();
  EXPECT_FALSE(pool.stop(0ms));
  EXPECT_GE(std::chrono::steady_clock::now() - start, 500ms) << "it had its chance";
  EXPECT_EQ(catalog.find_job(id)->state, JobState::queued) << "not its fault";
  heard.count_down();
}

// Everything that may be thrown at a worker, thrown.
TEST_F(Jobs, NothingThatIsThrownEndsTheProcess) {
  std::atomic<int> ends{0};
  JobPool pool(
      {}, catalog, blobs,
      [&](const JobRecord& job, JobContext&) -> Resource {
        if (asked(job) == "int") throw 7;
        if (asked(job) == "defect") SPHERULE_CHECK(false);
        if (asked(job) == "memory") throw std::bad_alloc();
        if (asked(job) == "other id") return {};
        return result_of(job);
      },
      [](const std::string&, const std::string&) { throw std::runtime_error("the log is full"); },
      [&](const JobRecord&) {
        ++ends;
        throw std::runtime_error("the log is full");
      });
  const std::vector<const char*> fates = {"int", "defect", "memory", "other id"};
  for (const char* fate : fates)
    EXPECT_EQ(pool.wait(pool.submit(asks(fate), fate).id, forever).state, JobState::failed) << fate;
  EXPECT_EQ(pool.wait(pool.submit(asks(), "good").id, forever).state, JobState::succeeded);
  EXPECT_EQ(ends, 5);
}

TEST_F(Jobs, TheSecondCrashIsTheLastAndBlamesNobodyElse) {
  leave("twice", JobState::running, 1);
  leave("once", JobState::running, 0);
  leave("beside", JobState::running, 0);
  leave("new", JobState::queued, 0);
  std::atomic<int> at_work{0}, most_with_suspects{0};
  const JobPool pool({.jobs_at_once = 4}, catalog, blobs, [&](const JobRecord& job, JobContext&) {
    const int now_at_work = ++at_work;
    if (job.crashes > 0) most_with_suspects = std::max(most_with_suspects.load(), now_at_work);
    for (int i = 0; i < 1000; ++i) std::this_thread::yield();
    if (job.crashes > 0) most_with_suspects = std::max(most_with_suspects.load(), at_work.load());
    --at_work;
    return result_of(job);
  });
  const JobRecord failed = pool.status("twice");
  EXPECT_EQ(failed.state, JobState::failed);
  EXPECT_NE(failed.error->sentence.find(" 2 times"), std::string::npos) << failed.error->sentence;
  for (const char* id : {"once", "beside", "new"}) EXPECT_EQ(pool.wait(id, forever).state, JobState::succeeded) << id;
  EXPECT_EQ(most_with_suspects, 1) << "what may have ended the process runs alone";
}

TEST_F(Jobs, TakesUpWhatACrashLeft) {
  leave("queued", JobState::queued, 2);
  leave("running", JobState::running, 1);
  leave("deadly", JobState::running, 2);
  leave("cancelling", JobState::cancelling, 0);
  const JobPool pool({.crash_limit = 3}, catalog, blobs, at_once());
  EXPECT_EQ(pool.wait("queued", forever).state, JobState::succeeded);
  const JobRecord again = pool.wait("running", forever);
  EXPECT_EQ(again.state, JobState::succeeded);
  EXPECT_EQ(again.crashes, 2U);
  EXPECT_EQ(pool.status("deadly").state, JobState::failed);
  EXPECT_EQ(pool.status("deadly").error->code, ErrorCode::unusable);
  EXPECT_EQ(pool.status("cancelling").state, JobState::cancelled);
  EXPECT_FALSE(catalog.find("mdl_deadly") || catalog.find("mdl_cancelling"));
}

TEST_F(Jobs, AnInputDeletedMeanwhileFailsTheJobAndItsBlobsGo) {
  Resource volume;
  volume.id = "vol_1";
  volume.collection = "volumes";
  catalog.add(volume);
  JobPool pool({}, catalog, blobs, [&](const JobRecord& job, JobContext&) {
    Resource result = result_of(job);
    result.inputs = {"vol_1"};
    (void)catalog.erase("vol_1");
    return result;
  });
  const JobRecord over = pool.wait(pool.submit(asks(), "a").id, forever);
  EXPECT_EQ(over.state, JobState::failed);
  EXPECT_EQ(over.error->code, ErrorCode::conflict);
  pool.stop(forever);
  EXPECT_TRUE(blobs.keys().empty());
}

TEST_F(Jobs, AFullStoreFailsTheJob) {
  test::FaultyBlobStore faulty(blobs);
  faulty.fail_append(1);
  JobPool pool({}, catalog, faulty, [&](const JobRecord& job, JobContext&) {
    Resource result;
    result.id = job.result_id;
    result.blobs = {faulty.put("models/x", "bytes")};
    return result;
  });
  const JobRecord over = pool.wait(pool.submit(asks(), "a").id, forever);
  EXPECT_EQ(over.error->code, ErrorCode::no_space);
}

// The catalogue can store neither the result nor the failure: this process says so, and the next one tries again.
TEST(JobsOnAFullDisk, FailNowAndRunAgainLater) {
  test::on_a_small_disk([](const std::filesystem::path& disk) -> std::string {
    Catalog catalog(disk / "catalog.sqlite");
    FileBlobStore blobs(disk / "blobs");
    bool full = true;
    const JobRunner runner = [&](const JobRecord& job, JobContext&) {
      if (full) test::fill_disk(disk / "filler");
      Resource result;
      result.id = job.result_id;
      result.document = std::string(100'000, 'd');
      return result;
    };
    std::string id;
    {
      JobPool pool({}, catalog, blobs, runner);
      id = pool.submit(asks(), "a").id;
      const JobRecord failed = pool.wait(id, forever);
      if (failed.state != JobState::failed || failed.error->code != ErrorCode::no_space)
        return "the job did not fail for lack of space";
      if (error_of([&] { pool.submit(asks(std::string(100'000, 'r')), "b"); }) != ErrorCode::no_space)
        return "a job was accepted that could not be stored";
    }
    if (catalog.find("a")) return "half a result";
    const bool failure_stored = is_over(catalog.find_job(id)->state);
    full = false;
    std::filesystem::remove(disk / "filler");
    const JobPool pool({}, catalog, blobs, runner);
    const JobState fate = pool.wait(id, forever).state;
    if (fate != (failure_stored ? JobState::failed : JobState::succeeded)) return "the job was not run again";
    return "";
  });
}

TEST_F(Jobs, OldFinishedJobsAreReadFromTheCatalogue) {
  JobPool pool({.queue_length = 1000}, catalog, blobs, at_once());
  std::vector<std::string> all;
  for (int i = 0; i < 400; ++i) all.push_back(pool.submit(asks(), "m" + std::to_string(i)).id);
  pool.wait(all.back(), forever);
  for (const std::string& id : all) EXPECT_EQ(pool.status(id).state, JobState::succeeded);
  EXPECT_EQ(pool.events(all.front(), 0, 0ms).events.size(), 1U);
  EXPECT_EQ(error_of([&] { pool.cancel(all.front()); }), ErrorCode::conflict);
  std::size_t listed = 0;
  for (std::string cursor;;) {
    const Page<JobRecord> page = pool.list(cursor, 7);
    listed += page.items.size();
    if (page.next.empty()) break;
    cursor = page.next;
  }
  EXPECT_EQ(listed, 400U);
}

// Requesters that come, join, cancel, wait and watch at random: every job ends, a result is there exactly when some
// job for it succeeded, and no blob is left over.
TEST_F(Jobs, SurviveManyImpatientRequesters) {
  JobPool pool({.jobs_at_once = 3, .queue_length = 8}, catalog, blobs, [&](const JobRecord& job, JobContext& context) {
    const Context stage = context.context(0, 1);
    for (int i = 0; i < 20; ++i) {
      stage.throw_if_cancelled();
      stage.report("stage", i / 20.0);
      std::this_thread::yield();
    }
    return result_of(job);
  });
  std::mutex mutex;
  std::set<std::string> accepted;
  {
    std::vector<std::jthread> requesters;
    for (unsigned seed = 0; seed < 4; ++seed)
      requesters.emplace_back([&, seed] {
        std::mt19937 random(seed);
        for (int i = 0; i < 150; ++i) {
          try {
            const std::string id = pool.submit(asks(), "m" + std::to_string(random() % 40)).id;
            {
              const std::lock_guard lock(mutex);
              accepted.insert(id);
            }
            if (random() % 2) pool.cancel(id);
            if (random() % 4 == 0) pool.wait(id, 1ms);
            if (random() % 4 == 0) (void)pool.events(id, 0, 1ms);
            if (random() % 8 == 0) (void)pool.list("", 5);
          } catch (const Error& error) {
            EXPECT_TRUE(error.code() == ErrorCode::busy || error.code() == ErrorCode::conflict) << error.what();
          }
        }
      });
  }
  std::set<std::string> made;
  for (const std::string& id : accepted) {
    const JobRecord over = pool.wait(id, forever);
    EXPECT_TRUE(over.state == JobState::succeeded || over.state == JobState::cancelled);
    if (over.state == JobState::succeeded) made.insert(over.result_id);
  }
  pool.stop(forever);
  EXPECT_EQ(catalog.list("models", "", 1000).items.size(), made.size());
  EXPECT_EQ(blobs.keys().size(), made.size());
}

}  // namespace
}  // namespace spherule::server
