// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/kinds.h"

#include <variant>

#include "api/json/work.h"

namespace spherule::server {

Resource do_work(Store& store, const JobRecord& record, JobContext& job) {
  if (!record.request) {
    throw Error(ErrorCode::corrupt, "The server's record of this work is damaged; ask for the same thing again.");
  }
  const api::WorkRequest& request = *record.request;
  Resource made = std::visit([&](const auto& wanted) { return run(store, wanted, record.result_id, job); }, request);
  made.id = record.result_id;
  made.request = api::record_of(request);
  made.inputs = api::inputs_of(request);
  return made;
}

}  // namespace spherule::server
