// SPDX-License-Identifier: GPL-3.0-or-later
//
// The job that makes a simpler model of a model: load -> object -> the method's own stage -> evaluate -> store.
#pragma once

#include "server/jobs.h"
#include "server/store.h"

namespace spherule::server {

/// Runs the request in a record of kind "simplification".
Resource run_simplification(Store& store, const JobRecord& record, JobContext& job);

}  // namespace spherule::server
