// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/log.h"

#include <fcntl.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <cerrno>
#include <charconv>
#include <chrono>
#include <cstdio>
#include <ctime>
#include <utility>

#include "core/base/error.h"
#include "server/base/disk.h"

namespace spherule::server {

namespace {

// RFC 8259's escapes. Bytes past ASCII stay as they are: our own texts are UTF-8.
void append_quoted(std::string& out, std::string_view text) {
  out += '"';
  for (const char c : text) {
    if (c == '"' || c == '\\') {
      out += {'\\', c};
    } else if (static_cast<unsigned char>(c) < 0x20) {
      out += {'\\', 'u', '0', '0', static_cast<char>('0' + (c >> 4)), "0123456789abcdef"[c & 15]};
    } else {
      out += c;
    }
  }
  out += '"';
}

std::string timestamp() {
  using namespace std::chrono;
  const auto now = time_point_cast<microseconds>(system_clock::now());
  const std::time_t second = system_clock::to_time_t(floor<seconds>(now));
  std::tm utc{};
  ::gmtime_r(&second, &utc);
  std::array<char, 40> text{};
  const std::size_t length = std::strftime(text.data(), text.size(), "%FT%T", &utc);
  const int fraction = std::snprintf(text.data() + length, text.size() - length, ".%06dZ",
                                     static_cast<int>((now - floor<seconds>(now)).count()));
  return {text.data(), length + static_cast<std::size_t>(fraction)};
}

bool write_whole(int descriptor, std::string_view bytes) {
  while (!bytes.empty()) {
    const ssize_t put = ::write(descriptor, bytes.data(), bytes.size());
    if (put < 0 && errno == EINTR) continue;
    if (put < 0) return false;
    bytes.remove_prefix(static_cast<std::size_t>(put));
  }
  return true;
}

}  // namespace

LogLine::LogLine(std::string_view event) : text_("{\"time\":\"" + timestamp() + "\"") { add("event", event); }

void LogLine::name(std::string_view name) {
  text_ += ',';
  append_quoted(text_, name);
  text_ += ':';
}

LogLine& LogLine::add(std::string_view name, std::string_view value) {
  this->name(name);
  append_quoted(text_, value);
  return *this;
}

LogLine& LogLine::add(std::string_view name, std::int64_t value) {
  this->name(name);
  text_ += std::to_string(value);
  return *this;
}

LogLine& LogLine::add(std::string_view name, double value) {
  this->name(name);
  std::array<char, 32> digits{};
  const auto [end, error] =
      std::to_chars(digits.data(), digits.data() + digits.size(), value, std::chars_format::fixed, 6);
  text_ += error == std::errc() ? std::string_view(digits.data(), end) : "null";
  return *this;
}

void log(const LogLine& line) { write_whole(STDERR_FILENO, line.text()); }

std::string trace_of(const api::Request& request) {
  // version "-" trace "-" parent "-" flags; later versions may append more.
  const std::string_view text = request.header("traceparent");
  const auto hex = [&](std::size_t from, std::size_t count) {
    const std::string_view digits = text.substr(from, count);
    return std::ranges::all_of(digits, [](char c) { return (c >= '0' && c <= '9') || (c >= 'a' && c <= 'f'); }) &&
           digits.find_first_not_of('0') != std::string_view::npos;
  };
  const bool good = text.size() >= 55 && text[2] == '-' && text[35] == '-' && text[52] == '-' &&
                    !text.starts_with("ff") && hex(3, 32) && hex(36, 16);
  return good ? std::string(text.substr(3, 32)) : std::string();
}

class AppendLog::File {
 public:
  explicit File(const std::filesystem::path& path)
      : descriptor_(::open(path.c_str(), O_WRONLY | O_CREAT | O_APPEND | O_CLOEXEC, 0600)) {
    // Lines that are durable in a file that has no name are lost.
    if (usable()) try {
        sync_to_disk(std::filesystem::absolute(path).parent_path());
      } catch (const Error&) {
        // A folder that may be written but not read: its owner's choice.
      }
  }
  ~File() {
    if (descriptor_ >= 0) ::close(descriptor_);
  }
  File(const File&) = delete;
  File& operator=(const File&) = delete;

  bool usable() const { return descriptor_ >= 0; }

  /// Whether the path still names this file.
  bool is_at(const std::filesystem::path& path) const {
    struct stat opened {
    }, named{};
    return usable() && ::fstat(descriptor_, &opened) == 0 && ::stat(path.c_str(), &named) == 0 &&
           opened.st_ino == named.st_ino && opened.st_dev == named.st_dev;
  }

  bool write(std::string_view text) {
    if (!write_whole(descriptor_, text)) return false;
    ++written_;
    return true;
  }

  /// Returns once all that was written before is on the disk.
  bool sync() {
    const std::uint64_t wanted = written_;
    const std::lock_guard lock(syncing_);
    if (lost_ >= wanted) return false;
    if (synced_ >= wanted) return true;
    const std::uint64_t reached = written_;
    const bool good = ::fdatasync(descriptor_) == 0;
    // The kernel tells of a failure once, and forgets what it could not write.
    (good ? synced_ : lost_) = reached;
    return good;
  }

 private:
  const int descriptor_;
  std::atomic<std::uint64_t> written_{0};  // lines
  std::mutex syncing_;
  std::uint64_t synced_ = 0, lost_ = 0;  // up to which of them
};

AppendLog::AppendLog(std::filesystem::path path) : path_(std::move(path)) {
  if (path_.has_parent_path()) make_folder(path_.parent_path());
  if (!current()->usable()) {
    throw Error(ErrorCode::corrupt, "The audit log cannot be written; check its folder and its permissions.");
  }
}

AppendLog::~AppendLog() = default;

std::shared_ptr<AppendLog::File> AppendLog::current() {
  if (!file_ || !file_->is_at(path_)) file_ = std::make_shared<File>(path_);
  return file_;
}

bool AppendLog::append(const LogLine& line, bool durable) {
  std::shared_ptr<File> file;
  {
    const std::lock_guard lock(mutex_);
    file = current();
    if (!file->usable() || !file->write(line.text())) return false;
  }
  return !durable || file->sync();
}

}  // namespace spherule::server
