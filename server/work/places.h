// SPDX-License-Identifier: GPL-3.0-or-later
//
// Places that requests hold for long, such as those that wait for a job: bounded, and never all one client's.
#pragma once

#include <cstddef>
#include <map>
#include <memory>
#include <mutex>
#include <string>
#include <utility>

namespace spherule::server {

/// Thread safe. O(log clients).
///
/// A client may take one more place while it holds fewer than are free. So one that is alone gets half of them, the
/// next one half of the rest, and whoever comes with none always finds one until there are more such clients than
/// places halve to (dynamic thresholds; Choudhury, Hahne, IEEE/ACM Transactions on Networking 6(2), 1998).
class Places {
 public:
  explicit Places(std::size_t all) : free_(all) {}
  Places(const Places&) = delete;
  Places& operator=(const Places&) = delete;

  /// Gives its place back at the end. Does not outlive the places.
  class Place {
   public:
    Place(Places& of, std::string client) : of_(of), client_(std::move(client)) {}
    ~Place() { of_.give_back(client_); }
    Place(const Place&) = delete;
    Place& operator=(const Place&) = delete;

   private:
    Places& of_;
    const std::string client_;
  };

  /// Null when there is none for this client.
  std::unique_ptr<Place> take(const std::string& client) {
    const std::lock_guard lock(mutex_);
    const auto held = held_.find(client);
    if ((held == held_.end() ? 0 : held->second) >= free_) return nullptr;
    auto place = std::make_unique<Place>(*this, client);
    ++held_[client];
    --free_;
    return place;
  }

 private:
  void give_back(const std::string& client) {
    const std::lock_guard lock(mutex_);
    const auto held = held_.find(client);
    if (--held->second == 0) held_.erase(held);
    ++free_;
  }

  std::mutex mutex_;
  std::size_t free_;
  std::map<std::string, std::size_t> held_;  // by client, never 0
};

}  // namespace spherule::server
