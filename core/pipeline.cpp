// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/pipeline.h"

#include <chrono>

#include "core/boundary.h"
#include "core/delaunay.h"

namespace spherule {

namespace {

// What `work` gives; how long it took is added to the timings.
template <typename Work>
auto timed(std::vector<StageTime>& timings, const char* stage, const Context& context, Work&& work) {
  context.throw_if_cancelled();
  const auto begin = std::chrono::steady_clock::now();
  auto result = work();
  timings.push_back({stage, std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count()});
  return result;
}

}  // namespace

BuiltModel build_model(const Volume& volume, const ObjectRule& rule, const ModelLimits& limits,
                       const Context& context) {
  std::vector<StageTime> timings;
  const InsideSamples samples =
      timed(timings, "samples", context, [&] { return classify_samples(volume, rule, context); });
  BuiltModel built = build_model(volume, rule, samples, limits, context);
  built.timings.insert(built.timings.begin(), timings.begin(), timings.end());
  return built;
}

BuiltModel build_model(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                       const ModelLimits& limits, const Context& context) {
  BuiltModel built;
  const auto stage = [&](const char* name, auto&& work) { return timed(built.timings, name, context, work); };
  BoundaryPoints boundary =
      stage("boundary", [&] { return extract_boundary(volume, rule, samples, limits.max_points, context); });
  if (boundary.points.empty()) {
    const bool all = samples.inside.count() > 0;
    throw Error(ErrorCode::unusable,
                all ? "Every voxel is inside the object and its border is open, so it has no surface; choose another "
                      "threshold or a closed border."
                    : "No voxel is inside the object; choose a threshold within the range of the volume's values.");
  }
  if (fills_its_box(samples.inside)) {
    built.warnings.emplace_back(
        "Every sample, or nearly every one, is inside, at the border of the volume too: the object is the whole box; "
        "choose another threshold, range or labels if it should not be.");
  }
  if (boundary.touches_border && rule.border == Border::open) {
    built.warnings.emplace_back(
        "The object reaches the border of the volume and is left open there; border \"closed\" closes it.");
  }
  if (boundary.touches_border && rule.border == Border::closed) {
    built.warnings.emplace_back("The object reaches the border of the volume and is closed half a voxel beyond it.");
  }
  Tetrahedralization cells = stage("delaunay", [&] { return tetrahedralize(boundary.points, context); });
  if (cells.empty()) {
    throw Error(ErrorCode::unusable,
                "The object's boundary points lie in one plane, so there is no solid to model; use a closed border or "
                "a larger volume.");
  }
  built.model = stage("spheres", [&] {
    return classify_spheres(volume, rule, samples, std::move(boundary), std::move(cells), context);
  });
  built.boundary_point_density_mm = boundary_point_density(*built.model.solid, context);
  return built;
}

}  // namespace spherule
