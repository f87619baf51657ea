// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/records/retention.h"

#include "core/base/error.h"

namespace spherule::server {

void expire(const Catalog& catalog, const std::vector<Keeping>& keeping, Time now,
            const std::function<void(const std::string& id)>& remove) {
  constexpr std::size_t batch = 100;
  for (const Keeping& keep : keeping) {
    if (keep.unused.count() == 0) continue;
    for (;;) {
      const std::vector<std::string> ids = catalog.unused_since(keep.collection, now - keep.unused, batch);
      for (const std::string& id : ids) try {
          remove(id);
        } catch (const Error& error) {
          if (error.code() != ErrorCode::not_found) throw;  // else it went with what it was made from
        }
      if (ids.size() < batch) break;
    }
  }
}

}  // namespace spherule::server
