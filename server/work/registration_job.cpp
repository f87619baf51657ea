// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/records.h"
#include "api/json/registration_documents.h"
#include "core/register/register.h"
#include "server/work/kinds.h"

namespace spherule::server {

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

Resource run(Store& store, const api::RegistrationRequest& request, const std::string& id, JobContext& job) {
  job.context(0, 0.1).report("load", 0);
  const auto fixed = store.load(store.find_model(request.fixed), job.context(0, 0.1));
  const auto moving = store.load(store.find_model(request.moving), job.context(0.1, 0.2));
  const Registration found = register_models(*fixed, *moving, request.options, job.context(0.2, 0.98));
  for (const std::string& warning : found.warnings) job.warn(warning);
  job.context(0.98, 1).report("store", 0);
  Resource resource;
  resource.collection = registrations_collection;
  resource.document = api::registration_document(id, now(), algorithm_version_text(), request, found);
  return resource;
}

}  // namespace spherule::server
