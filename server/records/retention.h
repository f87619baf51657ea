// SPDX-License-Identifier: GPL-3.0-or-later
//
// Deleting what nobody has used for long, where the configuration says so.
#pragma once

#include <algorithm>
#include <chrono>
#include <functional>
#include <string>
#include <vector>

#include "server/records/catalog.h"

namespace spherule::server {

/// How long things of a collection are kept after their last use. Using something uses what it was made from, too, so
/// nothing goes before what is made from it does; and what goes takes along all that was made from it.
struct Keeping {
  std::string collection;
  std::chrono::seconds unused{0};  ///< 0: for ever
};

/// Whether the clock on the wall, having moved by so much more than time was served, was set (or no server ran): a
/// whole hour, either way. Nothing is deleted in such a round: what else it moved is not known.
constexpr bool is_jump(std::chrono::microseconds moved) {
  return moved >= std::chrono::hours(1) || moved <= -std::chrono::hours(1);
}

/// Calls `remove` for each resource that is over its time at `now` (of service: Catalog::served), which deletes it with
/// all that was made from it. O(what goes). Throws what the catalogue throws, and what `remove` throws except
/// not_found.
void expire(const Catalog& catalog, const std::vector<Keeping>& keeping, Time now,
            const std::function<void(const std::string& id)>& remove);

/// `used` is a matter of days, so a use is written down only when the last one was this long ago: reading stays
/// reading.
constexpr std::chrono::seconds use_is_noted_after(std::chrono::seconds shortest) {
  return std::min(shortest / 10, std::chrono::seconds(3600));
}

}  // namespace spherule::server
