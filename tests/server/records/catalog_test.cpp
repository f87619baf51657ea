// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/catalog.h"

#include <gtest/gtest.h>
#include <sqlite3.h>
#include <sys/stat.h>

#include <algorithm>
#include <fstream>
#include <future>
#include <limits>
#include <thread>

#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

namespace fs = std::filesystem;
using test::asked;
using test::asks;
using test::error_of;

Resource resource(const std::string& id, const std::string& collection = "models",
                  const std::vector<std::string>& inputs = {}, const std::vector<std::string>& blobs = {}) {
  Resource r;
  r.id = id;
  r.collection = collection;
  r.request = "request of " + id;
  r.document = std::string("document\0of ", 12) + id;
  r.inputs = inputs;
  r.blobs = blobs;
  r.bytes = 17;
  return r;
}

JobRecord job(const std::string& id) {
  JobRecord j;
  j.id = id;
  j.kind = "model";
  j.result_id = "result of " + id;
  j.request = asks("request of " + id);
  j.created = now();
  return j;
}

std::vector<std::string> ids(const auto& items) {
  std::vector<std::string> all;
  for (const auto& item : items) all.push_back(item.id);
  return all;
}

TEST(Catalog, KeepsResourcesOverAReopening) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "new" / "catalog.sqlite";
  const Time before = now();
  {
    Catalog catalog(file);
    EXPECT_TRUE(catalog.add(resource("vol_1", "volumes", {}, {"k1", "k0"})));
    EXPECT_TRUE(catalog.add(resource("mdl_1", "models", {"vol_1"}, {"k2"})));
    EXPECT_FALSE(catalog.add(resource("mdl_1", "models", {}, {"other"})));
  }
  const Catalog catalog(file);
  const auto volume = catalog.find("vol_1");
  const auto model = catalog.find("mdl_1");
  ASSERT_TRUE(volume && model);
  EXPECT_EQ(volume->collection, "volumes");
  EXPECT_EQ(volume->document, std::string("document\0of vol_1", 17));
  EXPECT_EQ(volume->request, "request of vol_1");
  EXPECT_EQ(volume->blobs, (std::vector<std::string>{"k1", "k0"}));
  EXPECT_EQ(volume->bytes, 17U);
  EXPECT_GE(volume->created, before);
  EXPECT_LE(volume->created, now());
  EXPECT_EQ(model->inputs, std::vector<std::string>{"vol_1"});
  EXPECT_EQ(model->blobs, std::vector<std::string>{"k2"});
  EXPECT_TRUE(catalog.owns_blob("k2"));
  EXPECT_FALSE(catalog.owns_blob("other"));
  EXPECT_FALSE(catalog.find("mdl_2"));
}

TEST(Catalog, ReadsDoNotWaitForWrites) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "catalog.sqlite";
  Catalog catalog(file);
  catalog.add(resource("vol_1", "volumes"));
  sqlite3* other = nullptr;
  ASSERT_EQ(sqlite3_open(file.c_str(), &other), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(other, "BEGIN IMMEDIATE", nullptr, nullptr, nullptr), SQLITE_OK);
  auto added = std::async(std::launch::async, [&] { return catalog.add(resource("vol_2", "volumes")); });
  // The write gives up after seconds: it must not have when all these are done.
  for (int i = 0; i < 1000; ++i) {
    EXPECT_TRUE(catalog.find("vol_1"));
    EXPECT_FALSE(catalog.find("vol_2"));
    EXPECT_EQ(catalog.list("volumes", "", 5).items.size(), 1U);
  }
  EXPECT_EQ(added.wait_for(std::chrono::seconds(0)), std::future_status::timeout);
  ASSERT_EQ(sqlite3_exec(other, "ROLLBACK", nullptr, nullptr, nullptr), SQLITE_OK);
  sqlite3_close(other);
  EXPECT_TRUE(added.get());
  EXPECT_TRUE(catalog.find("vol_2"));
}

TEST(Catalog, EveryThreadReadsWhatItHasWritten) {
  test::ScratchCatalog catalog;
  std::vector<std::thread> threads;
  for (int t = 0; t < 8; ++t) {
    threads.emplace_back([&catalog, t] {
      for (int i = 0; i < 50; ++i) {
        const std::string id = std::to_string(t) + "-" + std::to_string(i);
        EXPECT_TRUE(catalog.add(resource(id, id, {}, {"blob of " + id})));
        const auto found = catalog.find(id);
        ASSERT_TRUE(found) << id;
        EXPECT_EQ(found->blobs, std::vector{"blob of " + id});
        EXPECT_EQ(catalog.list(id, "", 2).items.size(), 1U);
        if (i % 2 == 0) {
          EXPECT_EQ(catalog.erase(id), std::vector{"blob of " + id});
        }
        EXPECT_EQ(catalog.find(id).has_value(), i % 2 == 1);
      }
    });
  }
  for (std::thread& thread : threads) thread.join();
}

TEST(Catalog, TextIsNeverRead) {
  test::ScratchCatalog catalog;
  const std::string hostile = "'); DROP TABLE resources; -- \" \xff\xfe % _ \n";
  EXPECT_TRUE(catalog.add(resource(hostile, hostile, {}, {hostile})));
  EXPECT_EQ(catalog.find(hostile)->blobs, std::vector{hostile});
  EXPECT_EQ(catalog.list(hostile, "", 5).items.size(), 1U);
  EXPECT_EQ(catalog.list("models", "", 5).items.size(), 0U);
}

TEST(Catalog, RefusesResourcesWhoseInputsAreGone) {
  test::ScratchCatalog catalog;
  EXPECT_EQ(error_of([&] { catalog.add(resource("mdl_1", "models", {"vol_1"})); }), ErrorCode::conflict);
  EXPECT_FALSE(catalog.find("mdl_1"));
}

TEST(Catalog, ErasingTakesEverythingDerivedAlong) {
  test::ScratchCatalog catalog;
  catalog.add(resource("vol_1", "volumes", {}, {"v1"}));
  catalog.add(resource("vol_2", "volumes", {}, {"v2"}));
  catalog.add(resource("mdl_1", "models", {"vol_1"}, {"m1"}));
  catalog.add(resource("mdl_2", "models", {"vol_2"}, {"m2"}));
  catalog.add(resource("simple", "models", {"mdl_1"}, {"s1"}));
  catalog.add(resource("registration", "registrations", {"simple", "mdl_2", "mdl_1"}, {"r1"}));
  std::vector<std::string> keys = catalog.erase("vol_1");
  std::sort(keys.begin(), keys.end());
  EXPECT_EQ(keys, (std::vector<std::string>{"m1", "r1", "s1", "v1"}));
  for (const char* gone : {"vol_1", "mdl_1", "simple", "registration"}) EXPECT_FALSE(catalog.find(gone)) << gone;
  for (const char* kept : {"vol_2", "mdl_2"}) EXPECT_TRUE(catalog.find(kept)) << kept;
  EXPECT_FALSE(catalog.owns_blob("r1"));
  EXPECT_EQ(error_of([&] { (void)catalog.erase("vol_1"); }), ErrorCode::not_found);
  EXPECT_TRUE(catalog.add(resource("vol_1", "volumes", {}, {"v1"})));
}

TEST(Catalog, PagesAreStableWhileRowsComeAndGo) {
  test::ScratchCatalog catalog;
  for (int i = 0; i < 10; ++i) catalog.add(resource("m" + std::to_string(i)));
  catalog.add(resource("v", "volumes"));
  const auto first = catalog.list("models", "", 4);
  EXPECT_EQ(ids(first.items), (std::vector<std::string>{"m9", "m8", "m7", "m6"}));
  catalog.add(resource("newer"));
  (void)catalog.erase("m6");
  (void)catalog.erase("m4");
  const auto second = catalog.list("models", first.next, 4);
  EXPECT_EQ(ids(second.items), (std::vector<std::string>{"m5", "m3", "m2", "m1"}));
  const auto third = catalog.list("models", second.next, 4);
  EXPECT_EQ(ids(third.items), std::vector<std::string>{"m0"});
  EXPECT_EQ(third.next, "");
  EXPECT_EQ(catalog.list("models", second.next, 1).next, "");
  EXPECT_EQ(catalog.list("models", "", 9).next, "");
  EXPECT_EQ(catalog.list("models", "", 0).items.size(), 1U);
  EXPECT_EQ(catalog.list("models", "", std::numeric_limits<std::size_t>::max()).items.size(), 9U);
}

TEST(Catalog, RefusesForeignCursors) {
  const test::ScratchCatalog catalog;
  for (const char* cursor : {"x", "0", "-3", "1x", " 1", "99999999999999999999", "1;"}) {
    EXPECT_EQ(error_of([&] { (void)catalog.list("models", cursor, 5); }), ErrorCode::invalid_argument) << cursor;
    EXPECT_EQ(error_of([&] { (void)catalog.list_jobs(cursor, 5); }), ErrorCode::invalid_argument) << cursor;
  }
}

TEST(Catalog, KeepsAllOfAJob) {
  const test::TemporaryFolder folder;
  JobRecord full = job("job_1");
  {
    Catalog catalog(folder.path() / "c");
    catalog.add_job(full);
    const auto queued = catalog.find_job("job_1");
    ASSERT_TRUE(queued);
    EXPECT_FALSE(queued->started || queued->finished || queued->error);
    EXPECT_EQ(queued->created, full.created);
    full.state = JobState::failed;
    full.stage = "delaunay";
    full.progress = 0.625;
    full.requesters = {"ann", "ben"};
    full.attempts = 4;
    full.crashes = 2;
    full.started = now();
    full.finished = now();
    full.warnings = {"First.", "Second."};
    full.error = JobError{ErrorCode::unusable, "There is no object at this threshold."};
    catalog.update_job(full);
  }
  Catalog catalog(folder.path() / "c");
  const auto found = catalog.find_job("job_1");
  ASSERT_TRUE(found);
  EXPECT_EQ(found->kind, full.kind);
  EXPECT_EQ(found->result_id, full.result_id);
  EXPECT_EQ(asked(*found), asked(full));
  EXPECT_EQ(found->state, full.state);
  EXPECT_EQ(found->stage, full.stage);
  EXPECT_EQ(found->progress, full.progress);
  EXPECT_EQ(found->requesters, full.requesters);
  EXPECT_EQ(found->attempts, 4U);
  EXPECT_EQ(found->crashes, 2U);
  EXPECT_EQ(found->created, full.created);
  EXPECT_EQ(found->started, full.started);
  EXPECT_EQ(found->finished, full.finished);
  EXPECT_EQ(found->warnings, full.warnings);
  ASSERT_TRUE(found->error);
  EXPECT_EQ(found->error->code, ErrorCode::unusable);
  EXPECT_EQ(found->error->sentence, full.error->sentence);
  full.error = JobError{{}, "Our fault."};
  full.warnings.clear();
  catalog.update_job(full);
  EXPECT_FALSE(catalog.find_job("job_1")->error->code);
  EXPECT_TRUE(catalog.find_job("job_1")->warnings.empty());
}

TEST(Catalog, ListsUnfinishedJobsOldestFirst) {
  test::ScratchCatalog catalog;
  for (const char* id : {"a", "b", "c"}) catalog.add_job(job(id));
  JobRecord over = job("b");
  over.state = JobState::cancelled;
  over.finished = now();
  catalog.update_job(over);
  EXPECT_EQ(ids(catalog.unfinished_jobs()), (std::vector<std::string>{"a", "c"}));
  const auto page = catalog.list_jobs("", 2);
  EXPECT_EQ(ids(page.items), (std::vector<std::string>{"c", "b"}));
  EXPECT_EQ(ids(catalog.list_jobs(page.next, 2).items), std::vector<std::string>{"a"});
}

TEST(Catalog, AResultAndItsJobAreOneTransaction) {
  test::ScratchCatalog catalog;
  catalog.add(resource("vol_1", "volumes"));
  catalog.add_job(job("j"));
  JobRecord done = job("j");
  done.state = JobState::succeeded;
  done.finished = now();
  EXPECT_EQ(error_of([&] {
              catalog.complete_job(done, resource("mdl_1", "models", {"vol_1", "gone"}, {"k"}));
            }),
            ErrorCode::conflict);
  EXPECT_EQ(catalog.find_job("j")->state, JobState::queued);
  EXPECT_FALSE(catalog.find("mdl_1"));
  EXPECT_FALSE(catalog.owns_blob("k"));
  EXPECT_TRUE(catalog.complete_job(done, resource("mdl_1", "models", {"vol_1"}, {"k"})));
  EXPECT_EQ(catalog.find_job("j")->state, JobState::succeeded);
  EXPECT_TRUE(catalog.owns_blob("k"));
  EXPECT_FALSE(catalog.complete_job(done, resource("mdl_1", "models", {"vol_1"}, {"k2"})));
  EXPECT_FALSE(catalog.owns_blob("k2"));
}

TEST(Catalog, BelongsToOneServerAtATime) {
  const test::TemporaryFolder folder;
  {
    Catalog catalog(folder.path() / "c");
    catalog.add(resource("a"));
    EXPECT_EQ(error_of([&] { Catalog second(folder.path() / "c"); }), ErrorCode::busy);
    EXPECT_TRUE(catalog.add(resource("b")));
  }
  EXPECT_TRUE(Catalog(folder.path() / "c").find("b"));
}

void run_sql(const fs::path& file, const char* sql) {
  sqlite3* database = nullptr;
  ASSERT_EQ(sqlite3_open(file.c_str(), &database), SQLITE_OK);
  EXPECT_EQ(sqlite3_exec(database, sql, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(database);
  sqlite3_close(database);
}

TEST(Catalog, SaysWhenAFileIsNoCatalogue) {
  const test::TemporaryFolder folder;
  std::ofstream(folder.path() / "text") << std::string(10'000, 'x');
  EXPECT_EQ(error_of([&] { Catalog c(folder.path() / "text"); }), ErrorCode::corrupt);
  run_sql(folder.path() / "foreign", "CREATE TABLE shopping (item)");
  EXPECT_EQ(error_of([&] { Catalog c(folder.path() / "foreign"); }), ErrorCode::corrupt);
  fs::create_directory(folder.path() / "folder");
  EXPECT_EQ(error_of([&] { Catalog c(folder.path() / "folder"); }), ErrorCode::corrupt);
}

// A dump of what version 1 wrote.
constexpr const char* kVersion1 = R"sql(
CREATE TABLE resources (
  seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, collection TEXT NOT NULL, created INTEGER NOT NULL,
  request TEXT NOT NULL, document TEXT NOT NULL, bytes INTEGER NOT NULL) STRICT;
CREATE INDEX resources_by_collection ON resources (collection, seq);
CREATE TABLE inputs (
  resource INTEGER NOT NULL REFERENCES resources (seq) ON DELETE CASCADE, position INTEGER NOT NULL,
  input INTEGER NOT NULL REFERENCES resources (seq), PRIMARY KEY (resource, position)) STRICT, WITHOUT ROWID;
CREATE INDEX inputs_by_input ON inputs (input);
CREATE TABLE blobs (
  resource INTEGER NOT NULL REFERENCES resources (seq) ON DELETE CASCADE, position INTEGER NOT NULL,
  key TEXT NOT NULL UNIQUE, PRIMARY KEY (resource, position)) STRICT, WITHOUT ROWID;
CREATE TABLE jobs (
  seq INTEGER PRIMARY KEY AUTOINCREMENT, id TEXT NOT NULL UNIQUE, kind TEXT NOT NULL, result_id TEXT NOT NULL,
  request TEXT NOT NULL, state TEXT NOT NULL, stage TEXT NOT NULL, progress REAL NOT NULL,
  requesters INTEGER NOT NULL, attempts INTEGER NOT NULL, crashes INTEGER NOT NULL,
  created INTEGER NOT NULL, started INTEGER, finished INTEGER, error_code TEXT, error_sentence TEXT) STRICT;
CREATE INDEX jobs_unfinished ON jobs (seq) WHERE finished IS NULL;
CREATE TABLE warnings (
  job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE, position INTEGER NOT NULL, sentence TEXT NOT NULL,
  PRIMARY KEY (job, position)) STRICT, WITHOUT ROWID;
INSERT INTO resources VALUES (1, 'vol_1', 'volumes', 1700000000000000, '', '{"id":"vol_1"}', 5);
INSERT INTO resources VALUES (4, 'mdl_1', 'models', 1700000001000000, '{"volume":"vol_1"}', '{"id":"mdl_1"}', 70);
INSERT INTO resources VALUES (5, 'ans_1', 'answers', 1700000002000000, '{}', '', 7);
INSERT INTO inputs VALUES (4, 0, 1), (5, 0, 4);
INSERT INTO blobs VALUES (1, 0, 'volumes/a'), (1, 1, 'volumes/b'), (4, 0, 'models/c'), (5, 0, 'answers/d');
INSERT INTO jobs VALUES (1, 'job_1', 'model', 'mdl_1', '{"volume":"vol_1"}', 'succeeded', 'store', 1.0, 1, 1, 0,
  1700000000500000, 1700000000600000, 1700000001000000, NULL, NULL);
INSERT INTO jobs VALUES (2, 'job_2', 'model', 'mdl_2', '{}', 'failed', 'boundary', 0.25, 1, 2, 1,
  1700000003000000, 1700000003100000, 1700000003200000, 'unusable', 'The object is empty; choose another threshold.');
INSERT INTO jobs VALUES (3, 'job_3', 'measures', 'ans_2', '{}', 'running', 'union', 0.5, 2, 1, 0,
  1700000004000000, 1700000004100000, NULL, NULL, NULL);
INSERT INTO warnings VALUES (1, 0, 'One.'), (1, 1, 'Two.');
PRAGMA application_id = 0x53706872;
PRAGMA user_version = 1;
)sql";

TEST(Catalog, BringsVersion1UpToDate) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "catalog.sqlite";
  sqlite3* old = nullptr;
  ASSERT_EQ(sqlite3_open(file.c_str(), &old), SQLITE_OK);
  ASSERT_EQ(sqlite3_exec(old, kVersion1, nullptr, nullptr, nullptr), SQLITE_OK) << sqlite3_errmsg(old);
  sqlite3_close(old);
  const auto at = [](std::int64_t microseconds) { return Time(std::chrono::microseconds(microseconds)); };
  for (int opened = 0; opened < 2; ++opened) {
    Catalog catalog(file);
    catalog.verify();
    const auto volume = catalog.find("vol_1"), model = catalog.find("mdl_1"), answer = catalog.find("ans_1");
    ASSERT_TRUE(volume && model && answer);
    EXPECT_EQ(volume->document, "{\"id\":\"vol_1\"}");
    EXPECT_EQ(volume->blobs, (std::vector<std::string>{"volumes/a", "volumes/b"}));
    EXPECT_EQ(volume->created, at(1700000000000000));
    EXPECT_EQ(volume->used, volume->created);
    EXPECT_EQ(model->inputs, std::vector<std::string>{"vol_1"});
    EXPECT_EQ(model->request, "{\"volume\":\"vol_1\"}");
    EXPECT_EQ(model->bytes, 70U);
    EXPECT_EQ(answer->inputs, std::vector<std::string>{"mdl_1"});
    EXPECT_EQ(ids(catalog.list_all("", 9).items), (std::vector<std::string>{"ans_1", "mdl_1", "vol_1"}));
    EXPECT_EQ(ids(catalog.list_jobs("", 9).items), (std::vector<std::string>{"job_3", "job_2", "job_1"}));
    const auto done = catalog.find_job("job_1"), failed = catalog.find_job("job_2");
    ASSERT_TRUE(done && failed);
    EXPECT_EQ(done->state, JobState::succeeded);
    EXPECT_EQ(done->warnings, (std::vector<std::string>{"One.", "Two."}));
    EXPECT_EQ(done->client, "");
    EXPECT_EQ(done->memory_bytes, 0U);
    EXPECT_EQ(failed->error->code, ErrorCode::unusable);
    const auto left = catalog.unfinished_jobs();
    ASSERT_EQ(left.size(), 1U);
    EXPECT_EQ(left[0].requesters, std::set<std::string>{""}) << "of the first it is known who it was";
    EXPECT_EQ(left[0].progress, 0.5);
  }
  // What is new works on what is old.
  Catalog catalog(file);
  EXPECT_EQ(catalog.unused_since("volumes", at(1700000000000001), 5), std::vector<std::string>{"vol_1"});
  catalog.touch("ans_1");
  EXPECT_TRUE(catalog.unused_since("volumes", at(1700000000000001), 5).empty());
  EXPECT_EQ(catalog.forget_jobs(at(1700000002000000)), 1U);
  EXPECT_EQ(catalog.erase("vol_1").size(), 4U);
}

TEST(Catalog, SaysWhenANewerVersionWroteIt) {
  const test::TemporaryFolder folder;
  { Catalog catalog(folder.path() / "c"); }
  run_sql(folder.path() / "c", "PRAGMA user_version = 1000");
  EXPECT_EQ(error_of([&] { Catalog c(folder.path() / "c"); }), ErrorCode::conflict);
}

// Whatever byte is hit, opening and reading either work or say corrupt; nothing else is thrown, nothing crashes.
TEST(Catalog, DamageIsFoundOrHarmless) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "c";
  {
    Catalog catalog(file);
    for (int i = 0; i < 200; ++i) catalog.add(resource("m" + std::to_string(i), "models", {}, {std::to_string(i)}));
    for (int i = 0; i < 50; ++i) catalog.add_job(job("j" + std::to_string(i)));
  }
  const auto size = static_cast<std::streamoff>(fs::file_size(file));
  int found = 0;
  constexpr int trials = 60;
  for (int trial = 0; trial < trials; ++trial) {
    const fs::path damaged = folder.path() / "damaged";
    fs::copy_file(file, damaged, fs::copy_options::overwrite_existing);
    {
      std::fstream stream(damaged, std::ios::in | std::ios::out | std::ios::binary);
      stream.seekp(size * trial / trials);
      stream << std::string(40, '\xa5');
    }
    try {
      Catalog catalog(damaged);
      (void)catalog.list("models", "", 1000);
      (void)catalog.list_jobs("", 1000);
      (void)catalog.unfinished_jobs();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::corrupt) << error.what() << " at trial " << trial;
      ++found;
    }
  }
  EXPECT_GT(found, 0);
  fs::resize_file(file, static_cast<std::uintmax_t>(size / 2));
  EXPECT_EQ(error_of([&] { Catalog c(file); }), ErrorCode::corrupt);
}

TEST(Publishing, LeavesNoBlobThatNothingOwns) {
  test::ScratchCatalog catalog;
  test::MemoryBlobStore blobs;
  const auto upload = [&](const std::string& id, const std::vector<std::string>& inputs) {
    return publish(catalog, blobs, resource(id, "volumes", inputs, {blobs.put("volumes/a", id), blobs.put("b", id)}));
  };
  EXPECT_TRUE(upload("vol_1", {}));
  EXPECT_FALSE(upload("vol_1", {}));
  EXPECT_EQ(blobs.keys().size(), 2U);
  EXPECT_EQ(error_of([&] { upload("vol_2", {"gone"}); }), ErrorCode::conflict);
  EXPECT_EQ(blobs.keys().size(), 2U);
  EXPECT_EQ(blobs.read(catalog.find("vol_1")->blobs[0]), "vol_1");
  withdraw(catalog, blobs, "vol_1");
  EXPECT_TRUE(blobs.keys().empty());
  EXPECT_EQ(error_of([&] { withdraw(catalog, blobs, "vol_1"); }), ErrorCode::not_found);
}

class Orphans : public testing::Test {
 protected:
  test::ScratchCatalog catalog;
  test::MemoryBlobStore inner;
  test::FaultyBlobStore blobs{inner};

  std::string publish_one(const std::string& id) {
    publish(catalog, blobs, resource(id, "volumes", {}, {blobs.put("a", id)}));
    return catalog.find(id)->blobs.at(0);
  }
  /// Keys that are set aside at the next start.
  std::vector<std::string> start() {
    std::vector<std::string> aside;
    sort_out_orphans(catalog, blobs, [&](const std::string& key) {
      aside.push_back(key);
      blobs.remove(key);
    });
    return aside;
  }
};

TEST_F(Orphans, OfACrashGoAtTheNextStart) {
  const std::string kept = publish_one("vol_1");
  publish_one("vol_2");
  (void)blobs.put("a", "as after a crash before publish");
  blobs.fail_remove(true);
  withdraw(catalog, blobs, "vol_2");
  EXPECT_FALSE(catalog.find("vol_2"));
  EXPECT_EQ(blobs.keys().size(), 3U);
  blobs.fail_remove(false);
  EXPECT_TRUE(start().empty());
  EXPECT_EQ(blobs.keys(), std::vector{kept});
  EXPECT_TRUE(blobs.unsettled().empty());
}

TEST_F(Orphans, ThatAreNotUnderstoodAreSetAside) {
  publish_one("vol_1");
  publish_one("vol_2");
  const std::string unknown = blobs.put("volumes/vol_3", "published by another catalogue");
  blobs.settle(unknown);
  EXPECT_EQ(start(), std::vector{unknown});
  EXPECT_EQ(blobs.keys().size(), 2U);
}

TEST_F(Orphans, ThatAreMostSayThatTheCatalogueIsLost) {
  publish_one("vol_1");
  for (const char* name : {"a", "b"}) blobs.settle(blobs.put(name, "published by another catalogue"));
  EXPECT_EQ(error_of([&] { (void)start(); }), ErrorCode::corrupt);
  EXPECT_EQ(blobs.keys().size(), 3U) << "nothing is changed";
  publish_one("vol_2");
  EXPECT_EQ(start().size(), 2U) << "half is not most";
}

TEST_F(Orphans, AWithdrawalThatFailsLeavesTheBlobsOwned) {
  publish_one("vol_1");
  EXPECT_EQ(error_of([&] { withdraw(catalog, blobs, "vol_9"); }), ErrorCode::not_found);
  EXPECT_TRUE(blobs.unsettled().empty());
}

/// A day that passes at once.
struct SetClocks {
  Time wall{std::chrono::hours(24 * 365 * 50)};
  std::chrono::microseconds steady{5};
  Clocks clocks() {
    return {.wall = [this] { return wall; }, .steady = [this] { return steady; }};
  }
  void pass(std::chrono::microseconds time) {
    wall += time;
    steady += time;
  }
};

TEST(TimeOfService, GoesOnWhileServingOnly) {
  using namespace std::chrono_literals;
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "c";
  SetClocks set;
  const Time start = set.wall;
  {
    Catalog catalog(file, set.clocks());
    EXPECT_EQ(catalog.served(), start);
    set.pass(10h);
    catalog.add(resource("vol_1", "volumes"));
    EXPECT_EQ(catalog.find("vol_1")->used, start + 10h);
    EXPECT_EQ(catalog.find("vol_1")->created, set.wall);
    EXPECT_EQ(catalog.note_time(), 0h);
    set.wall += 24h * 40;
    EXPECT_EQ(catalog.served(), start + 10h);
    set.pass(1h);
    EXPECT_EQ(catalog.note_time(), 24h * 40);
    EXPECT_EQ(catalog.note_time(), 0h) << "said once";
    set.wall -= 24h * 400;
    EXPECT_EQ(catalog.note_time(), -24h * 400);
    set.pass(1h);  // not noted: the power goes
  }
  set.wall += 24h * 30;
  set.steady = 7us;  // another boot
  Catalog catalog(file, set.clocks());
  EXPECT_EQ(catalog.served(), start + 11h);
  set.pass(2h);
  EXPECT_EQ(catalog.note_time(), 24h * 30 + 1h);
  catalog.touch("vol_1");
  EXPECT_EQ(catalog.find("vol_1")->used, start + 13h);
  JobRecord over = job("job_1");
  catalog.add_job(over);
  over.state = JobState::succeeded;
  over.finished = set.wall;
  catalog.update_job(over);
  EXPECT_EQ(catalog.find_job("job_1")->finished, set.wall) << "for people";
  EXPECT_EQ(catalog.forget_jobs(start + 13h), 0U);
  EXPECT_EQ(catalog.forget_jobs(start + 13h + 1us), 1U);
}

TEST(TimeOfService, OfAnOlderCatalogueBeginsAtItsLastUse) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "catalog.sqlite";
  run_sql(file, kVersion1);
  run_sql(file, "UPDATE resources SET created = 1700000000000000 WHERE id = 'ans_1'");
  run_sql(file, "UPDATE resources SET created = 1900000000000000 WHERE id = 'mdl_1'");
  SetClocks set;
  set.wall = Time(std::chrono::microseconds(1800000000000000));
  Catalog catalog(file, set.clocks());
  EXPECT_EQ(catalog.find("mdl_1")->used, set.wall) << "not in the future";
  EXPECT_EQ(catalog.served(), set.wall);
}

TEST(Catalog, IsForItsOwnersEyesOnly) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "c";
  const mode_t usual = ::umask(0022);
  { Catalog catalog(file); }
  fs::permissions(file, fs::perms::all);  // as an earlier version might have left it
  fs::permissions(file.native() + ".lock", fs::perms::all);
  Catalog catalog(file);
  catalog.add(resource("vol_1"));
  ::umask(usual);
  for (const auto& entry : fs::directory_iterator(folder.path()))
    EXPECT_EQ(entry.status().permissions(), fs::perms::owner_read | fs::perms::owner_write) << entry.path();
}

TEST(Catalog, ListsWhatItCanReadOfDamagedRows) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "c";
  {
    Catalog catalog(file);
    for (const char* id : {"job_1", "job_2", "job_3", "job_4"}) catalog.add_job(job(id));
    for (const char* id : {"mdl_1", "mdl_2"}) catalog.add(resource(id));
  }
  run_sql(file, "UPDATE jobs SET state = 'dreaming' WHERE id = 'job_2'");
  run_sql(file, "UPDATE jobs SET created = 9223372036854775807 WHERE id = 'job_3'");
  run_sql(file, "UPDATE resources SET created = -9223372036854775807 WHERE id = 'mdl_1'");
  Catalog catalog(file);
  const Page<JobRecord> page = catalog.list_jobs("", 3);
  EXPECT_EQ(ids(page.items), std::vector<std::string>{"job_4"});
  EXPECT_EQ(page.damaged, (std::vector<std::string>{"job_3", "job_2"}));
  EXPECT_EQ(ids(catalog.list_jobs(page.next, 3).items), std::vector<std::string>{"job_1"});
  EXPECT_EQ(ids(catalog.unfinished_jobs()), (std::vector<std::string>{"job_1", "job_4"}));
  EXPECT_EQ(error_of([&] { (void)catalog.find_job("job_2"); }), ErrorCode::corrupt);
  EXPECT_EQ(catalog.list("models", "", 9).damaged, std::vector<std::string>{"mdl_1"});
  EXPECT_EQ(catalog.damaged_jobs(), (std::vector<std::string>{"job_3", "job_2"}));
  catalog.forget_job("job_2");
  EXPECT_EQ(catalog.damaged_jobs(), std::vector<std::string>{"job_3"});
}

TEST(Catalog, NamesWhatGoesToStayWithinABudget) {
  test::ScratchCatalog catalog;
  for (const char* id : {"ans_1", "ans_2", "ans_3"}) catalog.add(resource(id, "answers"));  // 17 bytes each
  catalog.add(resource("mdl_1", "models"));
  EXPECT_TRUE(catalog.over_budget("answers", 51).empty());
  EXPECT_EQ(catalog.over_budget("answers", 50), std::vector<std::string>{"ans_1"});
  catalog.touch("ans_1");
  EXPECT_EQ(catalog.over_budget("answers", 20), (std::vector<std::string>{"ans_2", "ans_3"}));
  EXPECT_EQ(catalog.over_budget("answers", 0).size(), 3U);
  EXPECT_TRUE(catalog.over_budget("nothing", 0).empty());
}

TEST(FullDisk, StopsNoDeletion) {
  test::on_a_small_disk(
      [](const fs::path& disk) -> std::string {
        constexpr int many = 500;
        {
          Catalog catalog(disk / "catalog.sqlite");
          catalog.add(resource("vol_1", "volumes"));
          for (int i = 0; i < many; ++i) catalog.add(resource("mdl_" + std::to_string(i), "models", {"vol_1"}));
          for (int i = 0; i < 3; ++i) catalog.add(resource("other_" + std::to_string(i)));
          catalog.reserve_room();
          test::fill_disk(disk / "filler");
          if (error_of([&] {
                while (true) catalog.add(resource(random_id("x")));
              }) != ErrorCode::no_space)
            return "it was not full";
          if (const auto error = error_of([&] { (void)catalog.erase("vol_1"); })) return "a deletion was refused";
          if (catalog.find("mdl_7")) return "what was deleted is there";
        }
        if (error_of([&] { Catalog catalog(disk / "catalog.sqlite"); })) return "it does not open again";
        return "";
      },
      16);
}

TEST(FullDisk, IsSaidAndLosesNothing) {
  test::on_a_small_disk([](const fs::path& disk) -> std::string {
    Catalog catalog(disk / "catalog.sqlite");
    FileBlobStore blobs(disk / "blobs");
    if (error_of([&] { (void)blobs.stage(1 << 20, 1000); }) != ErrorCode::no_space)
      return "a declared size was accepted";
    if (error_of([&] { blobs.stage(1 << 20)->append("x"); }) != ErrorCode::no_space) return "the reserve was not kept";
    test::fill_disk(disk / "filler");
    int added = 0;
    std::optional<ErrorCode> refusal;
    while (!refusal && added < 100'000) {
      refusal = error_of([&] { catalog.add(resource("m" + std::to_string(added))); });
      added += !refusal;
    }
    if (refusal != ErrorCode::no_space) return "the full catalogue did not say no_space";
    for (int i = 0; i < added; ++i)
      if (!catalog.find("m" + std::to_string(i))) return "an acknowledged row is gone";
    if (catalog.find("m" + std::to_string(added))) return "a refused row is there";

    fs::remove(disk / "filler");
    if (error_of([&] { catalog.add(resource("after")); })) return "it did not recover when space was free again";
    if (catalog.list("models", "", 1'000'000).items.size() != static_cast<std::size_t>(added) + 1) return "wrong count";
    return "";
  });
}

}  // namespace
}  // namespace spherule::server
