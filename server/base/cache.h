// SPDX-License-Identifier: GPL-3.0-or-later
//
// Values that are slow to load, kept in memory up to a budget of bytes; the least recently used go first.
#pragma once

#include <chrono>
#include <cstddef>
#include <cstdint>
#include <future>
#include <list>
#include <memory>
#include <mutex>
#include <string>
#include <unordered_map>
#include <utility>

#include "core/base/context.h"

namespace spherule::server {

struct CacheStats {
  std::size_t entries = 0;
  std::size_t bytes = 0;
  std::uint64_t hits = 0;    ///< found, or joined a load under way
  std::uint64_t misses = 0;  ///< had to load
};

/// Thread safe. Values are immutable and shared: one that is evicted or erased lives on while somebody holds it.
template <typename T>
class Cache {
 public:
  struct Loaded {
    std::shared_ptr<const T> value;
    std::size_t bytes = 0;  ///< what it counts against the budget
  };

  explicit Cache(std::size_t budget_bytes) : budget_(budget_bytes) {}

  /// The value of `key`, from memory or from `load()` -> Loaded. Of several threads that miss the same key, one loads
  /// (outside the lock) and all get its value, or its exception, in which case nothing is kept. A value larger than
  /// the whole budget is returned but not kept. `load` must not ask this cache for the same key. Who waits for another
  /// thread's load hears `context`'s cancellation, and loads itself when it was the other one that was cancelled.
  template <typename Load>
  std::shared_ptr<const T> get_or_load(const std::string& key, Load&& load, const Context& context = {});

  /// Forgets the key; a load under way is delivered but not kept.
  void erase(const std::string& key);

  [[nodiscard]] CacheStats stats() const;

 private:
  using Value = std::shared_ptr<const T>;
  struct Entry {
    std::string key;
    Loaded loaded;
  };
  using Entries = std::list<Entry>;  // most recently used first
  struct Flight {
    std::promise<Value> promise;
    std::shared_future<Value> result{promise.get_future().share()};
  };

  void keep(const std::string& key, Loaded loaded);
  static Value await(const std::shared_future<Value>& result, const Context& context);

  const std::size_t budget_;
  mutable std::mutex mutex_;
  Entries entries_;
  std::unordered_map<std::string, typename Entries::iterator> index_;
  std::unordered_map<std::string, std::shared_ptr<Flight>> flights_;
  CacheStats stats_;
};

template <typename T>
std::shared_ptr<const T> Cache<T>::await(const std::shared_future<Value>& result, const Context& context) {
  constexpr std::chrono::milliseconds look{20};
  while (result.wait_for(look) != std::future_status::ready) context.throw_if_cancelled();
  try {
    return result.get();
  } catch (const Error& error) {
    if (error.code() != ErrorCode::cancelled) throw;
    return nullptr;
  }
}

template <typename T>
template <typename Load>
std::shared_ptr<const T> Cache<T>::get_or_load(const std::string& key, Load&& load, const Context& context) {
  std::shared_ptr<Flight> flight;
  while (flight == nullptr) {
    std::unique_lock lock(mutex_);
    if (const auto found = index_.find(key); found != index_.end()) {
      ++stats_.hits;
      entries_.splice(entries_.begin(), entries_, found->second);
      return found->second->loaded.value;
    }
    if (const auto under_way = flights_.find(key); under_way != flights_.end()) {
      ++stats_.hits;
      const std::shared_future<Value> result = under_way->second->result;
      lock.unlock();
      if (Value value = await(result, context)) return value;
      continue;  // whoever loaded was cancelled
    }
    ++stats_.misses;
    flight = flights_[key] = std::make_shared<Flight>();
  }
  // A flight that is no longer the key's own was erased, or replaced after that.
  const auto land = [&] {
    const auto own = flights_.find(key);
    if (own == flights_.end() || own->second != flight) return false;
    flights_.erase(own);
    return true;
  };
  try {
    Loaded loaded = load();
    Value value = loaded.value;
    {
      const std::lock_guard lock(mutex_);
      if (land()) keep(key, std::move(loaded));
    }
    flight->promise.set_value(value);
    return value;
  } catch (...) {
    {
      const std::lock_guard lock(mutex_);
      land();
    }
    flight->promise.set_exception(std::current_exception());
    throw;
  }
}

template <typename T>
void Cache<T>::keep(const std::string& key, Loaded loaded) {
  if (loaded.bytes > budget_) return;
  stats_.bytes += loaded.bytes;
  entries_.push_front({key, std::move(loaded)});
  index_[key] = entries_.begin();
  while (stats_.bytes > budget_) {
    stats_.bytes -= entries_.back().loaded.bytes;
    index_.erase(entries_.back().key);
    entries_.pop_back();
  }
}

template <typename T>
void Cache<T>::erase(const std::string& key) {
  const std::lock_guard lock(mutex_);
  flights_.erase(key);
  const auto found = index_.find(key);
  if (found == index_.end()) return;
  stats_.bytes -= found->second->loaded.bytes;
  entries_.erase(found->second);
  index_.erase(found);
}

template <typename T>
CacheStats Cache<T>::stats() const {
  const std::lock_guard lock(mutex_);
  CacheStats stats = stats_;
  stats.entries = entries_.size();
  return stats;
}

}  // namespace spherule::server
