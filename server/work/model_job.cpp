// SPDX-License-Identifier: GPL-3.0-or-later

#include <algorithm>
#include <array>
#include <string_view>
#include <utility>

#include "core/crossings.h"
#include "core/pipeline.h"
#include "server/work/kinds.h"
#include "server/work/memory.h"

namespace spherule::server {

namespace {

// The part of a model's job that each stage has, as measured on heads of a million points.
struct Share {
  std::string_view stage;
  double from, to;
};
constexpr auto kShares = std::to_array<Share>({{"read", 0, 0.05},
                                               {"samples", 0.05, 0.06},
                                               {"boundary", 0.06, 0.1},
                                               {"delaunay", 0.1, 0.85},
                                               {"spheres", 0.85, 0.95},
                                               {"store", 0.95, 1}});

}  // namespace

Resource run(Store& store, const api::ModelRequest& request, const std::string& id, JobContext& job) {
  Context context = job.context(0, 1);
  context.progress = [whole = context.progress](std::string_view stage, double part) {
    const auto found = std::ranges::find(kShares, stage, &Share::stage);
    whole(stage, found == kShares.end() ? 0 : found->from + part * (found->to - found->from));
  };
  Stopwatch watch;
  context.report("read", 0);
  const Volume volume = store.stored_volume(store.find_volume(request.volume), context);
  watch.lap("read");

  api::ModelInfo info;
  info.id = id;
  info.algorithm_version = algorithm_version_text();
  info.source = request;
  const InsideSamples samples = classify_samples(volume, request.rule, context);
  watch.lap("samples");
  info.voxels = measure_voxels(volume.grid, samples.inside);
  const std::size_t points = count_boundary_points(samples, request.rule.border, context);
  // More are refused below.
  const ScanSize scan{.samples = volume.grid.sample_count(), .bytes = volume.voxels.size()};
  job.expect_memory(memory_to_model(scan, std::min<std::uint64_t>(points, store.config.max_boundary_points)));
  watch.lap("voxels");

  BuiltModel built =
      build_model(volume, request.rule, samples, {.max_points = store.config.max_boundary_points}, context);
  for (const StageTime& time : built.timings) watch.set(time.stage, time.seconds);
  info.warnings = std::move(built.warnings);
  for (const std::string& warning : info.warnings) job.warn(warning);
  const Solid& solid = *built.model.solid;
  info.boundary_points = solid.boundary.points.size();
  info.tetrahedra = solid.cells.size();
  info.inside_tetrahedra = solid.inside_count;
  info.spheres = built.model.spheres.size();
  info.boundary_point_density_mm = built.boundary_point_density_mm;
  info.bounds = bounds(built.model);

  context.report("store", 0);
  context.throw_if_cancelled();
  watch.restart();
  return store.keep(info, std::move(built.model), watch, context);
}

}  // namespace spherule::server
