// SPDX-License-Identifier: GPL-3.0-or-later
//
// How each kind of work is done (api/work.h names them): one function a request, found by its type.
#pragma once

#include "api/work.h"
#include "server/records/store.h"
#include "server/work/jobs.h"

namespace spherule::server {

/// Does the work of a job: the resource that it makes, its blobs committed. Throws what the stages of core/ throw,
/// not_found for what was deleted meanwhile, and corrupt for a job whose request cannot be read. Thread safe.
Resource do_work(Store& store, const JobRecord& record, JobContext& job);

// Of one request each; `id` is the result's. What do_work itself sets in the resource (id, request, inputs) is left
// out.

/// read -> boundary -> delaunay -> spheres -> store.
Resource run(Store& store, const api::ModelRequest& request, const std::string& id, JobContext& job);
Resource run(Store& store, const api::SimplificationRequest& request, const std::string& id, JobContext& job);
Resource run(Store& store, const api::RegistrationRequest& request, const std::string& id, JobContext& job);
/// Measures, checks, pictures, tables, files, slices: the bytes of an answer.
Resource run(Store& store, const api::DerivedRequest& request, const std::string& id, JobContext& job);

/// The volume that a model was made from, also by way of simplification. Throws unusable when it came without one.
Resource volume_of(Store& store, const std::string& model);

}  // namespace spherule::server
