// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a request will need, from what is stored: the sizes that memory.h's functions take, looked up.
#pragma once

#include <cstdint>

#include "api/work.h"
#include "server/records/store.h"

namespace spherule::server {

/// Memory that the job for this request needs at its peak, bytes; of a model only until its boundary points are known.
/// Throws not_found without what the request names, unusable where models have no volume to apply a registration to,
/// and what check_exportable() throws.
std::uint64_t memory_for(Store& store, const api::WorkRequest& request);

}  // namespace spherule::server
