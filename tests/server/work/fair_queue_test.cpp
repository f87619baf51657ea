// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/fair_queue.h"

#include <gtest/gtest.h>

#include <random>
#include <vector>

namespace spherule::server {
namespace {

std::string drain(FairQueue<std::string> queue) {
  std::string order;
  while (!queue.empty()) order += (order.empty() ? "" : " ") + queue.pop();
  return order;
}

TEST(FairQueue, ServesClientsInTurn) {
  FairQueue<std::string> queue;
  for (const char* item : {"a1", "a2", "a3", "a4", "b1", "c1", "b2"}) queue.push({item[0]}, item);
  EXPECT_EQ(queue.size(), 7U);
  EXPECT_EQ(queue.size_of("a"), 4U);
  EXPECT_EQ(queue.size_of("d"), 0U);
  EXPECT_EQ(drain(queue), "a1 b1 c1 a2 b2 a3 a4");
}

TEST(FairQueue, OneClientIsFirstComeFirstServed) {
  FairQueue<std::string> queue;
  for (const char* item : {"1", "2", "3"}) queue.push("", item);
  EXPECT_EQ(drain(queue), "1 2 3");
}

TEST(FairQueue, PushingNeverChangesWhoIsNext) {
  FairQueue<std::string> queue;
  queue.push("a", "a1");
  queue.push("a", "a2");
  EXPECT_EQ(queue.pop(), "a1");
  queue.push("b", "b1");
  EXPECT_EQ(queue.front(), "a2");
}

TEST(FairQueue, ATurnThatIsGivenBackIsTheNext) {
  FairQueue<std::string> queue;
  for (const char* item : {"a1", "a2", "b1", "b2"}) queue.push({item[0]}, item);
  EXPECT_EQ(queue.pop(), "a1");
  queue.push_front("a", "a1");
  queue.push_front("c", "c1");
  EXPECT_EQ(queue.size(), 5U);
  EXPECT_EQ(queue.place_of("a1"), 1U);
  EXPECT_EQ(drain(queue), "c1 a1 b1 a2 b2");
}

TEST(FairQueue, Erases) {
  FairQueue<std::string> queue;
  for (const char* item : {"a1", "b1", "a2"}) queue.push({item[0]}, item);
  queue.erase("b1");
  queue.erase("b1");
  queue.erase("a1");
  EXPECT_EQ(queue.size(), 1U);
  EXPECT_EQ(drain(queue), "a2");
}

TEST(FairQueue, PlacesAreWhatPoppingFinds) {
  std::mt19937 random(7);
  for (int trial = 0; trial < 200; ++trial) {
    FairQueue<int> queue;
    int next = 0;
    for (int i = 0; i < 30; ++i) {
      if (random() % 4 == 0 && !queue.empty())
        queue.pop();
      else
        queue.push(std::to_string(random() % 4), next++);
    }
    std::vector<std::size_t> place(static_cast<std::size_t>(next));
    for (int item = 0; item < next; ++item) place[static_cast<std::size_t>(item)] = queue.place_of(item);
    EXPECT_EQ(queue.place_of(-1), queue.size());
    for (std::size_t popped = 0; !queue.empty(); ++popped)
      EXPECT_EQ(place[static_cast<std::size_t>(queue.pop())], popped);
  }
}

}  // namespace
}  // namespace spherule::server
