// SPDX-License-Identifier: GPL-3.0-or-later
//
// Log lines: one JSON object a line, written with one write(2), so that lines of several threads and processes never
// mix. What is logged is made by this program (ids, route templates, numbers, sentences of our own); text of a client,
// which may name a patient, has no way in.
#pragma once

#include <cstdint>
#include <filesystem>
#include <memory>
#include <mutex>
#include <string>
#include <string_view>

#include "api/http/http.h"

namespace spherule::server {

/// A line in the making: `{"time":"2026-11-26T17:42:19.123456Z","event":"request",…}`.
class LogLine {
 public:
  explicit LogLine(std::string_view event);

  LogLine& add(std::string_view name, std::string_view value);
  LogLine& add(std::string_view name, const char* value) { return add(name, std::string_view(value)); }
  LogLine& add(std::string_view name, std::int64_t value);
  LogLine& add(std::string_view name, double value);
  /// Leaves an empty text out.
  LogLine& add_if(std::string_view name, std::string_view value) { return value.empty() ? *this : add(name, value); }

  /// With its line break.
  [[nodiscard]] std::string text() const { return text_ + "}\n"; }

 private:
  void name(std::string_view name);
  std::string text_;
};

/// Writes to stderr, whose reader (journald, a container's runtime) keeps and rotates it.
void log(const LogLine& line);

/// The trace that a request belongs to: 32 hex digits of a well-formed W3C `traceparent`, else empty.
std::string trace_of(const api::Request& request);

/// A file that lines are appended to: the audit log. Thread safe. Rotation: rename the file, or remove it; the next
/// line starts a new one under the old name.
class AppendLog {
 public:
  /// Opens or makes the file. Throws corrupt when that cannot be.
  explicit AppendLog(std::filesystem::path path);
  ~AppendLog();
  AppendLog(const AppendLog&) = delete;
  AppendLog& operator=(const AppendLog&) = delete;

  /// Appends in one write(2); with `durable`, returns once the line is on the disk. False when it could not. Lines that
  /// need not be durable do not wait for those that do, and these go to the disk together.
  bool append(const LogLine& line, bool durable);

 private:
  class File;
  /// Also after a rotation, for whoever still has lines in it to make durable.
  std::shared_ptr<File> current();

  const std::filesystem::path path_;
  std::mutex mutex_;
  std::shared_ptr<File> file_;
};

}  // namespace spherule::server
