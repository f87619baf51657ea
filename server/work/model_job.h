// SPDX-License-Identifier: GPL-3.0-or-later
//
// The job that makes a model of a volume: read -> voxels -> boundary -> delaunay -> spheres -> store.
#pragma once

#include "server/records/store.h"
#include "server/work/jobs.h"

namespace spherule::server {

/// Runs the request in a record of kind "model".
Resource run_model(Store& store, const JobRecord& record, JobContext& job);

}  // namespace spherule::server
