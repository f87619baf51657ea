// SPDX-License-Identifier: GPL-3.0-or-later
//
// A queue that serves clients in turn, so that nobody's hundred requests stand before another's one. Within a client:
// first come, first served. A client that comes back has its next turn after all who wait already (round robin; Nagle,
// "On Packet Switches With Infinite Storage", RFC 970, 1985).
#pragma once

#include <algorithm>
#include <cstddef>
#include <deque>
#include <string>
#include <utility>

namespace spherule::server {

/// Not thread safe. T is equality comparable and cheap to copy. O(clients that wait) unless said otherwise.
template <typename T>
class FairQueue {
 public:
  void push(const std::string& client, T item) {
    Line* line = find(client);
    if (line == nullptr) line = &lines_.emplace_back(Line{client, {}});
    line->items.push_back(std::move(item));
    ++size_;
  }

  /// For an item that gives its turn back: it comes before all others.
  void push_front(const std::string& client, T item) {
    const auto found = std::ranges::find(lines_, client, &Line::client);
    Line line{client, {}};
    if (found != lines_.end()) {
      line = std::move(*found);
      lines_.erase(found);
    }
    line.items.push_front(std::move(item));
    lines_.push_front(std::move(line));
    ++size_;
  }

  /// Whose turn it is. Not when empty. Pushing does not change it.
  const T& front() const { return lines_.front().items.front(); }

  /// Removes the front; its client's next turn comes last.
  T pop() {
    Line line = std::move(lines_.front());
    lines_.pop_front();
    T item = std::move(line.items.front());
    line.items.pop_front();
    if (!line.items.empty()) lines_.push_back(std::move(line));
    --size_;
    return item;
  }

  /// Without effect when it is not there. O(size).
  void erase(const T& item) {
    for (Line& line : lines_) size_ -= std::erase(line.items, item);
    std::erase_if(lines_, [](const Line& line) { return line.items.empty(); });
  }

  bool empty() const { return lines_.empty(); }
  std::size_t size() const { return size_; }
  std::size_t size_of(const std::string& client) const {
    const auto found = std::ranges::find(lines_, client, &Line::client);
    return found == lines_.end() ? 0 : found->items.size();
  }

  /// How many come before this item if nothing is pushed or erased; size() when it is not there. O(size).
  std::size_t place_of(const T& item) const {
    for (std::size_t own = 0; own < lines_.size(); ++own) {
      const auto& items = lines_[own].items;
      const auto found = std::ranges::find(items, item);
      if (found == items.end()) continue;
      const auto rounds = static_cast<std::size_t>(found - items.begin());
      std::size_t before = rounds;
      for (std::size_t i = 0; i < lines_.size(); ++i)
        if (i != own) before += std::min(lines_[i].items.size(), rounds + (i < own ? 1 : 0));
      return before;
    }
    return size_;
  }

 private:
  struct Line {
    std::string client;
    std::deque<T> items;  // never empty
  };

  Line* find(const std::string& client) {
    const auto found = std::ranges::find(lines_, client, &Line::client);
    return found == lines_.end() ? nullptr : &*found;
  }

  std::deque<Line> lines_;  // in the order of their turns
  std::size_t size_ = 0;
};

}  // namespace spherule::server
