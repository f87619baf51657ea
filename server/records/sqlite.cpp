// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/sqlite.h"

#include <sqlite3.h>

#include <cerrno>
#include <limits>
#include <new>
#include <stdexcept>

#include "core/base/error.h"

namespace spherule::server::sqlite {

void throw_corrupt() {
  throw Error(ErrorCode::corrupt,
              "The server's catalogue is damaged or not a catalogue; restore a backup, or save what can be read with "
              "`spheruled fsck --repair`.");
}

void throw_busy() {
  throw Error(ErrorCode::busy, "Another server uses this data folder; stop it, or choose another folder.");
}

void throw_system(int error_number) {
  if (error_number == ENOSPC) {
    throw Error(ErrorCode::no_space, "The server's storage is full; delete what is no longer needed, or try later.");
  }
  throw Error(
      ErrorCode::corrupt,
      "The server cannot use its storage; its operator must check the data folder, its permissions and its disk.");
}

namespace {

// Throws what a result code means; `database` may be null.
[[noreturn]] void throw_error(sqlite3* database, int result) {
  switch (result & 0xff) {
    case SQLITE_CORRUPT:
    case SQLITE_NOTADB:
    case SQLITE_FORMAT: throw_corrupt();
    case SQLITE_FULL: throw_system(ENOSPC);
    case SQLITE_BUSY:
    case SQLITE_LOCKED: throw_busy();
    case SQLITE_IOERR:
    case SQLITE_CANTOPEN:
    case SQLITE_READONLY:
    case SQLITE_PERM: throw_system(EIO);
    case SQLITE_NOMEM: throw std::bad_alloc();
    default: throw std::logic_error(std::string("catalogue: ") + sqlite3_errmsg(database));
  }
}

}  // namespace

Connection::Connection(const std::filesystem::path& file, Mode mode) {
  const int access = mode == Mode::read    ? SQLITE_OPEN_READONLY
                     : mode == Mode::write ? SQLITE_OPEN_READWRITE
                                           : SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE;
  const int result = sqlite3_open_v2(file.c_str(), &database_, access | SQLITE_OPEN_NOMUTEX, nullptr);
  if (result != SQLITE_OK) {
    sqlite3_close(database_);
    throw_error(nullptr, result);
  }
  sqlite3_busy_timeout(database_, 5000);  // ms: a backup that reads, or a server that writes beside one
}

Connection::~Connection() {
  for (const auto& [sql, statements] : prepared_)
    for (sqlite3_stmt* statement : statements) sqlite3_finalize(statement);
  sqlite3_close(database_);
}

void Connection::run(const char* script) {
  const int result = sqlite3_exec(database_, script, nullptr, nullptr, nullptr);
  if (result != SQLITE_OK) throw_error(database_, result);
}

std::int64_t Connection::number(const char* query) {
  Statement statement(*this, query);
  return statement.step() ? statement.integer(0) : 0;
}

int Connection::changes() const { return sqlite3_changes(database_); }

std::int64_t Connection::last_row() const { return sqlite3_last_insert_rowid(database_); }

void Connection::copy(Connection& to) {
  sqlite3_backup* backup = sqlite3_backup_init(to.database_, "main", database_, "main");
  if (backup == nullptr) throw_error(to.database_, sqlite3_errcode(to.database_));
  // All pages in one step: a reader of a write-ahead log holds up nobody.
  sqlite3_backup_step(backup, -1);
  const int result = sqlite3_backup_finish(backup);
  if (result != SQLITE_OK) throw_error(to.database_, result);
}

sqlite3_stmt* Connection::take(std::string_view sql) {
  if (const auto known = prepared_.find(sql); known != prepared_.end() && !known->second.empty()) {
    sqlite3_stmt* statement = known->second.back();
    known->second.pop_back();
    return statement;
  }
  sqlite3_stmt* statement = nullptr;
  const int result = sqlite3_prepare_v3(database_, sql.data(), static_cast<int>(sql.size()), SQLITE_PREPARE_PERSISTENT,
                                        &statement, nullptr);
  if (result != SQLITE_OK) throw_error(database_, result);
  return statement;
}

Statement::~Statement() {
  // Ends what it began, also the view of the file that a reader has.
  sqlite3_reset(statement_);
  sqlite3_clear_bindings(statement_);
  try {
    connection_.prepared_[sql_].push_back(statement_);
  } catch (const std::bad_alloc&) {
    sqlite3_finalize(statement_);
  }
}

bool Statement::step() {
  const int result = sqlite3_step(statement_);
  if (result != SQLITE_ROW && result != SQLITE_DONE) throw_error(connection_.database_, result);
  return result == SQLITE_ROW;
}

bool Statement::is_null(int column) const { return sqlite3_column_type(statement_, column) == SQLITE_NULL; }
std::int64_t Statement::integer(int column) const { return sqlite3_column_int64(statement_, column); }
Time Statement::time(int column) const {
  // Counted in nanoseconds, as the system's clock does, it must fit 64 bits.
  constexpr std::int64_t latest = std::numeric_limits<std::int64_t>::max() / 1000;
  const std::int64_t microseconds = integer(column);
  if (microseconds < -latest || microseconds > latest) throw_corrupt();
  return Time(std::chrono::microseconds(microseconds));
}
double Statement::real(int column) const { return sqlite3_column_double(statement_, column); }
std::string Statement::text(int column) const {
  // As a blob, so that zero bytes within are kept.
  const void* bytes = sqlite3_column_blob(statement_, column);
  return {static_cast<const char*>(bytes),
          bytes ? static_cast<std::size_t>(sqlite3_column_bytes(statement_, column)) : 0};
}

void Statement::bind(int index, std::string_view text) {
  // A null pointer would bind NULL, not the empty text.
  check(sqlite3_bind_text64(statement_, index, text.empty() ? "" : text.data(), text.size(), SQLITE_TRANSIENT,
                            SQLITE_UTF8));
}
void Statement::bind(int index, std::int64_t value) { check(sqlite3_bind_int64(statement_, index, value)); }
void Statement::bind(int index, double value) { check(sqlite3_bind_double(statement_, index, value)); }

void Statement::check(int result) const {
  if (result != SQLITE_OK) throw_error(connection_.database_, result);
}

Transaction::~Transaction() {
  // A full disk may have rolled back already.
  sqlite3* database = connection_.database_;
  if (!sqlite3_get_autocommit(database)) sqlite3_exec(database, "ROLLBACK", nullptr, nullptr, nullptr);
}

}  // namespace spherule::server::sqlite
