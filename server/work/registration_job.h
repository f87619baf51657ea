// SPDX-License-Identifier: GPL-3.0-or-later
//
// The job that registers two models, and the one that derives an answer from a registration: a picture, or the moving
// volume or model on the fixed grid.
#pragma once

#include "server/records/store.h"
#include "server/work/jobs.h"

namespace spherule::server {

// Collections of the catalogue and kinds of jobs.
inline constexpr const char* registration_kind = "registration";
inline constexpr const char* registration_answer_kind = "registration_answer";

api::RegistrationInfo registration_info(const Resource& resource);

/// The volume that a model was made from, also by way of simplification. Throws unusable when it came without one.
Resource volume_of(Store& store, const std::string& model);

Resource run_registration(Store& store, const JobRecord& record, JobContext& job);
Resource run_registration_answer(Store& store, const JobRecord& record, JobContext& job);

}  // namespace spherule::server
