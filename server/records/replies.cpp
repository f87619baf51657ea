// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/replies.h"

#include <fstream>
#include <iterator>

#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/base/disk.h"

namespace spherule::server {

namespace fs = std::filesystem;

std::optional<std::string> reply_in(std::string_view file) {
  const std::size_t line = file.find('\n');
  if (line == file.npos || sha256_hex(file.substr(line + 1)) != file.substr(0, line)) return std::nullopt;
  return std::string(file.substr(line + 1));
}

ReplyBook::ReplyBook(fs::path folder, std::chrono::seconds keep, Surroundings around)
    : folder_(std::move(folder)), keep_(keep), around_(std::move(around)) {
  make_folder(folder_);
}

fs::path ReplyBook::file(const std::string& key) const { return folder_ / sha256_hex(key); }

std::optional<std::string> ReplyBook::recall(const std::string& key) {
  const std::lock_guard lock(mutex_);
  sweep();
  const fs::path path = file(key);
  if (std::ifstream in(path, std::ios::binary); in && !is_old(path)) {
    if (auto reply = reply_in(std::string(std::istreambuf_iterator<char>(in), {}))) return reply;
    if (around_.set_aside) around_.set_aside(path);
  }
  if (!reserved_.insert(key).second) {
    throw Error(ErrorCode::conflict, "A request with this Idempotency-Key is under way; wait for its answer.");
  }
  return std::nullopt;
}

void ReplyBook::keep(const std::string& key, const std::string& reply) {
  write_durably(file(key), sha256_hex(reply) + "\n" + reply, around_.served());
  release(key);
}

void ReplyBook::release(const std::string& key) {
  const std::lock_guard lock(mutex_);
  reserved_.erase(key);
}

bool ReplyBook::is_old(const fs::path& file) const {
  const std::optional<Time> written = file_time(file);
  return written && around_.served() - *written > keep_;
}

// With the mutex held; once a minute at most.
void ReplyBook::sweep() {
  const auto now = std::chrono::steady_clock::now();
  if (now - swept_ < std::chrono::minutes(1)) return;
  swept_ = now;
  std::error_code ignored;
  for (const auto& entry : fs::directory_iterator(folder_, ignored)) {
    if (is_old(entry.path())) fs::remove(entry.path(), ignored);
  }
}

}  // namespace spherule::server
