// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every stage hears a cancellation at once, and its progress never goes back.
#include <gtest/gtest.h>
#include <pthread.h>

#include <atomic>
#include <chrono>
#include <cstdlib>
#include <ctime>
#include <map>
#include <string>
#include <thread>

#include "tests/core/stages.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

double seconds(clockid_t clock) {
  timespec time{};
  clock_gettime(clock, &time);
  return static_cast<double>(time.tv_sec) + 1e-9 * static_cast<double>(time.tv_nsec);
}

clockid_t own_clock() {
  clockid_t clock{};
  pthread_getcpuclockid(pthread_self(), &clock);
  return clock;
}

// How long the stage goes on after a stop that is asked for when it has run for `after` seconds; 0 when it ends first.
// In processor time of its one thread, so that a busy machine changes nothing.
double goes_on(const stages::Stage& stage, double after) {
  const clockid_t clock = own_clock();
  const double begin = seconds(clock);
  std::stop_source stop;
  std::atomic<bool> ended{false};
  std::atomic<double> asked{begin};
  std::jthread asking([&] {
    while (!ended && seconds(clock) - begin < after) std::this_thread::sleep_for(std::chrono::microseconds(100));
    asked = seconds(clock);
    stop.request_stop();
  });
  bool cancelled = false;
  try {
    stage.run({.threads = 1, .cancel = stop.get_token(), .progress = {}});
  } catch (const Error& e) {
    cancelled = e.code() == ErrorCode::cancelled;
    EXPECT_TRUE(cancelled) << stage.name << ": " << e.what();
  }
  const double end = seconds(clock);
  ended = true;
  asking.join();
  return cancelled ? end - asked : 0;
}

bool is_full() {
  const char* form = std::getenv("SPHERULE_FAULTS");
  return form != nullptr && std::string(form) == "full";
}

TEST(Cancel, IsHeardByEveryStageWithinATenthOfASecond) {
  phantoms::Random random(5);
  const int moments = is_full() ? 6 : 1;
  double longest = 0;
  for (const stages::Stage& stage : stages::all(is_full() ? 64 : 16)) {
    const double begin = seconds(own_clock());
    stage.run({});
    const double takes = seconds(own_clock()) - begin;
    // Less cannot go on for longer than it may.
    if (takes < 0.1) continue;
    for (int m = 0; m < moments; ++m) {
      const double after = takes * (m + random.unit()) / moments, more = goes_on(stage, after);
      EXPECT_LE(more, 0.1) << stage.name << " after " << after << " of " << takes << " s";
      longest = std::max(longest, more);
    }
  }
  RecordProperty("longest_ms", static_cast<int>(1000 * longest));
}

TEST(Progress, OfNoStageGoesBackAndNoStageComesBack) {
  for (const stages::Stage& stage : stages::all(12)) {
    std::map<std::string, double, std::less<>> reported;
    std::string last;
    const auto check = [&](std::string_view name, double fraction) {
      EXPECT_FALSE(name.empty());
      EXPECT_TRUE(fraction >= 0 && fraction <= 1) << stage.name << ": " << name << " " << fraction;
      const auto before = reported.find(name);
      if (before != reported.end()) {
        EXPECT_EQ(last, name) << stage.name << ": comes back";
        EXPECT_LE(before->second, fraction) << stage.name << ": " << name;
      }
      last = name;
      reported[last] = fraction;
    };
    stage.run({.threads = 2, .cancel = {}, .progress = check});
  }
}

}  // namespace
}  // namespace spherule
