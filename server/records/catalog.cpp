// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/catalog.h"

#include <fcntl.h>
#include <sys/file.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <cerrno>
#include <charconv>
#include <condition_variable>
#include <limits>
#include <mutex>
#include <new>
#include <set>
#include <stdexcept>
#include <thread>
#include <utility>

#include "api/json/work.h"
#include "core/base/check.h"
#include "server/base/disk.h"
#include "server/records/sqlite.h"

namespace spherule::server {

namespace {

using sqlite::Connection;
using sqlite::Statement;
using sqlite::throw_corrupt;
using sqlite::Transaction;

// Reads take microseconds, so that few connections serve many threads.
constexpr std::size_t reader_count = 4;

constexpr int application_id = 0x53706872;  // "Sphr": tells our files from other SQLite files

// Step i brings a file from schema version i to i + 1. Steps that were released never change.
constexpr std::array migrations = {
    R"sql(
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
)sql",
    R"sql(
ALTER TABLE resources ADD COLUMN used INTEGER NOT NULL DEFAULT 0;
UPDATE resources SET used = created;
CREATE INDEX resources_by_use ON resources (collection, used);
ALTER TABLE jobs ADD COLUMN client TEXT NOT NULL DEFAULT '';
ALTER TABLE jobs ADD COLUMN memory INTEGER NOT NULL DEFAULT 0;
)sql",
    // Of those who joined a job, only the number was known.
    R"sql(
CREATE TABLE requesters (
  job INTEGER NOT NULL REFERENCES jobs (seq) ON DELETE CASCADE, client TEXT NOT NULL,
  PRIMARY KEY (job, client)) STRICT, WITHOUT ROWID;
INSERT INTO requesters SELECT seq, client FROM jobs WHERE requesters > 0;
ALTER TABLE jobs DROP COLUMN requesters;
)sql",
    R"sql(
CREATE TABLE clock (row INTEGER PRIMARY KEY CHECK (row = 1), served INTEGER NOT NULL, wall INTEGER NOT NULL) STRICT;
ALTER TABLE jobs ADD COLUMN ended INTEGER;
UPDATE jobs SET ended = finished;
DROP INDEX resources_by_use;
CREATE INDEX resources_by_use ON resources (collection, used, bytes);
)sql"};

constexpr std::array<std::pair<JobState, std::string_view>, 6> state_names = {{{JobState::queued, "queued"},
                                                                               {JobState::running, "running"},
                                                                               {JobState::succeeded, "succeeded"},
                                                                               {JobState::failed, "failed"},
                                                                               {JobState::cancelling, "cancelling"},
                                                                               {JobState::cancelled, "cancelled"}}};

// Stored by name, since numbers would shift when a code is added.
constexpr std::array<std::pair<ErrorCode, std::string_view>, 12> code_names = {
    {{ErrorCode::invalid_argument, "invalid_argument"},
     {ErrorCode::malformed, "malformed"},
     {ErrorCode::unknown_format, "unknown_format"},
     {ErrorCode::unusable, "unusable"},
     {ErrorCode::too_large, "too_large"},
     {ErrorCode::not_found, "not_found"},
     {ErrorCode::conflict, "conflict"},
     {ErrorCode::no_space, "no_space"},
     {ErrorCode::busy, "busy"},
     {ErrorCode::throttled, "throttled"},
     {ErrorCode::cancelled, "cancelled"},
     {ErrorCode::corrupt, "corrupt"}}};

template <typename Names, typename Value>
std::string_view name_of(const Names& names, Value value) {
  for (const auto& [known, name] : names)
    if (known == value) return name;
  SPHERULE_CHECK(false && "every value has a name");
  return {};
}

template <typename Names>
auto value_of(const Names& names, std::string_view text) {
  for (const auto& [value, name] : names)
    if (name == text) return value;
  throw_corrupt();
}

/// Cursors are the number of the last row that was seen.
std::int64_t parse_cursor(const std::string& cursor) {
  if (cursor.empty()) return std::numeric_limits<std::int64_t>::max();
  std::int64_t before = 0;
  const auto [end, error] = std::from_chars(cursor.data(), cursor.data() + cursor.size(), before);
  if (error != std::errc() || end != cursor.data() + cursor.size() || before <= 0) {
    const std::string sentence = "The cursor is not one that this server gave; start again without a cursor.";
    throw Error(ErrorCode::invalid_argument, sentence, {{"cursor", sentence}});
  }
  return before;
}

constexpr std::string_view resource_columns = "seq, id, collection, created, request, document, bytes, used";

Resource read_resource(Connection& database, const Statement& row) {
  Resource resource;
  resource.id = row.text(1);
  resource.collection = row.text(2);
  resource.created = row.time(3);
  resource.request = row.text(4);
  resource.document = row.text(5);
  resource.bytes = static_cast<std::uint64_t>(row.integer(6));
  resource.used = row.time(7);
  Statement inputs(database,
                   "SELECT r.id FROM inputs i JOIN resources r ON r.seq = i.input WHERE i.resource = ?"
                   " ORDER BY i.position",
                   row.integer(0));
  while (inputs.step()) resource.inputs.push_back(inputs.text(0));
  Statement blobs(database, "SELECT key FROM blobs WHERE resource = ? ORDER BY position", row.integer(0));
  while (blobs.step()) resource.blobs.push_back(blobs.text(0));
  return resource;
}

void touch_with_inputs(Connection& database, const std::string& id, Time when) {
  Statement(database,
            "WITH RECURSIVE line (seq) AS (SELECT seq FROM resources WHERE id = ?"
            " UNION SELECT i.input FROM inputs i JOIN line l ON i.resource = l.seq)"
            " UPDATE resources SET used = max(used, ?) WHERE seq IN line",
            id, when)
      .step();
}

bool insert_resource(Connection& database, const Resource& resource, Time created, Time used) {
  Statement(database,
            "INSERT INTO resources (id, collection, created, used, request, document, bytes)"
            " VALUES (?, ?, ?, ?, ?, ?, ?) ON CONFLICT (id) DO NOTHING",
            resource.id, resource.collection, created, used, resource.request, resource.document, resource.bytes)
      .step();
  if (database.changes() == 0) return false;
  const std::int64_t seq = database.last_row();
  for (int i = 0; const std::string& input : resource.inputs) {
    Statement(database, "INSERT INTO inputs (resource, position, input) SELECT ?, ?, seq FROM resources WHERE id = ?",
              seq, i++, input)
        .step();
    if (database.changes() == 0)
      throw Error(ErrorCode::conflict, "What this was to be made from has been deleted meanwhile; upload it again.");
  }
  for (int i = 0; const std::string& key : resource.blobs)
    Statement(database, "INSERT INTO blobs (resource, position, key) VALUES (?, ?, ?)", seq, i++, key).step();
  if (!resource.inputs.empty()) touch_with_inputs(database, resource.id, used);
  return true;
}

constexpr std::string_view job_columns =
    "seq, id, kind, result_id, request, state, stage, progress, attempts, crashes, created, started, finished,"
    " error_code, error_sentence, client, memory";

// Nothing for one that cannot be read: the job can be told of all the same.
std::optional<api::WorkRequest> request_in(const std::string& kind, const std::string& record) {
  try {
    return api::work_from(kind, record);
  } catch (const Error& error) {
    if (error.code() != ErrorCode::corrupt) throw;
    return std::nullopt;
  }
}

JobRecord read_job(Connection& database, const Statement& row) {
  JobRecord job;
  job.id = row.text(1);
  job.kind = row.text(2);
  job.result_id = row.text(3);
  job.request = request_in(job.kind, row.text(4));
  job.state = value_of(state_names, row.text(5));
  job.stage = row.text(6);
  job.progress = row.real(7);
  job.attempts = row.count(8);
  job.crashes = row.count(9);
  job.created = row.time(10);
  job.started = row.optional_time(11);
  job.finished = row.optional_time(12);
  if (!row.is_null(14)) {
    job.error.emplace();
    if (!row.is_null(13)) job.error->code = value_of(code_names, row.text(13));
    job.error->sentence = row.text(14);
  }
  job.client = row.text(15);
  job.memory_bytes = static_cast<std::uint64_t>(row.integer(16));
  Statement requesters(database, "SELECT client FROM requesters WHERE job = ?", row.integer(0));
  while (requesters.step()) job.requesters.insert(requesters.text(0));
  Statement warnings(database, "SELECT sentence FROM warnings WHERE job = ? ORDER BY position", row.integer(0));
  while (warnings.step()) job.warnings.push_back(warnings.text(0));
  return job;
}

/// `served` is the time of service at which it ends, if it does now.
void write_job(Connection& database, const JobRecord& job, Time served) {
  std::optional<std::string_view> code, sentence;
  if (job.error) sentence = job.error->sentence;
  if (job.error && job.error->code) code = name_of(code_names, *job.error->code);
  Statement(database,
            "UPDATE jobs SET state = ?, stage = ?, progress = ?, attempts = ?, crashes = ?, started = ?, finished = ?,"
            " error_code = ?, error_sentence = ?, memory = ?, ended = coalesce(ended, ?) WHERE id = ?",
            name_of(state_names, job.state), job.stage, job.progress, job.attempts, job.crashes, job.started,
            job.finished, code, sentence, job.memory_bytes, job.finished ? std::optional(served) : std::nullopt, job.id)
      .step();
  SPHERULE_CHECK(database.changes() == 1);
  // Rewritten whole: at most as many as clients and 100, a few times in a job's life.
  Statement(database, "DELETE FROM requesters WHERE job = (SELECT seq FROM jobs WHERE id = ?)", job.id).step();
  for (const std::string& client : job.requesters)
    Statement(database, "INSERT INTO requesters (job, client) SELECT seq, ? FROM jobs WHERE id = ?", client, job.id)
        .step();
  Statement(database, "DELETE FROM warnings WHERE job = (SELECT seq FROM jobs WHERE id = ?)", job.id).step();
  for (int i = 0; const std::string& sentence_of_warning : job.warnings)
    Statement(database, "INSERT INTO warnings (job, position, sentence) SELECT seq, ?, ? FROM jobs WHERE id = ?", i++,
              sentence_of_warning, job.id)
        .step();
}

void insert_job(Connection& database, const JobRecord& job, Time served) {
  Statement(
      database,
      "INSERT INTO jobs (id, kind, result_id, request, client, created, state, stage, progress, attempts, crashes)"
      " VALUES (?, ?, ?, ?, ?, ?, '', '', 0, 0, 0)",
      job.id, job.kind, job.result_id, job.request ? api::record_of(*job.request) : std::string(), job.client,
      job.created)
      .step();
  write_job(database, job, served);
}

/// The right to use a file, held by one object in one process.
class FileLock {
 public:
  explicit FileLock(const std::filesystem::path& file) {
    descriptor_ = ::open((file.native() + ".lock").c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    if (descriptor_ < 0) sqlite::throw_system(errno);
    // A predecessor may be just closing.
    const auto end = std::chrono::steady_clock::now() + std::chrono::milliseconds(500);
    while (::flock(descriptor_, LOCK_EX | LOCK_NB) != 0) {
      if (std::chrono::steady_clock::now() > end) {
        ::close(descriptor_);
        sqlite::throw_busy();
      }
      std::this_thread::sleep_for(std::chrono::milliseconds(10));
    }
  }
  ~FileLock() { ::close(descriptor_); }
  FileLock(const FileLock&) = delete;
  FileLock& operator=(const FileLock&) = delete;

 private:
  int descriptor_ = -1;
};

/// Of a file that is there; others may not even know what it holds.
void make_private(const std::filesystem::path& file) {
  std::error_code ignored;  // another owner's, or not there
  std::filesystem::permissions(file, std::filesystem::perms::owner_read | std::filesystem::perms::owner_write, ignored);
}

/// A connection that changes the file, which is made if needed, and that has found it whole.
class Writer {
 public:
  explicit Writer(const std::filesystem::path& file) : lock_(file), connection(file, Connection::Mode::create) {
    for (const char* end : {"", "-wal", "-shm", ".lock"}) make_private(file.native() + end);
    connection.run(
        "PRAGMA journal_mode = WAL; PRAGMA synchronous = FULL; PRAGMA foreign_keys = ON; PRAGMA trusted_schema = OFF");
    Statement check(connection, "PRAGMA quick_check(1)");
    if (!check.step() || check.text(0) != "ok") throw_corrupt();
  }

  void migrate() {
    Transaction transaction(connection);  // takes the lock, too
    const std::int64_t version = connection.number("PRAGMA user_version");
    const bool ours = connection.number("PRAGMA application_id") == application_id ||
                      (version == 0 && connection.number("SELECT count(*) FROM sqlite_schema") == 0);
    if (!ours || version < 0) throw_corrupt();
    if (version > static_cast<std::int64_t>(migrations.size()))
      throw Error(ErrorCode::conflict,
                  "A newer version of this server wrote the data folder; run that version, or choose another folder.");
    for (auto step = static_cast<std::size_t>(version); step < migrations.size(); ++step)
      connection.run(migrations[step]);
    connection.run(("PRAGMA application_id = " + std::to_string(application_id)).c_str());
    connection.run(("PRAGMA user_version = " + std::to_string(migrations.size())).c_str());
    transaction.commit();
  }

 private:
  FileLock lock_;  // outlives the connection

 public:
  Connection connection;
};
/// Part of the disk that is taken, so that it can be given back when nothing else is left of it.
class Room {
 public:
  explicit Room(const std::filesystem::path& catalog) : file_(catalog.native() + ".room") {}

  void take() const {
    const int file = ::open(file_.c_str(), O_RDWR | O_CREAT | O_CLOEXEC, 0600);
    const bool taken = file >= 0 && ::fallocate(file, 0, 0, bytes) == 0;
    if (file >= 0) ::close(file);
    if (!taken) give_back();
  }
  /// Whether there was any.
  bool give_back() const { return ::unlink(file_.c_str()) == 0; }

 private:
  // What a deletion writes before it frees anything: a log of a thousand pages, after which it starts over.
  static constexpr off_t bytes = 4 << 20;

  std::filesystem::path file_;
};

/// Where the time of service stands.
struct Stand {
  Time served, wall;
};

/// As it was noted, or its beginning.
Stand read_stand(Connection& database, Time wall) {
  if (Statement row(database, "SELECT served, wall FROM clock"); row.step()) return {row.time(0), row.time(1)};
  Transaction transaction(database);
  // Uses were noted by the wall's clock before; none is later than now.
  Statement(database, "UPDATE resources SET used = min(used, ?)", wall).step();
  Statement(database, "UPDATE jobs SET ended = min(ended, ?)", wall).step();
  Time served = wall;
  if (Statement last(database, "SELECT max(used) FROM resources"); last.step() && !last.is_null(0))
    served = last.time(0);
  Statement(database, "INSERT INTO clock (row, served, wall) VALUES (1, ?, ?)", served, wall).step();
  transaction.commit();
  return {served, wall};
}

}  // namespace

// A write waits for the disk, reads do not wait for writes: they have connections of their own (WAL). What a write has
// committed, the next read sees.
struct Catalog::State {
  State(const std::filesystem::path& file, Clocks given) : clocks(std::move(given)), room(file), writer(file) {
    writer.migrate();
    const auto steady = clocks.steady();  // first: the time of service is not to begin behind the wall's
    noted = read_stand(writer.connection, clocks.wall());
    began = steady - noted.served.time_since_epoch();
    for (std::size_t i = 0; i < reader_count; ++i)
      resting.push_back(std::make_unique<Connection>(file, Connection::Mode::read));
  }

  /// The connection that writes, for one thread.
  class Writing {
   public:
    explicit Writing(State& state) : lock_(state.writing), database(state.writer.connection) {}

   private:
    std::lock_guard<std::mutex> lock_;

   public:
    Connection& database;
  };

  /// One of those that read, for one thread.
  class Reading {
   public:
    explicit Reading(State& state) : state_(state), connection_(state.borrow()), database(*connection_) {}
    ~Reading() {
      {
        const std::lock_guard lock(state_.mutex);
        state_.resting.push_back(std::move(connection_));
      }
      state_.returned.notify_one();
    }
    Reading(const Reading&) = delete;
    Reading& operator=(const Reading&) = delete;

   private:
    State& state_;
    std::unique_ptr<Connection> connection_;

   public:
    Connection& database;
  };

  std::unique_ptr<Connection> borrow() {
    std::unique_lock lock(mutex);
    returned.wait(lock, [&] { return !resting.empty(); });
    std::unique_ptr<Connection> connection = std::move(resting.back());
    resting.pop_back();
    return connection;
  }

  Time served() const { return Time(clocks.steady() - began); }

  const Clocks clocks;
  const Room room;
  Writer writer;
  std::mutex writing;
  std::chrono::microseconds began{};  // by the steady clock, of the time of service
  Stand noted;                        // with `writing` held
  std::mutex mutex;                   // of what follows
  std::condition_variable returned;
  std::vector<std::unique_ptr<Connection>> resting;
};

Catalog::Catalog(const std::filesystem::path& file, Clocks clocks) {
  if (file.has_parent_path()) make_folder(file.parent_path());
  if (std::filesystem::is_directory(file)) throw_corrupt();
  try {
    state_ = std::make_unique<State>(file, clocks);
  } catch (const Error& error) {
    if (error.code() != ErrorCode::no_space || !Room(file).give_back()) throw;
    state_ = std::make_unique<State>(file, std::move(clocks));
  }
}

Catalog::~Catalog() = default;

void Catalog::reserve_room() {
  const State::Writing use(*state_);
  state_->room.take();
}

Time Catalog::served() const { return state_->served(); }

std::chrono::microseconds Catalog::note_time() {
  const State::Writing use(*state_);
  const Stand stand{state_->served(), state_->clocks.wall()};
  Statement(use.database, "UPDATE clock SET served = ?, wall = ?", stand.served, stand.wall).step();
  const auto moved = (stand.wall - state_->noted.wall) - (stand.served - state_->noted.served);
  state_->noted = stand;
  return moved;
}

bool Catalog::add(const Resource& resource) {
  const State::Writing use(*state_);
  Transaction transaction(use.database);
  const bool added = insert_resource(use.database, resource, state_->clocks.wall(), state_->served());
  if (added) transaction.commit();
  return added;
}

std::optional<Resource> Catalog::find(const std::string& id) const {
  const State::Reading use(*state_);
  Statement row(use.database, "SELECT " + std::string(resource_columns) + " FROM resources WHERE id = ?", id);
  if (!row.step()) return {};
  return read_resource(use.database, row);
}

namespace {

// One row more than the page tells whether there is a next one, without counting.
/// `row` yields rows in descending seq (column 0) with their ids (column 1), one more than `limit` when there are more.
template <typename T, typename Read>
Page<T> read_page(Statement& row, std::size_t limit, const Read& read) {
  Page<T> page;
  std::int64_t last = 0;
  while (row.step()) {
    if (page.items.size() + page.damaged.size() == limit) {
      page.next = std::to_string(last);
      break;
    }
    try {
      page.items.push_back(read(row));
    } catch (const Error& error) {
      if (error.code() != ErrorCode::corrupt) throw;
      page.damaged.push_back(row.text(1));
    }
    last = row.integer(0);
  }
  return page;
}

std::size_t clamp_limit(std::size_t limit) { return std::clamp<std::size_t>(limit, 1, 1'000'000); }

}  // namespace

Page<Resource> Catalog::list(const std::string& collection, const std::string& cursor, std::size_t limit) const {
  limit = clamp_limit(limit);
  const State::Reading use(*state_);
  Statement row(use.database,
                "SELECT " + std::string(resource_columns) +
                    " FROM resources WHERE collection = ? AND seq < ? ORDER BY seq DESC LIMIT ?",
                collection, parse_cursor(cursor), std::uint64_t{limit + 1});
  return read_page<Resource>(row, limit, [&](const Statement& r) { return read_resource(use.database, r); });
}

Page<Resource> Catalog::list_all(const std::string& cursor, std::size_t limit) const {
  limit = clamp_limit(limit);
  const State::Reading use(*state_);
  Statement row(use.database,
                "SELECT " + std::string(resource_columns) + " FROM resources WHERE seq < ? ORDER BY seq DESC LIMIT ?",
                parse_cursor(cursor), std::uint64_t{limit + 1});
  return read_page<Resource>(row, limit, [&](const Statement& r) { return read_resource(use.database, r); });
}

void Catalog::touch(const std::string& id) {
  const State::Writing use(*state_);
  touch_with_inputs(use.database, id, state_->served());
}

std::vector<std::string> Catalog::unused_since(const std::string& collection, Time before, std::size_t limit) const {
  const State::Reading use(*state_);
  Statement row(use.database, "SELECT id FROM resources WHERE collection = ? AND used < ? ORDER BY used LIMIT ?",
                collection, before, std::uint64_t{limit});
  std::vector<std::string> found;
  while (row.step()) found.push_back(row.text(0));
  return found;
}

std::vector<std::string> Catalog::over_budget(const std::string& collection, std::uint64_t most) const {
  const State::Reading use(*state_);
  std::uint64_t sum = 0;
  if (Statement all(use.database, "SELECT sum(bytes) FROM resources WHERE collection = ?", collection); all.step())
    sum = static_cast<std::uint64_t>(all.integer(0));
  Statement row(use.database, "SELECT id, bytes FROM resources WHERE collection = ? ORDER BY used", collection);
  std::vector<std::string> found;
  while (sum > most && row.step()) {
    found.push_back(row.text(0));
    sum -= std::min(sum, static_cast<std::uint64_t>(row.integer(1)));
  }
  return found;
}

namespace {

std::vector<std::string> erase_row(Connection& database, const std::string& id, const Catalog::BeforeErasing& before) {
  // UNION, not UNION ALL: something made from two descendants appears once.
  constexpr std::string_view doomed =
      "WITH RECURSIVE doomed (seq) AS (SELECT seq FROM resources WHERE id = ?"
      " UNION SELECT i.resource FROM inputs i JOIN doomed d ON i.input = d.seq) ";
  Transaction transaction(database);
  std::vector<std::string> keys;
  {
    Statement blobs(database,
                    std::string(doomed) + "SELECT key FROM blobs WHERE resource IN doomed ORDER BY resource, position",
                    id);
    while (blobs.step()) keys.push_back(blobs.text(0));
  }
  Statement(database, std::string(doomed) + "DELETE FROM resources WHERE seq IN doomed", id).step();
  if (database.changes() == 0)
    throw Error(ErrorCode::not_found, "There is nothing under this id; it may have been deleted.");
  if (before) before(keys);
  transaction.commit();
  return keys;
}

}  // namespace

std::vector<std::string> Catalog::erase(const std::string& id, const BeforeErasing& before) {
  const State::Writing use(*state_);
  try {
    return erase_row(use.database, id, before);
  } catch (const Error& error) {
    if (error.code() != ErrorCode::no_space || !state_->room.give_back()) throw;
    return erase_row(use.database, id, before);
  }
}

bool Catalog::holds(const std::string& id, const std::string& collection) const {
  const State::Reading use(*state_);
  return Statement(use.database, "SELECT 1 FROM resources WHERE id = ? AND collection = ?", id, collection).step();
}

bool Catalog::owns_blob(const std::string& key) const {
  const State::Reading use(*state_);
  return Statement(use.database, "SELECT 1 FROM blobs WHERE key = ?", key).step();
}

void Catalog::add_job(const JobRecord& job) {
  const State::Writing use(*state_);
  Transaction transaction(use.database);
  insert_job(use.database, job, state_->served());
  transaction.commit();
}

void Catalog::update_job(const JobRecord& job) {
  const State::Writing use(*state_);
  Transaction transaction(use.database);
  write_job(use.database, job, state_->served());
  transaction.commit();
}

bool Catalog::complete_job(const JobRecord& job, const Resource& result) {
  const State::Writing use(*state_);
  Transaction transaction(use.database);
  // A result that is there already is as good: the same id is the same thing.
  const bool added = insert_resource(use.database, result, state_->clocks.wall(), state_->served());
  write_job(use.database, job, state_->served());
  transaction.commit();
  return added;
}

std::optional<JobRecord> Catalog::find_job(const std::string& id) const {
  const State::Reading use(*state_);
  Statement row(use.database, "SELECT " + std::string(job_columns) + " FROM jobs WHERE id = ?", id);
  if (!row.step()) return {};
  return read_job(use.database, row);
}

Page<JobRecord> Catalog::list_jobs(const std::string& cursor, std::size_t limit) const {
  limit = clamp_limit(limit);
  const State::Reading use(*state_);
  Statement row(use.database,
                "SELECT " + std::string(job_columns) + " FROM jobs WHERE seq < ? ORDER BY seq DESC LIMIT ?",
                parse_cursor(cursor), std::uint64_t{limit + 1});
  return read_page<JobRecord>(row, limit, [&](const Statement& r) { return read_job(use.database, r); });
}

std::vector<JobRecord> Catalog::unfinished_jobs() const {
  const State::Reading use(*state_);
  Statement row(use.database, "SELECT " + std::string(job_columns) + " FROM jobs WHERE finished IS NULL ORDER BY seq");
  return read_page<JobRecord>(row, std::numeric_limits<std::size_t>::max(),
                              [&](const Statement& r) { return read_job(use.database, r); })
      .items;
}

std::size_t Catalog::forget_jobs(Time ended_before) {
  const State::Writing use(*state_);
  Statement(use.database, "DELETE FROM jobs WHERE ended < ?", ended_before).step();
  return static_cast<std::size_t>(use.database.changes());
}

std::vector<std::string> Catalog::damaged_jobs() const {
  const State::Reading use(*state_);
  Statement row(use.database, "SELECT " + std::string(job_columns) + " FROM jobs ORDER BY seq DESC");
  return read_page<JobRecord>(row, std::numeric_limits<std::size_t>::max(),
                              [&](const Statement& r) { return read_job(use.database, r); })
      .damaged;
}

void Catalog::forget_job(const std::string& id) {
  const State::Writing use(*state_);
  Statement(use.database, "DELETE FROM jobs WHERE id = ?", id).step();
}

void Catalog::verify() const {
  const State::Writing use(*state_);
  Statement whole(use.database, "PRAGMA integrity_check(1)");
  if (!whole.step() || whole.text(0) != "ok") throw_corrupt();
  if (Statement(use.database, "PRAGMA foreign_key_check").step()) throw_corrupt();
}

void copy_catalog(const std::filesystem::path& from, const std::filesystem::path& to) {
  SPHERULE_CHECK(!std::filesystem::exists(to));
  Connection source(from, Connection::Mode::write), copy(to, Connection::Mode::create);
  source.copy(copy);
}

namespace {

/// Calls `read(number)` for each number up to the table's last; returns for how many it threw corrupt or conflict.
template <typename Read>
std::size_t read_rows(Connection& source, const char* last_row, const Read& read) {
  std::int64_t last = 1'000'000;  // when not even that can be read
  try {
    last = source.number(last_row);
  } catch (const Error&) {
  }
  std::size_t failed = 0;
  for (std::int64_t seq = 1; seq <= last; ++seq) try {
      read(seq);
    } catch (const Error& error) {
      if (error.code() != ErrorCode::corrupt && error.code() != ErrorCode::conflict) throw;
      ++failed;
    }
  return failed;
}

}  // namespace

namespace {

/// Without it, the time of service begins anew, at the last use.
void salvage_clock(Connection& source, Connection& fresh) try {
  if (Statement row(source, "SELECT served, wall FROM clock"); row.step())
    Statement(fresh, "INSERT INTO clock (row, served, wall) VALUES (1, ?, ?)", row.time(0), row.time(1)).step();
} catch (const Error& error) {
  if (error.code() != ErrorCode::corrupt) throw;
}

}  // namespace

Salvage salvage_catalog(const std::filesystem::path& damaged, const std::filesystem::path& to) {
  SPHERULE_CHECK(!std::filesystem::exists(to));
  const FileLock lock(damaged);
  Connection source(damaged, Connection::Mode::write);
  if (source.number("PRAGMA user_version") != static_cast<std::int64_t>(migrations.size()) ||
      source.number("PRAGMA application_id") != application_id)
    throw_corrupt();
  Writer made(to);
  made.migrate();
  Connection& fresh = made.connection;
  fresh.run("PRAGMA synchronous = OFF");  // until the end: a crash leaves the damaged file in its place
  Salvage salvage;
  // Point look-ups by row number: a damaged page costs its own rows and no others. Inputs have lower numbers.
  salvage.lost += read_rows(source, "SELECT seq FROM sqlite_sequence WHERE name = 'resources'", [&](std::int64_t seq) {
    Statement row(source, "SELECT " + std::string(resource_columns) + " FROM resources WHERE seq = ?", seq);
    if (!row.step()) return;
    const Resource resource = read_resource(source, row);
    Transaction transaction(fresh);
    salvage.resources += insert_resource(fresh, resource, resource.created, resource.used);
    transaction.commit();
  });
  salvage.lost += read_rows(source, "SELECT seq FROM sqlite_sequence WHERE name = 'jobs'", [&](std::int64_t seq) {
    Statement row(source, "SELECT " + std::string(job_columns) + " FROM jobs WHERE seq = ?", seq);
    if (!row.step()) return;
    const JobRecord job = read_job(source, row);
    Transaction transaction(fresh);
    insert_job(fresh, job, job.finished.value_or(Time()));
    transaction.commit();
    ++salvage.jobs;
  });
  salvage_clock(source, fresh);
  fresh.run("PRAGMA synchronous = FULL; PRAGMA wal_checkpoint(TRUNCATE)");
  return salvage;
}

namespace {

void remove_all(BlobStore& blobs, const std::vector<std::string>& keys) {
  for (const std::string& key : keys) try {
      blobs.remove(key);
    } catch (const Error&) {
      // Nobody owns it any more, so the next start removes it.
    }
}

}  // namespace

bool publish(Catalog& catalog, BlobStore& blobs, const Resource& resource) {
  try {
    const bool added = catalog.add(resource);
    if (added) settle_all(blobs, resource.blobs);
    if (!added) remove_all(blobs, resource.blobs);
    return added;
  } catch (const Error& error) {
    // After an I/O error the row may yet turn out to be there; then its blobs must be, too.
    if (error.code() != ErrorCode::corrupt) remove_all(blobs, resource.blobs);
    throw;
  }
}

void settle_all(BlobStore& blobs, const std::vector<std::string>& keys) {
  for (const std::string& key : keys) blobs.settle(key);
}

std::vector<std::string> withdraw(Catalog& catalog, BlobStore& blobs, const std::string& id) {
  std::vector<std::string> keys;
  try {
    keys = catalog.erase(id, [&](const std::vector<std::string>& doomed) {
      keys = doomed;
      blobs.unsettle(doomed);
    });
  } catch (const Error& error) {
    // After an I/O error it may be gone all the same.
    if (error.code() != ErrorCode::corrupt) settle_all(blobs, keys);
    throw;
  }
  remove_all(blobs, keys);
  return keys;
}

void throw_lost_catalogue() {
  throw Error(ErrorCode::corrupt,
              "Most of the stored data is unknown to the catalogue, which is missing or older than the data; put back "
              "the catalogue that belongs to it, or move this data to the folder `damaged` with `spheruled fsck "
              "--repair`.");
}

void sort_out_orphans(const Catalog& catalog, BlobStore& blobs,
                      const std::function<void(const std::string& key)>& set_aside) {
  const std::vector<std::string> known_travellers = blobs.unsettled();
  const std::set<std::string> travelling(known_travellers.begin(), known_travellers.end());
  std::vector<std::string> unknown, left;
  std::size_t owned = 0;
  for (std::string& key : blobs.keys()) {
    if (catalog.owns_blob(key))
      ++owned;
    else
      (travelling.contains(key) ? left : unknown).push_back(std::move(key));
  }
  if (unknown.size() > owned) throw_lost_catalogue();
  std::ranges::for_each(unknown, set_aside);
  remove_all(blobs, left);
  // Of owned ones, and of those that never came or are gone, nothing is left to be said.
  for (const std::string& key : known_travellers)
    if (std::ranges::find(left, key) == left.end()) blobs.settle(key);
}

}  // namespace spherule::server
