// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/cache.h"

#include <gtest/gtest.h>

#include <atomic>
#include <random>
#include <stdexcept>
#include <thread>
#include <vector>

namespace spherule::server {
namespace {

using IntCache = Cache<int>;

auto loads(int value, std::size_t bytes) {
  return [=] { return IntCache::Loaded{std::make_shared<const int>(value), bytes}; };
}

auto must_not_load() {
  return []() -> IntCache::Loaded { throw std::logic_error("loaded"); };
}

TEST(Cache, KeepsWithinTheBudgetAndDropsTheLeastRecentlyUsed) {
  IntCache cache(100);
  EXPECT_EQ(*cache.get_or_load("a", loads(1, 40)), 1);
  EXPECT_EQ(*cache.get_or_load("b", loads(2, 40)), 2);
  EXPECT_EQ(*cache.get_or_load("a", must_not_load()), 1);  // now b is the older one
  EXPECT_EQ(*cache.get_or_load("c", loads(3, 40)), 3);
  EXPECT_EQ(cache.stats().bytes, 80U);
  EXPECT_EQ(*cache.get_or_load("a", must_not_load()), 1);
  EXPECT_EQ(*cache.get_or_load("b", loads(4, 20)), 4);
  EXPECT_EQ(cache.stats().entries, 3U);
  EXPECT_EQ(cache.stats().bytes, 100U);
  EXPECT_EQ(cache.stats().hits, 2U);
  EXPECT_EQ(cache.stats().misses, 4U);
}

TEST(Cache, ReturnsButDoesNotKeepWhatIsLargerThanTheBudget) {
  IntCache cache(100);
  cache.get_or_load("small", loads(1, 100));
  EXPECT_EQ(*cache.get_or_load("large", loads(2, 101)), 2);
  EXPECT_EQ(cache.stats().entries, 1U);
  EXPECT_EQ(*cache.get_or_load("small", must_not_load()), 1);
  IntCache none(0);
  EXPECT_EQ(*none.get_or_load("a", loads(1, 1)), 1);
  EXPECT_EQ(none.stats().entries, 0U);
}

TEST(Cache, EvictedValuesLiveWhileHeld) {
  IntCache cache(10);
  const auto held = cache.get_or_load("a", loads(7, 10));
  cache.get_or_load("b", loads(8, 10));
  EXPECT_EQ(cache.stats().entries, 1U);
  EXPECT_EQ(*held, 7);
}

TEST(Cache, LoadsAMissingKeyOnceForAllThreads) {
  constexpr int threads = 8;
  IntCache cache(100);
  std::atomic<int> loaded{0};
  std::atomic<int> wrong{0};
  {
    std::vector<std::jthread> askers;
    for (int i = 0; i < threads; ++i)
      askers.emplace_back([&] {
        const auto value = cache.get_or_load("k", [&] {
          ++loaded;
          // All others have missed or joined before this load ends: one miss and seven hits so far.
          while (cache.stats().hits < threads - 1) std::this_thread::yield();
          return IntCache::Loaded{std::make_shared<const int>(5), 1};
        });
        if (*value != 5) ++wrong;
      });
  }
  EXPECT_EQ(loaded, 1);
  EXPECT_EQ(wrong, 0);
}

TEST(Cache, AFailedLoadFailsAllWaitersAndIsForgotten) {
  constexpr int threads = 4;
  IntCache cache(100);
  std::atomic<int> failed{0};
  {
    std::vector<std::jthread> askers;
    for (int i = 0; i < threads; ++i)
      askers.emplace_back([&] {
        try {
          cache.get_or_load("k", [&]() -> IntCache::Loaded {
            while (cache.stats().hits < threads - 1) std::this_thread::yield();
            throw std::runtime_error("disk");
          });
        } catch (const std::runtime_error&) {
          ++failed;
        }
      });
  }
  EXPECT_EQ(failed, threads);
  EXPECT_EQ(*cache.get_or_load("k", loads(1, 1)), 1);
}

TEST(Cache, ErasingDuringALoadDeliversButDoesNotKeep) {
  IntCache cache(100);
  const auto value = cache.get_or_load("k", [&] {
    cache.erase("k");
    return loads(1, 1)();
  });
  EXPECT_EQ(*value, 1);
  EXPECT_EQ(cache.stats().entries, 0U);
  EXPECT_EQ(*cache.get_or_load("k", loads(2, 1)), 2);
  cache.erase("k");
  cache.erase("never there");
  EXPECT_EQ(cache.stats().bytes, 0U);
}

TEST(Cache, AgreesWithItselfUnderManyThreads) {
  IntCache cache(50);
  std::atomic<int> wrong{0};
  {
    std::vector<std::jthread> askers;
    for (unsigned seed = 0; seed < 4; ++seed)
      askers.emplace_back([&, seed] {
        std::mt19937 random(seed);
        for (int i = 0; i < 5000; ++i) {
          const int key = static_cast<int>(random() % 20);
          if (i % 50 == 0) cache.erase(std::to_string(key));
          if (*cache.get_or_load(std::to_string(key), loads(key, static_cast<std::size_t>(key))) != key) ++wrong;
          if (cache.stats().bytes > 50) ++wrong;
        }
      });
  }
  EXPECT_EQ(wrong, 0);
}

}  // namespace
}  // namespace spherule::server
