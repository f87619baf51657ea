// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/places.h"

#include <gtest/gtest.h>

#include <thread>
#include <vector>

namespace spherule::server {
namespace {

// All that one client gets.
std::vector<std::unique_ptr<Places::Place>> greedy(Places& places, const std::string& client) {
  std::vector<std::unique_ptr<Places::Place>> got;
  while (auto place = places.take(client)) got.push_back(std::move(place));
  return got;
}

TEST(Places, NobodyTakesAll) {
  Places places(64);
  const auto first = greedy(places, "ann"), second = greedy(places, "ben"), third = greedy(places, "eve");
  EXPECT_EQ(first.size(), 32U);
  EXPECT_EQ(second.size(), 16U);
  EXPECT_EQ(third.size(), 8U);
  EXPECT_TRUE(places.take("dan")) << "whoever has none finds one";
  EXPECT_FALSE(places.take("ann"));
}

TEST(Places, ComeBack) {
  Places places(2);
  {
    const auto one = places.take("ann");
    EXPECT_TRUE(one);
    EXPECT_FALSE(places.take("ann"));
  }
  EXPECT_EQ(greedy(places, "ben").size(), 1U);
  EXPECT_EQ(greedy(places, "ann").size(), 1U);
  EXPECT_FALSE(Places(0).take("ann"));
}

TEST(Places, AreCountedByManyThreads) {
  Places places(8);
  {
    std::vector<std::jthread> threads;
    for (int t = 0; t < 4; ++t)
      threads.emplace_back([&, client = std::to_string(t % 2)] {
        for (int i = 0; i < 1000; ++i) static_cast<void>(greedy(places, client));
      });
  }
  EXPECT_EQ(greedy(places, "last").size(), 4U);
}

}  // namespace
}  // namespace spherule::server
