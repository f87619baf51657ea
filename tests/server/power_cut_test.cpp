// SPDX-License-Identifier: GPL-3.0-or-later
//
// Power cuts after every call by which the stores change the disk. What a cut leaves, opened anew, must be what was
// there before the call of the store that was under way, or after it: what was acknowledged is there, and nothing is
// there in part. And every synchronisation is needed: without it, some cut does harm.
#include <gtest/gtest.h>
#include <sqlite3.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <fstream>
#include <functional>
#include <iterator>
#include <map>
#include <optional>
#include <set>
#include <sstream>

#include "server/base/disk.h"
#include "server/base/log.h"
#include "server/bytes/aside.h"
#include "server/fsck.h"
#include "server/intake/resumable.h"
#include "server/records/replies.h"
#include "tests/long_form.h"
#include "tests/server/doubles.h"
#include "tests/server/lossy_disk.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
namespace fs = std::filesystem;
using test::LossyDisk;

/// Calls of a store, one after the other, and what is found when it is opened again.
struct Drill {
  struct Step {
    std::string name;
    std::function<void()> act;
  };
  /// What was there long before.
  std::function<void(const fs::path& folder)> prepare = [](const auto&) {};
  std::function<std::vector<Step>(const fs::path& folder)> steps;
  /// All that the folder holds, in words; throws when it cannot be opened, or holds anything in part.
  std::function<std::string(const fs::path& folder)> see;
  /// Whether a cut during a call may leave what lies between `before` and `after`.
  std::function<bool(const std::string& before, const std::string& after, const std::string& seen)> between =
      [](const auto&, const auto&, const auto&) { return false; };
};

fs::path memory() {
  const fs::path folder = "/dev/shm";
  return ::access(folder.c_str(), W_OK) == 0 ? folder : fs::temp_directory_path();
}

constexpr const char* unusable = "cannot be used: ";

std::string seen_in(const Drill& drill, const test::Image& image) {
  const test::TemporaryFolder folder(memory());
  image.write_to(folder.path());
  try {
    return drill.see(folder.path());
  } catch (const std::exception& error) {
    return std::string(unusable) + error.what();
  }
}

struct Outcome {
  std::set<std::string> labels;   ///< of the synchronisations
  std::vector<std::string> harm;  ///< that cuts do
  std::size_t cuts = 0;
};

std::string text_of(const LossyDisk::Cut& cut) {
  const char* contents = cut.contents == LossyDisk::Contents::synced ? "synced"
                         : cut.contents == LossyDisk::Contents::torn ? "torn"
                                                                     : "all";
  return "after " + cut.after + (cut.during_next ? " within" : " before") + " step " + std::to_string(cut.steps) +
         (cut.names == LossyDisk::Names::synced ? ", names synced" : ", names all") + ", contents " + contents;
}

/// Runs the drill on a disk that ignores some synchronisations; `most` harms are enough.
Outcome run(const Drill& drill, const std::set<std::string>& ignored = {}, std::size_t most = 3) {
  const test::TemporaryFolder folder(memory());
  const fs::path place = fs::canonical(folder.path());
  drill.prepare(place);
  LossyDisk disk(place, ignored);
  for (const Drill::Step& step : drill.steps(place)) disk.step(step.name, step.act);
  std::map<test::Image, std::string> known;
  const auto seen_of = [&](const test::Image& image) {
    const auto [seen, is_new] = known.try_emplace(image);
    if (is_new) seen->second = seen_in(drill, image);
    return seen->second;
  };
  Outcome outcome{.labels = disk.labels(), .harm = {}, .cuts = 0};
  if (most == 0) return outcome;
  for (const LossyDisk::Cut& cut : disk.cuts()) {
    ++outcome.cuts;
    const std::string seen = seen_of(cut.left), before = seen_of(disk.wholes().at(cut.steps));
    const bool usable = !seen.starts_with(unusable);
    if (usable && seen == before) continue;
    if (usable && cut.during_next) {
      const std::string after = seen_of(disk.wholes().at(cut.steps + 1));
      if (seen == after || drill.between(before, after, seen)) continue;
    }
    outcome.harm.push_back(text_of(cut) + ":\n" + seen + "\ninstead of:\n" + before);
    if (outcome.harm.size() == most) break;
  }
  return outcome;
}

/// The synchronisations that are one line of the program: those of SQLite's files wherever they are, as its settings
/// are one line, others by the call that they belong to.
std::string line_of(const std::string& label) {
  const std::size_t name = label.find("/catalog.");
  return name == label.npos ? label : label.substr(label.find(": ") + 2);
}

void hold(const Drill& drill) {
  const Outcome outcome = run(drill);
  for (const std::string& harm : outcome.harm) ADD_FAILURE() << harm;
  testing::Test::RecordProperty("cuts", static_cast<int>(outcome.cuts));
}

/// Of a machine on which no time passes.
Clocks still() {
  return {.wall = [] { return Time(std::chrono::days(20'000)); },
          .steady = [] { return std::chrono::microseconds(0); }};
}

std::string text_of(const fs::path& file) {
  std::ifstream in(file, std::ios::binary);
  return {std::istreambuf_iterator<char>(in), {}};
}

Resource resource(const std::string& id, const std::string& collection, std::vector<std::string> inputs = {},
                  std::vector<std::string> blobs = {}) {
  Resource made;
  made.id = id;
  made.collection = collection;
  made.document = "document of " + id;
  made.inputs = std::move(inputs);
  made.blobs = std::move(blobs);
  return made;
}

JobRecord job(const std::string& id, const std::string& result, JobState state = JobState::queued) {
  JobRecord made;
  made.id = id;
  made.kind = "model";
  made.result_id = result;
  made.request = test::asks("request of " + id);
  made.state = state;
  made.created = Time(1s);
  made.requesters = {"somebody"};
  if (is_over(state)) made.finished = Time(2s);
  return made;
}

void tell(std::ostream& out, const Catalog& catalog) {
  for (const Resource& each : catalog.list_all("", 1000).items) {
    out << each.id << ' ' << each.collection << ' ' << each.document << " used "
        << each.used.time_since_epoch().count();
    for (const std::string& input : each.inputs) out << " from " << input;
    for (const std::string& blob : each.blobs) out << " blob " << blob;
    out << '\n';
  }
  for (const JobRecord& each : catalog.list_jobs("", 1000).items) {
    out << each.id << ' ' << test::asked(each) << ' ' << name(each.state) << ' ' << each.requesters.size() << '\n';
  }
}

Drill folders() {
  Drill drill;
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    return {{"make", [=] { make_folder(folder / "a" / "b" / "c"); }}};
  };
  drill.see = [](const fs::path& folder) { return fs::exists(folder / "a" / "b" / "c") ? "there" : "not there"; };
  return drill;
}

Drill catalogue() {
  Drill drill;
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto file = folder / "data" / "catalog.sqlite";
    const auto time = std::make_shared<std::chrono::microseconds>(0);
    const Clocks clocks{.wall = [time] { return still().wall() + *time; }, .steady = [time] { return *time; }};
    auto catalog = std::make_shared<std::optional<Catalog>>();
    return {{"open", [=] { catalog->emplace(file, clocks); }},
            {"add", [=] { (*catalog)->add(resource("vol_1", "volumes", {}, {"key"})); }},
            {"add a job", [=] { (*catalog)->add_job(job("job_1", "mdl_1")); }},
            {"start it", [=] { (*catalog)->update_job(job("job_1", "mdl_1", JobState::running)); }},
            {"complete it",
             [=] {
               (*catalog)->complete_job(job("job_1", "mdl_1", JobState::succeeded),
                                        resource("mdl_1", "models", {"vol_1"}));
             }},
            {"note the time",
             [=] {
               *time += 1h;
               (*catalog)->note_time();
             }},
            {"touch", [=] { (*catalog)->touch("mdl_1"); }},
            {"close", [=] { catalog->reset(); }},
            {"open", [=] { catalog->emplace(file, clocks); }},
            {"erase", [=] { (void)(*catalog)->erase("vol_1"); }},
            {"forget", [=] { (*catalog)->forget_jobs(Time::max()); }},
            {"add", [=] { (*catalog)->add(resource("vol_2", "volumes")); }},
            {"close", [=] { catalog->reset(); }}};
  };
  drill.see = [](const fs::path& folder) {
    const Catalog catalog(folder / "data" / "catalog.sqlite", still());
    catalog.verify();
    std::ostringstream out;
    out << "served " << catalog.served().time_since_epoch().count() << '\n';
    tell(out, catalog);
    return out.str();
  };
  return drill;
}

/// Catalogue and blobs, as the server opens them.
struct Kept {
  Catalog catalog;
  FileBlobStore blobs;

  explicit Kept(const fs::path& data) : catalog(data / "catalog.sqlite", still()), blobs(data / "blobs") {
    sort_out_orphans(catalog, blobs, [](const std::string& key) { throw std::runtime_error("unknown blob " + key); });
  }
  std::string put(const std::string& id, const std::string& collection) {
    return blobs.put(collection + "/" + id, "bytes of " + id);
  }
};

/// All of a data folder.
std::string contents_of(const fs::path& data) {
  Kept kept(data);
  std::ostringstream out;
  std::set<std::string> owned;
  tell(out, kept.catalog);
  for (const Resource& each : kept.catalog.list_all("", 1000).items)
    for (const std::string& key : each.blobs) {
      out << kept.blobs.read(key) << '\n';
      owned.insert(key);
    }
  for (const std::string& key : kept.blobs.keys())
    if (!owned.contains(key)) out << "nobody's " << key << '\n';
  for (const std::string& key : kept.blobs.unsettled()) out << "unsettled " << key << '\n';
  return out.str();
}

Drill blobs() {
  Drill drill;
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto kept = std::make_shared<std::optional<Kept>>();
    const auto publish_one = [=](const std::string& id, const std::string& collection,
                                 std::vector<std::string> inputs) {
      Kept& all = **kept;
      publish(all.catalog, all.blobs, resource(id, collection, std::move(inputs), {all.put(id, collection)}));
    };
    const auto withdraw_one = [=](const std::string& id) { withdraw((*kept)->catalog, (*kept)->blobs, id); };
    const auto complete = [=](const std::string& id, const std::string& input) {
      Kept& all = **kept;
      const Resource made = resource(id, "models", {input}, {all.put(id, "models")});
      all.catalog.complete_job(job("job_" + id, id, JobState::succeeded), made);
      settle_all(all.blobs, made.blobs);
    };
    return {{"open", [=] { kept->emplace(folder / "data"); }},
            {"publish", [=] { publish_one("vol_1", "volumes", {}); }},
            {"withdraw", [=] { withdraw_one("vol_1"); }},
            {"publish", [=] { publish_one("vol_2", "volumes", {}); }},
            {"publish", [=] { publish_one("vol_2", "volumes", {}); }},  // again
            {"publish", [=] { publish_one("mdl_2", "models", {"vol_2"}); }},
            {"publish", [=] { publish_one("vol_3", "volumes", {}); }},
            {"add a job", [=] { (*kept)->catalog.add_job(job("job_mdl_3", "mdl_3")); }},
            {"complete it", [=] { complete("mdl_3", "vol_3"); }},
            {"withdraw", [=] { withdraw_one("vol_2"); }},
            {"close", [=] { kept->reset(); }},
            {"open", [=] { kept->emplace(folder / "data"); }},
            {"withdraw", [=] { withdraw_one("vol_3"); }}};
  };
  drill.see = [](const fs::path& folder) { return contents_of(folder / "data"); };
  return drill;
}

/// None of its files is damaged.
Surroundings around(std::function<Time()> served) {
  Surroundings made;
  made.served = std::move(served);
  made.set_aside = [](const fs::path& file) {
    if (fs::exists(file)) throw std::runtime_error("damaged: " + file.extension().native());
  };
  return made;
}

Drill uploads() {
  Drill drill;
  const auto served = [] { return still().wall(); };
  drill.steps = [=](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto uploads = std::make_shared<std::optional<ResumableUploads>>();
    const auto id = std::make_shared<std::string>();
    const auto append = [=](std::uint64_t offset, std::vector<std::string> pieces) {
      (*uploads)->append(*id, offset, [&](const auto& take) {
        for (const std::string& piece : pieces) take(piece);
      });
    };
    return {{"open", [=] { uploads->emplace(folder / "uploads", 100, 1h, 10, around(served)); }},
            {"create", [=] { *id = (*uploads)->create(12, "name").id; }},
            {"append",
             [=] {
               append(0, {"0123", "45"});
             }},
            {"break",
             [=] {
               EXPECT_THROW((*uploads)->append(*id, 6,
                                               [&](const auto& take) {
                                                 take("67");
                                                 throw Error(ErrorCode::malformed, "The connection broke.");
                                               }),
                            Error);
             }},
            {"finish",
             [=] {
               append(8, {"89", "ab"});
             }},
            {"create", [=] { (*uploads)->create(5, "other"); }}};
  };
  drill.see = [=](const fs::path& folder) {
    const ResumableUploads uploads(folder / "uploads", 100, 1h, 10, around(served));
    std::set<std::string> all;
    for (const auto& entry : fs::directory_iterator(folder / "uploads"))
      if (entry.path().extension() == ".part") {
        const api::UploadInfo upload = uploads.find(entry.path().stem());
        all.insert(upload.id + ' ' + std::to_string(upload.length) + ' ' + upload.filename + ' ' +
                   text_of(entry.path()));
      }
    std::string out;
    for (const std::string& each : all) out += each + '\n';
    return out;
  };
  // The one that is appended to is the only one that grows.
  drill.between = [](const std::string& before, const std::string& after, const std::string& seen) {
    return !before.empty() && std::ranges::count(before, '\n') == std::ranges::count(after, '\n') &&
           seen.starts_with(before.substr(0, before.size() - 1)) && after.starts_with(seen.substr(0, seen.size() - 1));
  };
  return drill;
}

Drill replies() {
  Drill drill;
  const auto served = [] { return still().wall(); };
  drill.steps = [=](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto book = std::make_shared<std::optional<ReplyBook>>();
    return {{"open", [=] { book->emplace(folder / "replies", 1h, around(served)); }},
            {"keep", [=] { (*book)->recall("first"), (*book)->keep("first", "reply"); }},
            {"release", [=] { (*book)->recall("second"), (*book)->release("second"); }},
            {"keep", [=] { (*book)->keep("first", "another reply"); }},
            {"keep", [=] { (*book)->recall("second"), (*book)->keep("second", "second reply"); }}};
  };
  drill.see = [=](const fs::path& folder) {
    ReplyBook book(folder / "replies", 1h, around(served));
    return book.recall("first").value_or("none") + ", " + book.recall("second").value_or("none");
  };
  return drill;
}

Drill aside() {
  Drill drill;
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto book = std::make_shared<std::optional<ReplyBook>>();
    const fs::path replies = folder / "replies";
    return {{"open", [=] { book->emplace(replies, 1h); }},
            {"keep", [=] { (*book)->keep("first", "reply"); }},
            {"set aside", [=] { set_aside(folder, fs::directory_iterator(replies)->path(), "first"); }},
            {"keep", [=] { (*book)->keep("second", "another"); }},
            {"set a text aside", [=] { set_text_aside(folder, "text", "text"); }}};
  };
  // In either place, or in both.
  drill.see = [](const fs::path& folder) {
    std::set<std::string> all;
    for (const char* name : {"replies", "damaged"}) {
      std::error_code missing;
      for (const auto& entry : fs::directory_iterator(folder / name, missing))
        if (entry.path().extension() != ".new") all.insert(text_of(entry.path()).substr(0, 8));
    }
    std::string out;
    for (const std::string& each : all) out += each + '\n';
    return out;
  };
  return drill;
}

Drill audit() {
  Drill drill;
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    const auto log = std::make_shared<std::optional<AppendLog>>();
    const auto append = [=](const char* event, bool durable) { (*log)->append(LogLine(event), durable); };
    return {{"open", [=] { log->emplace(folder / "logs" / "audit.log"); }},
            {"append", [=] { append("first", true); }},
            {"rotate", [=] { fs::rename(folder / "logs" / "audit.log", folder / "logs" / "audit.log.1"); }},
            {"append", [=] { append("second", true); }}};
  };
  drill.see = [](const fs::path& folder) {
    std::set<std::string> all;
    std::error_code missing;
    for (const auto& entry : fs::directory_iterator(folder / "logs", missing)) {
      std::ifstream file(entry.path());
      for (std::string line; std::getline(file, line) && !file.eof();) all.insert(line);
    }
    std::string out;
    for (const std::string& each : all) out += each + '\n';
    return out;
  };
  return drill;
}

/// Two answers, the other one made from the first.
void store_two(const fs::path& data) {
  Kept kept(data);
  for (const char* id : {"ans_1", "ans_2"}) {
    const std::vector<std::string> inputs =
        id == std::string("ans_2") ? std::vector<std::string>{"ans_1"} : std::vector<std::string>{};
    publish(kept.catalog, kept.blobs, resource(id, "answers", inputs, {kept.put(id, "answers")}));
  }
}

std::string checked(const fs::path& data, bool repair) {
  std::string out;
  for (const Finding& finding : check_store(data, repair).findings) out += std::string(to_string(finding.kind)) + '\n';
  return out;
}

Drill copies() {
  Drill drill;
  drill.prepare = [](const fs::path& folder) { store_two(folder / "data"); };
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    return {{"copy", [=] { (void)copy_store(folder / "data", folder / "copy"); }}};
  };
  drill.see = [](const fs::path& folder) {
    std::string out = contents_of(folder / "data");
    if (fs::exists(folder / "copy" / "catalog.sqlite"))
      out += "copy\n" + checked(folder / "copy", false) + contents_of(folder / "copy");
    return out;
  };
  return drill;
}

Drill repair() {
  Drill drill;
  drill.prepare = [](const fs::path& folder) {
    store_two(folder / "data");
    const fs::path file = folder / "data" / "catalog.sqlite";
    // An index, so that no row is lost.
    sqlite3* database = nullptr;
    sqlite3_stmt* query = nullptr;
    ASSERT_EQ(sqlite3_open(file.c_str(), &database), SQLITE_OK);
    sqlite3_prepare_v2(database, "SELECT rootpage FROM sqlite_schema WHERE name = 'resources_by_collection'", -1,
                       &query, nullptr);
    ASSERT_EQ(sqlite3_step(query), SQLITE_ROW);
    const std::int64_t page = sqlite3_column_int64(query, 0);
    sqlite3_finalize(query);
    sqlite3_close(database);
    std::fstream(file, std::ios::in | std::ios::out | std::ios::binary).seekp((page - 1) * 4096)
        << std::string(4096, 'x');
  };
  drill.steps = [](const fs::path& folder) -> std::vector<Drill::Step> {
    return {{"repair", [=] { (void)check_store(folder / "data", true); }}};
  };
  // What is not done yet is done anew.
  drill.see = [](const fs::path& folder) {
    (void)checked(folder / "data", true);
    std::string out = checked(folder / "data", false) + contents_of(folder / "data");
    return out +
           (fs::exists(folder / "data" / "damaged" / "catalog.sqlite") ? "the damaged one is kept" : "it is lost");
  };
  return drill;
}

TEST(PowerCut, FoldersAreThere) { hold(folders()); }
TEST(PowerCut, TheCatalogueKeepsWhatItSaid) { hold(catalogue()); }
TEST(PowerCut, BlobsAreThereInFullWithTheirOwners) { hold(blobs()); }
TEST(PowerCut, UploadsGoOnFromWhereTheyWere) { hold(uploads()); }
TEST(PowerCut, RepliesAreRecalled) { hold(replies()); }
TEST(PowerCut, WhatIsSetAsideIsNeverLost) { hold(aside()); }
TEST(PowerCut, DurableLinesStayInTheLog) { hold(audit()); }

TEST(PowerCut, CopiesAreWhole) { hold(copies()); }
TEST(PowerCut, RepairsCanBeBegunAnew) {
  if (!spherule::test::long_form()) GTEST_SKIP() << "takes seconds: set SPHERULE_FAULTS=full";
  hold(repair());
}

TEST(PowerCut, EverySynchronisationIsNeeded) {
  const std::set<std::string> spared = {
      // SQLite's journals begin and end before there is anything to be kept, and a log that is closed is in the file.
      "fdatasync data/catalog.sqlite-journal", "fdatasync copy/catalog.partial-journal",
      "fdatasync copy/catalog.partial-wal", "fdatasync data/catalog.salvaged-journal",
      "fdatasync data/catalog.salvaged-wal", "fdatasync copy/catalog.sqlite", "fdatasync copy/catalog.sqlite-wal",
      // SQLite synchronises the folder that we do: either would do.
      "copy: fdatasync copy", "copy: fsync copy", "repair: fdatasync data", "repair: fsync data",
      // Drafts need not last, hence not their folder; it is made as all are.
      "open: fsync data/blobs"};
  std::vector<Drill> drills = {folders(), uploads(), replies(), aside(), audit(), catalogue(), blobs(), copies()};
  if (spherule::test::long_form()) drills.push_back(repair());
  std::map<std::string, bool> lines;
  for (const Drill& drill : drills) {
    std::map<std::string, std::set<std::string>> labels;
    for (const std::string& label : run(drill, {}, 0).labels) labels[line_of(label)].insert(label);
    for (const auto& [line, of_line] : labels) {
      if (spared.contains(line)) continue;
      if (bool& needed = lines[line]; !needed) needed = !run(drill, of_line, 1).harm.empty();
    }
  }
  for (const auto& [line, needed] : lines) EXPECT_TRUE(needed) << "needless, or the drills too easy: " << line;
  EXPECT_GE(lines.size(), 30U);
}

}  // namespace
}  // namespace spherule::server
