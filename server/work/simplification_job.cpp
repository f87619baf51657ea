// SPDX-License-Identifier: GPL-3.0-or-later
#include <utility>

#include "api/json/records.h"
#include "core/simplify/simplify.h"
#include "server/work/kinds.h"

namespace spherule::server {

namespace {

SampledObject object_of(Store& store, const Resource& root, const SphereModel& model, const Context& context) {
  const std::optional<api::ModelRequest> source = api::model_from(root.document).source;
  if (!source) return sample_union(model.spheres, std::size_t{1} << 22, context);
  const Volume volume = store.stored_volume(store.find_volume(source->volume), context);
  return {.grid = volume.grid,
          .inside = classify_samples(volume, source->rule, context).inside,
          .border = source->rule.border};
}

}  // namespace

Resource run(Store& store, const api::SimplificationRequest& request, const std::string& id, JobContext& job) {
  const Resource source = store.find_model(request.model), root = store.root_of(source);
  Stopwatch watch;
  job.context(0, 0.1).report("load", 0);
  const auto model = store.load(source, job.context(0, 0.05)), first = store.load(root, job.context(0.05, 0.1));
  watch.lap("load");
  job.context(0.1, 0.2).report("object", 0);
  const SampledObject object = object_of(store, root, *first, job.context(0.1, 0.15));
  const Reference reference = reference_of(*first, job.context(0.15, 0.2));
  watch.lap("object");
  const Simplified simplified = simplify(*model, object, reference, request.method, job.context(0.2, 0.95));
  watch.set("simplify", simplified.seconds);
  watch.set("evaluate", simplified.evaluate_seconds);

  const SphereModel last{.spheres = spheres_at(simplified.order, simplified.order.last_level()), .solid = {}};
  api::ModelInfo info;
  info.id = id;
  info.algorithm_version = algorithm_version_text();
  info.spheres = last.spheres.size();
  info.bounds = bounds(last);
  info.simplification = api::SimplificationInfo{.request = request,
                                                .levels = simplified.order.last_level(),
                                                .nodes = simplified.order.spheres.size(),
                                                .achieved = simplified.achieved,
                                                .optimality_gap = simplified.optimality_gap,
                                                .seconds = simplified.seconds};
  const Context storing = job.context(0.95, 1);
  storing.report("store", 0);
  storing.throw_if_cancelled();
  watch.restart();
  return store.keep(info, simplified.order, watch, storing);
}

}  // namespace spherule::server
