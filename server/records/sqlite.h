// SPDX-License-Identifier: GPL-3.0-or-later
//
// SQLite as catalog.cpp writes its SQL with: connections, statements that are prepared once a connection, transactions,
// and SQLite's errors in the words of core/base/error.h.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <map>
#include <optional>
#include <string>
#include <string_view>
#include <vector>

#include "server/base/clock.h"

struct sqlite3;
struct sqlite3_stmt;

namespace spherule::server::sqlite {

/// For a file that is damaged.
[[noreturn]] void throw_corrupt();
/// For a file that another process has.
[[noreturn]] void throw_busy();
/// For a file that cannot be used, with the system's reason.
[[noreturn]] void throw_system(int error_number);

/// Used by one thread at a time. Every function may throw corrupt (the file is damaged, or cannot be used), no_space
/// and busy.
class Connection {
 public:
  enum class Mode { read, write, create };

  Connection(const std::filesystem::path& file, Mode mode);
  ~Connection();
  Connection(const Connection&) = delete;
  Connection& operator=(const Connection&) = delete;

  /// Statements without results, with semicolons between.
  void run(const char* script);

  /// The first column of the first row, 0 when there is none.
  std::int64_t number(const char* query);

  /// Rows that the last statement changed.
  [[nodiscard]] int changes() const;
  /// The number of the row that was inserted last.
  [[nodiscard]] std::int64_t last_row() const;

  /// Makes `to` the same, as this is at one moment.
  void copy(Connection& to);

 private:
  friend class Statement;
  friend class Transaction;
  sqlite3_stmt* take(std::string_view sql);

  sqlite3* database_ = nullptr;
  // Preparing takes several times as long as looking a row up. By text; those in use are not here.
  std::map<std::string, std::vector<sqlite3_stmt*>, std::less<>> prepared_;
};

/// One run of a statement; parameters are bound in order, columns read by index.
class Statement {
 public:
  template <typename... Values>
  Statement(Connection& connection, std::string_view sql, const Values&... values)
      : connection_(connection), sql_(sql), statement_(connection.take(sql)) {
    int index = 0;
    (bind(++index, values), ...);
  }
  ~Statement();
  Statement(const Statement&) = delete;
  Statement& operator=(const Statement&) = delete;

  /// True when there is a row to read.
  bool step();

  [[nodiscard]] bool is_null(int column) const;
  [[nodiscard]] std::int64_t integer(int column) const;
  [[nodiscard]] double real(int column) const;
  [[nodiscard]] std::string text(int column) const;
  [[nodiscard]] unsigned count(int column) const { return static_cast<unsigned>(integer(column)); }
  /// Throws corrupt for what is no time within the ranges of all clocks of the program.
  [[nodiscard]] Time time(int column) const;
  [[nodiscard]] std::optional<Time> optional_time(int column) const {
    return is_null(column) ? std::nullopt : std::optional(time(column));
  }

 private:
  void bind(int index, std::string_view text);
  void bind(int index, const char* text) { bind(index, std::string_view(text)); }
  void bind(int index, const std::string& text) { bind(index, std::string_view(text)); }
  void bind(int index, std::int64_t value);
  void bind(int index, std::uint64_t value) { bind(index, static_cast<std::int64_t>(value)); }
  void bind(int index, int value) { bind(index, std::int64_t{value}); }
  void bind(int index, unsigned value) { bind(index, std::int64_t{value}); }
  void bind(int index, double value);
  void bind(int index, Time value) { bind(index, std::int64_t{value.time_since_epoch().count()}); }
  template <typename T>
  void bind(int index, const std::optional<T>& value) {
    if (value) bind(index, *value);  // what is not bound is NULL
  }
  void check(int result) const;

  Connection& connection_;
  std::string sql_;
  sqlite3_stmt* statement_;
};

/// Undone by the destructor unless committed.
class Transaction {
 public:
  // IMMEDIATE: a lock that cannot be had is reported here, never in the middle.
  explicit Transaction(Connection& connection) : connection_(connection) {
    Statement(connection, "BEGIN IMMEDIATE").step();
  }
  ~Transaction();
  Transaction(const Transaction&) = delete;
  Transaction& operator=(const Transaction&) = delete;

  void commit() { Statement(connection_, "COMMIT").step(); }

 private:
  Connection& connection_;
};

}  // namespace spherule::server::sqlite
