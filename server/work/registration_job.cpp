// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/work/registration_job.h"

#include <utility>

#include "api/json/documents.h"
#include "api/json/registration_documents.h"
#include "core/register/picture.h"
#include "core/register/register.h"
#include "core/register/resample.h"
#include "core/write/write_nifti.h"

namespace spherule::server {

namespace {

std::string before_after(Store& store, const api::RegistrationInfo& info, const api::BeforeAfterRequest& wanted,
                         JobContext& job) {
  std::shared_ptr<const SphereModel> fixed, moving;
  if (wanted.few) {
    fixed = std::make_shared<const SphereModel>(SphereModel{.spheres = info.fixed_spheres, .solid = {}});
    moving = std::make_shared<const SphereModel>(SphereModel{.spheres = info.moving_spheres, .solid = {}});
  } else {
    fixed = store.load(store.find_model(info.request.fixed), job.context(0, 0.1));
    moving = store.load(store.find_model(info.request.moving), job.context(0.1, 0.2));
  }
  const Context context = job.context(0.2, 0.95);
  return encode_png(before_and_after(*fixed, *moving, info.moving_to_fixed, wanted.options, context), context);
}

std::string applied(Store& store, const api::RegistrationInfo& info, api::Applied what, JobContext& job) {
  const Resource fixed = volume_of(store, info.request.fixed);
  const Grid grid = api::volume_from(fixed.document).grid;
  const auto map = info.moving_to_fixed;
  if (what == api::Applied::model) {
    const auto model = store.load(store.find_model(info.request.moving), job.context(0, 0.2));
    return volume_to_nifti(sampled(*model, map, grid, job.context(0.2, 0.95)));
  }
  const Volume volume = store.stored_volume(volume_of(store, info.request.moving), job.context(0, 0.3));
  return volume_to_nifti(resampled(volume, map, grid, job.context(0.3, 0.95)));
}

}  // namespace

api::RegistrationInfo registration_info(const Resource& resource) {
  return api::registration_from(resource.document, resource.request);
}

Resource volume_of(Store& store, const std::string& id) {
  api::ModelInfo model = api::model_from(store.find_model(id).document);
  while (model.simplification) {
    model = api::model_from(store.find_model(model.simplification->request.model).document);
  }
  if (!model.source) {
    throw Error(
        ErrorCode::unusable,
        "Only models that were made from a volume have one to resample, or a grid to resample to; register such "
        "models.");
  }
  return store.find_volume(model.source->volume);
}

Resource run_registration(Store& store, const JobRecord& record, JobContext& job) {
  const api::RegistrationRequest request = api::registration_request_from(record.request);
  job.context(0, 0.1).report("load", 0);
  const auto fixed = store.load(store.find_model(request.fixed), job.context(0, 0.1));
  const auto moving = store.load(store.find_model(request.moving), job.context(0.1, 0.2));
  const Registration found = register_models(*fixed, *moving, request.options, job.context(0.2, 0.98));
  for (const std::string& warning : found.warnings) job.warn(warning);
  job.context(0.98, 1).report("store", 0);
  Resource resource;
  resource.id = record.result_id;
  resource.collection = registrations_collection;
  resource.request = record.request;
  resource.document = api::registration_document(record.result_id, now(), algorithm_version_text(), request, found);
  resource.inputs = {request.fixed};
  if (request.moving != request.fixed) resource.inputs.push_back(request.moving);
  return resource;
}

Resource run_registration_answer(Store& store, const JobRecord& record, JobContext& job) {
  const api::RegistrationAnswerRequest request = api::registration_answer_from(record.request);
  const api::RegistrationInfo info =
      registration_info(store.find(request.registration, registrations_collection, "registration"));
  job.context(0, 1).report("load", 0);
  const auto* picture = std::get_if<api::BeforeAfterRequest>(&request.what);
  const std::string bytes = picture != nullptr ? before_after(store, info, *picture, job)
                                               : applied(store, info, std::get<api::Applied>(request.what), job);
  job.context(0.95, 1).report("store", 0);
  Resource answer;
  answer.id = record.result_id;
  answer.collection = answers_collection;
  answer.request = record.request;
  answer.inputs = {request.registration};
  answer.bytes = bytes.size();
  answer.blobs = {store.put_answer(record.result_id, bytes)};
  return answer;
}

}  // namespace spherule::server
