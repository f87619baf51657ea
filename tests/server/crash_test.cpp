// SPDX-License-Identifier: GPL-3.0-or-later
//
// A child process uploads, deletes and computes until it is killed, at moments that nobody chose. Whatever it had
// acknowledged must be there afterwards, in full; nothing may be there in part.
#include <gtest/gtest.h>
#include <poll.h>
#include <sys/wait.h>
#include <unistd.h>

#include <algorithm>
#include <csignal>
#include <cstdlib>
#include <cstring>
#include <limits>
#include <random>
#include <set>
#include <sstream>
#include <thread>

#include "server/work/jobs.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using test::asks;

using namespace std::chrono_literals;
namespace fs = std::filesystem;

constexpr int kills = 80;
constexpr unsigned never = 1'000'000;  // crashes until a job is given up

/// The bytes that belong to a seed: 1 byte to 300 kB.
std::string bytes_of(const std::string& seed) {
  std::seed_seq sequence(seed.begin(), seed.end());
  std::mt19937_64 random(sequence);
  std::string bytes(random() % 8 ? random() % 5'000 + 1 : random() % 300'000 + 1, '\0');
  for (std::size_t at = 0; at < bytes.size(); at += 8) {
    const std::uint64_t word = random();
    std::memcpy(&bytes[at], &word, std::min<std::size_t>(8, bytes.size() - at));
  }
  return bytes;
}

struct Server {
  Catalog catalog;
  FileBlobStore blobs;

  explicit Server(const fs::path& folder) : catalog(folder / "catalog.sqlite"), blobs(folder / "blobs") {
    // Whenever it is killed, what it leaves is understood.
    sort_out_orphans(catalog, blobs, [](const std::string& key) { throw std::runtime_error("unknown blob " + key); });
  }

  Resource store(const std::string& id, const std::string& collection) {
    const std::string bytes = bytes_of(id);
    const auto staging = blobs.stage(std::numeric_limits<std::uint64_t>::max(), bytes.size());
    for (std::size_t at = 0; at < bytes.size(); at += 4096) staging->append(std::string_view(bytes).substr(at, 4096));
    Resource resource;
    resource.id = id;
    resource.collection = collection;
    resource.bytes = bytes.size();
    resource.blobs = {staging->commit(collection + "/" + id), blobs.put(collection + "/" + id, id)};
    return resource;
  }

  JobRunner runner() {
    return [this](const JobRecord& job, JobContext& context) {
      context.context(0, 1).report("writing", 0.5);
      return store(job.result_id, "models");
    };
  }
};

/// The child. Says one line after each thing that it has done: "+ id" stored, "- id" about to be deleted, "j job"
/// accepted, "s job" succeeded.
[[noreturn]] void serve(const fs::path& folder, int round, int pipe) {
  try {
    const auto say = [&](const std::string& line) {
      if (::write(pipe, (line + "\n").data(), line.size() + 1) < 0) std::_Exit(2);
    };
    Server server(folder);
    JobPool pool({.jobs_at_once = 2, .queue_length = 10, .crash_limit = never}, server.catalog, server.blobs,
                 server.runner());
    std::mt19937 random(static_cast<unsigned>(round));
    for (int i = 0;; ++i) {
      const std::string id = std::to_string(round) + "-" + std::to_string(i);
      if (random() % 2) {
        publish(server.catalog, server.blobs, server.store("vol_" + id, "volumes"));
        say("+ vol_" + id);
        if (random() % 4 == 0) {
          say("- vol_" + id);
          withdraw(server.catalog, server.blobs, "vol_" + id);
        }
      } else if (pool.load().queued < 10) {
        const std::string job = pool.submit(asks(), "mdl_" + id).id;
        say("j " + job);
        if (random() % 2 && is_over(pool.wait(job, 20ms).state)) say("s " + job);
      }
    }
  } catch (const std::exception& error) {
    std::fprintf(stderr, "child: %s\n", error.what());
  }
  std::_Exit(1);
}

struct Acknowledged {
  std::set<std::string> stored, deleting, jobs, succeeded;
  std::set<std::string> read;  // found intact in an earlier round; all are read again in the last

  void hear(const std::string& all) {
    std::istringstream lines(all.substr(0, all.rfind('\n') + 1));
    for (std::string what, id; lines >> what >> id;)
      (what == "+" ? stored : what == "-" ? deleting : what == "j" ? jobs : succeeded).insert(id);
  }
};

std::string read_all(int pipe) {
  std::string all;
  char piece[4096];
  for (ssize_t got; (got = ::read(pipe, piece, sizeof piece)) > 0;) all.append(piece, static_cast<std::size_t>(got));
  return all;
}

void expect_intact(const fs::path& folder, Acknowledged& acknowledged) {
  Server server(folder);
  std::set<std::string> owned, there;
  for (const char* collection : {"volumes", "models"})
    for (const Resource& resource : server.catalog.list(collection, "", 1'000'000).items) {
      there.insert(resource.id);
      owned.insert(resource.blobs.begin(), resource.blobs.end());
      if (!acknowledged.read.insert(resource.id).second) continue;
      ASSERT_EQ(server.blobs.read(resource.blobs.at(0)), bytes_of(resource.id)) << resource.id;
      ASSERT_EQ(server.blobs.read(resource.blobs.at(1)), resource.id);
    }
  for (const std::string& id : acknowledged.stored)
    EXPECT_TRUE(there.count(id) || acknowledged.deleting.count(id)) << id << " was acknowledged and is gone";
  for (const std::string& id : acknowledged.jobs)
    EXPECT_TRUE(server.catalog.find_job(id)) << id << " was accepted and is gone";
  for (const std::string& id : acknowledged.succeeded)
    EXPECT_EQ(server.catalog.find_job(id)->state, JobState::succeeded) << id;
  for (const JobRecord& job : server.catalog.list_jobs("", 1'000'000).items) {
    EXPECT_EQ(job.state == JobState::succeeded, there.count(job.result_id) == 1) << job.id;
    EXPECT_NE(job.state, JobState::failed);
  }
  const std::vector<std::string> keys = server.blobs.keys();
  EXPECT_EQ(std::set<std::string>(keys.begin(), keys.end()), owned);
  EXPECT_TRUE(fs::is_empty(server.blobs.scratch_root()));
}

TEST(Crash, NothingAcknowledgedIsLostAndNothingIsThereInPart) {
  // SIGKILL loses nothing that write() took, so a file system in memory tells as much, and sooner.
  const fs::path memory = "/dev/shm";
  const test::TemporaryFolder folder(::access(memory.c_str(), W_OK) == 0 ? memory : fs::temp_directory_path());
  std::mt19937 random(1);
  Acknowledged acknowledged;
  for (int round = 0; round < kills; ++round) {
    int pipe[2];
    ASSERT_EQ(::pipe(pipe), 0);
    const pid_t child = fork();
    ASSERT_GE(child, 0);
    if (child == 0) {
      ::close(pipe[0]);
      serve(folder.path(), round, pipe[1]);
    }
    ::close(pipe[1]);
    if (round % 4) {  // else perhaps while it is still starting
      pollfd ready{pipe[0], POLLIN, 0};
      ASSERT_EQ(::poll(&ready, 1, 60'000), 1);
    }
    // The moment of the kill, not a wait for anything.
    std::this_thread::sleep_for(std::chrono::microseconds(random() % 20'000));
    ASSERT_EQ(::kill(child, SIGKILL), 0);
    acknowledged.hear(read_all(pipe[0]));
    ::close(pipe[0]);
    int status = 0;
    ASSERT_EQ(::waitpid(child, &status, 0), child);
    ASSERT_TRUE(WIFSIGNALED(status)) << "the child ended by itself";
    expect_intact(folder.path(), acknowledged);
    if (HasFatalFailure()) return;
  }
  acknowledged.read.clear();
  expect_intact(folder.path(), acknowledged);
  RecordProperty("stored", static_cast<int>(acknowledged.stored.size()));
  RecordProperty("jobs", static_cast<int>(acknowledged.jobs.size()));
  EXPECT_GE(acknowledged.stored.size(), 20U);
  EXPECT_GE(acknowledged.jobs.size(), 20U);
  EXPECT_GE(acknowledged.succeeded.size(), 5U);

  Server server(folder.path());
  const JobPool pool({.jobs_at_once = 2, .crash_limit = never}, server.catalog, server.blobs, server.runner());
  for (const std::string& id : acknowledged.jobs) EXPECT_EQ(pool.wait(id, 60s).state, JobState::succeeded) << id;
}

}  // namespace
}  // namespace spherule::server
