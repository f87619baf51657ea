// SPDX-License-Identifier: GPL-3.0-or-later
//
// The job that makes a simpler model of a model: load -> object -> the method's own stage -> evaluate -> store.
#pragma once

#include "server/records/store.h"
#include "server/work/jobs.h"

namespace spherule::server {

/// Runs the request in a record of kind "simplification".
Resource run_simplification(Store& store, const JobRecord& record, JobContext& job);

}  // namespace spherule::server
