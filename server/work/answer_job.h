// SPDX-License-Identifier: GPL-3.0-or-later
//
// The job that derives an answer from a model (measures, checks, a picture, a file for other programs) or from a volume
// (a slice). Its bytes are kept as they will be sent.
#pragma once

#include "server/records/store.h"
#include "server/work/jobs.h"

namespace spherule::server {

/// Runs the request in a record of any kind that api::DerivedRequest has.
Resource run_answer(Store& store, const JobRecord& record, JobContext& job);

}  // namespace spherule::server
