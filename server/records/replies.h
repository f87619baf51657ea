// SPDX-License-Identifier: GPL-3.0-or-later
//
// What clients that send an Idempotency-Key were answered, so that the same request again gets the same answer.
#pragma once

#include <chrono>
#include <filesystem>
#include <mutex>
#include <optional>
#include <set>
#include <string>
#include <string_view>

#include "server/bytes/aside.h"

namespace spherule::server {

/// One small file a key, named by the key's digest, holding the reply's digest, a line break, and the reply; durable.
/// Its time is the time of service at which it was written. Thread safe.
class ReplyBook {
 public:
  /// Makes the folder if needed. Replies are forgotten `keep` after they were written.
  ReplyBook(std::filesystem::path folder, std::chrono::seconds keep, Surroundings around = {});

  /// The reply that was kept under this key. Without one, the key is reserved for the caller until keep() or release();
  /// a damaged one is set aside, and is none. Throws conflict when another caller has reserved it.
  std::optional<std::string> recall(const std::string& key);
  void keep(const std::string& key, const std::string& reply);
  void release(const std::string& key);

 private:
  std::filesystem::path file(const std::string& key) const;
  bool is_old(const std::filesystem::path& file) const;
  void sweep();

  const std::filesystem::path folder_;
  const std::chrono::seconds keep_;
  const Surroundings around_;
  std::mutex mutex_;
  std::set<std::string> reserved_;
  std::chrono::steady_clock::time_point swept_{};
};

/// The reply in a file of the book; nothing when the file is damaged.
std::optional<std::string> reply_in(std::string_view file);

}  // namespace spherule::server
