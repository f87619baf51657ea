// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/retention.h"

#include <gtest/gtest.h>

#include <set>

#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;

class Retention : public testing::Test {
 protected:
  test::ScratchCatalog catalog;
  test::MemoryBlobStore blobs;

  void add(const std::string& id, const std::string& collection, const std::vector<std::string>& inputs = {}) {
    Resource resource;
    resource.id = id;
    resource.collection = collection;
    resource.inputs = inputs;
    resource.blobs = {blobs.put("x", id)};
    publish(catalog, blobs, resource);
  }
  std::set<std::string> expire_at(Time time, const std::vector<Keeping>& keeping) {
    std::set<std::string> gone;
    expire(catalog, keeping, time, [&](const std::string& id) {
      withdraw(catalog, blobs, id);
      gone.insert(id);
    });
    return gone;
  }
};

TEST_F(Retention, IsOffByDefault) {
  add("vol_1", "volumes");
  EXPECT_TRUE(expire_at(now() + 24h * 36500, {{"volumes", 0s}}).empty());
  EXPECT_TRUE(catalog.find("vol_1"));
}

TEST_F(Retention, DeletesWhatIsOverItsTimeWithItsBlobs) {
  add("vol_1", "volumes");
  add("mdl_1", "models", {"vol_1"});
  add("ans_1", "answers", {"mdl_1"});
  const std::vector<Keeping> keeping = {{"answers", 1h}, {"models", 10h}, {"volumes", 0s}};
  const Time start = now();
  EXPECT_TRUE(expire_at(start + 59min, keeping).empty());
  EXPECT_EQ(expire_at(start + 61min, keeping), std::set<std::string>{"ans_1"});
  EXPECT_EQ(blobs.keys().size(), 2U);
  EXPECT_EQ(expire_at(start + 11h, keeping), std::set<std::string>{"mdl_1"});
  EXPECT_TRUE(expire_at(start + 10000h, keeping).empty());
  EXPECT_TRUE(catalog.find("vol_1"));
}

TEST_F(Retention, UsingSomethingUsesWhatItWasMadeFrom) {
  add("vol_1", "volumes");
  add("vol_2", "volumes");
  add("mdl_1", "models", {"vol_1"});
  add("mdl_2", "models", {"vol_1"});
  const Time before = catalog.find("vol_2")->used;
  ASSERT_GE(now(), before);
  while (now() == before) {
  }
  catalog.touch("mdl_1");
  catalog.touch("nothing");
  EXPECT_GT(catalog.find("vol_1")->used, before);
  EXPECT_GT(catalog.find("mdl_1")->used, catalog.find("mdl_2")->used);
  EXPECT_EQ(catalog.find("vol_2")->used, before);
  EXPECT_EQ(expire_at(catalog.find("mdl_1")->used + 1h, {{"volumes", 1h}}), std::set<std::string>{"vol_2"});
}

TEST_F(Retention, MakingSomethingUsesWhatItIsMadeFrom) {
  add("vol_1", "volumes");
  const Time before = catalog.find("vol_1")->used;
  while (now() == before) {
  }
  add("mdl_1", "models", {"vol_1"});
  EXPECT_GT(catalog.find("vol_1")->used, before);
}

TEST_F(Retention, WhatGoesTakesAlongWhatIsMadeFromIt) {
  add("vol_1", "volumes");
  for (int i = 0; i < 250; ++i) add("mdl_" + std::to_string(i), "models", {"vol_1"});
  EXPECT_EQ(expire_at(now() + 2h, {{"volumes", 1h}, {"models", 1h}}), std::set<std::string>{"vol_1"});
  EXPECT_TRUE(blobs.keys().empty());
}

TEST_F(Retention, OldJobsAreForgottenUnlessTheyAreNotOver) {
  JobRecord job;
  for (const char* id : {"job_over", "job_queued"}) {
    job.id = id;
    job.created = now();
    catalog.add_job(job);
  }
  job.id = "job_over";
  job.state = JobState::succeeded;
  job.finished = now();
  job.warnings = {"Its warnings go, too."};
  catalog.update_job(job);
  EXPECT_EQ(catalog.forget_jobs(*job.finished), 0U);
  EXPECT_EQ(catalog.forget_jobs(*job.finished + 1s), 1U);
  EXPECT_FALSE(catalog.find_job("job_over"));
  EXPECT_TRUE(catalog.find_job("job_queued"));
}

}  // namespace
}  // namespace spherule::server
