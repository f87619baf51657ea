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

namespace spherule::server {

/// One small file a key, named by the key's digest; durable. Thread safe.
class ReplyBook {
 public:
  /// Makes the folder if needed. Replies are forgotten `keep` after they were written.
  ReplyBook(std::filesystem::path folder, std::chrono::seconds keep);

  /// The reply that was kept under this key. Without one, the key is reserved for the caller until keep() or release().
  /// Throws conflict when another caller has reserved it.
  std::optional<std::string> recall(const std::string& key);
  void keep(const std::string& key, const std::string& reply);
  void release(const std::string& key);

 private:
  std::filesystem::path file(const std::string& key) const;
  void sweep();

  const std::filesystem::path folder_;
  const std::chrono::seconds keep_;
  std::mutex mutex_;
  std::set<std::string> reserved_;
  std::chrono::steady_clock::time_point swept_{};
};

}  // namespace spherule::server
