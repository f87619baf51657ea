// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/core/stages.h"

#include <algorithm>
#include <deque>
#include <set>

#include "core/compare/marching_cubes.h"
#include "core/measure/checks.h"
#include "core/measure/components.h"
#include "core/measure/enclosing.h"
#include "core/measure/power.h"
#include "core/measure/report.h"
#include "core/measure/thickness.h"
#include "core/measure/union.h"
#include "core/pipeline.h"
#include "core/register/register.h"
#include "core/register/resample.h"
#include "core/simplify/simplify.h"
#include "core/slice/slice.h"
#include "core/trees/box_tree.h"
#include "tests/core/hostile.h"
#include "tests/phantoms.h"

namespace spherule::stages {

namespace {

// A volume, its rule, and all that is made of them.
struct Scan {
  explicit Scan(Volume of, ObjectRule by)
      : volume(std::move(of)),
        rule(std::move(by)),
        samples(classify_samples(volume, rule)),
        boundary(extract_boundary(volume, rule, samples)),
        model(build_model(volume, rule).model),
        whole(measure_union(model)),
        object{.grid = volume.grid, .inside = samples.inside, .border = rule.border} {}

  Volume volume;
  ObjectRule rule;
  InsideSamples samples;
  BoundaryPoints boundary;
  SphereModel model;
  UnionMeasures whole;
  SampledObject object;
};

void add_scan(std::vector<Stage>& all, const std::string& of, const Scan& scan) {
  const auto add = [&](const char* name, auto run) { all.push_back({name + (" of " + of), std::move(run)}); };
  const Scan* s = &scan;
  add("samples", [s](const Context& c) { classify_samples(s->volume, s->rule, c); });
  add("boundary", [s](const Context& c) { extract_boundary(s->volume, s->rule, s->samples, std::size_t{1} << 31, c); });
  add("delaunay", [s](const Context& c) { tetrahedralize(s->boundary.points, c); });
  add("spheres", [s](const Context& c) {
    classify_spheres(s->volume, s->rule, s->samples, s->boundary, s->model.solid->cells, c);
  });
  add("model", [s](const Context& c) { build_model(s->volume, s->rule, {}, c); });
  add("density", [s](const Context& c) { boundary_point_density(*s->model.solid, c); });
  add("union", [s](const Context& c) { measure_union(s->model, c); });
  add("tetrahedra", [s](const Context& c) { measure_tetrahedra(*s->model.solid, c); });
  add("measures", [s](const Context& c) { measure_model(s->model, s->whole, MeasuredObject{s->volume, s->rule}, c); });
  add("components", [s](const Context& c) { components(s->model, s->whole.parts, c); });
  add("thickness", [s](const Context& c) { local_thickness(s->model, s->whole.moments.volume, 40, 1 << 20, c); });
  add("checks", [s](const Context& c) { check_model(s->model, s->samples.inside, s->rule.border, c); });
  add("triangles", [s](const Context& c) { marching_cubes(s->volume, s->rule, s->samples, s->boundary, c); });
  add("marching cubes",
      [s](const Context& c) { measure_marching_cubes(s->volume, s->rule, s->samples, s->boundary, c); });
  add("neighbours", [s](const Context& c) { neighbours(s->model.solid->cells, s->boundary.points.size(), c); });
  add("slice", [s](const Context& c) {
    build_plane_model(slice_of(s->volume, 2, s->volume.grid.dims[2] / 2), s->rule, std::size_t{1} << 31, c);
  });
  add("resampled", [s](const Context& c) { sampled(s->model, {}, s->volume.grid, c); });
}

void add_simplifications(std::vector<Stage>& all, const std::string& of, const SphereModel& model,
                         const SampledObject& object) {
  const SphereModel* m = &model;
  const SampledObject* o = &object;
  const auto k = static_cast<std::uint32_t>(std::min<std::size_t>(64, model.spheres.size()));
  const auto add = [&](const char* name, const SimplifyMethod& method) {
    all.push_back({name + (" of " + of), [=](const Context& c) { simplify(*m, *o, {}, method, c); }});
  };
  add("sphericity", SphericityOptions{.threshold = 0.9, .limit = k, .representative = Representative::volume});
  add("median", SplittingOptions{.at = SplittingOptions::At::median, .k = k});
  add("average", SplittingOptions{.at = SplittingOptions::At::average, .k = k});
  add("prune", PruneOptions{.volume_share = 0.5});
  add("best", BestOptions{.mode = BestOptions::Mode::outer, .k = std::min(k, 8U)});
  add("inner", BestOptions{.mode = BestOptions::Mode::inner, .k = k});
  all.push_back({"reference of " + of, [m](const Context& c) { reference_of(*m, c); }});
}

void add_balls(std::vector<Stage>& all, const std::string& of, const SphereModel& model, const UnionMeasures& whole) {
  const auto add = [&](const char* name, auto run) { all.push_back({name + (" of " + of), std::move(run)}); };
  const SphereModel* m = &model;
  const UnionMeasures* w = &whole;
  add("union", [m](const Context& c) { measure_union(*m, c); });
  add("topology", [m](const Context& c) { union_topology(m->spheres, c); });
  add("power neighbours", [m](const Context& c) { power_neighbours(m->spheres, c); });
  add("inscribed", [m](const Context& c) { largest_inscribed_sphere(m->spheres, c); });
  if (of == "row") add("measures", [m, w](const Context& c) { measure_model(*m, *w, {}, c); });
  add("samples", [m](const Context& c) { sample_union(m->spheres, std::size_t{1} << 20, c); });
}

}  // namespace

std::vector<Stage> all(int size) {
  static std::deque<Scan> scans;
  static std::deque<SphereModel> models;
  static std::deque<UnionMeasures> measures;
  static std::deque<SampledObject> objects;
  std::vector<Stage> result;
  const Scan& ball =
      scans.emplace_back(phantoms::sample(phantoms::ball({0, 0, 0}, 0.45 * size), phantoms::cubic_grid(size, size)),
                         phantoms::threshold(0));
  add_scan(result, "a ball", ball);
  add_simplifications(result, "a ball", ball.model, ball.object);
  const Scan& noise =
      scans.emplace_back(phantoms::noise(phantoms::cubic_grid(size, size), 100, 1), phantoms::range(20, 60));
  add_scan(result, "noise", noise);
  const std::set<std::string> wanted{"identical", "jittered", "row", "under a huge one", "cospherical centres"};
  for (const hostile::Balls& set : hostile::ball_sets(static_cast<std::size_t>(8 * size * size))) {
    if (!wanted.contains(set.name)) continue;
    const SphereModel& model = models.emplace_back(SphereModel{.spheres = set.balls, .solid = {}});
    add_balls(result, set.name, model, measures.emplace_back(measure_union(model)));
    if (set.name != "cospherical centres" && set.name != "identical") continue;
    add_simplifications(result, set.name, model, objects.emplace_back(sample_union(model.spheres, 1 << 18)));
    for (const auto method : {RegistrationMethod::global, RegistrationMethod::matching}) {
      const SphereModel* m = &model;
      const auto k = static_cast<std::uint32_t>(std::clamp(size * size, 16, 512));
      result.push_back({"registration of " + set.name, [m, method, k](const Context& c) {
                          register_models(*m, *m, {.method = method, .k = k, .inits = 4}, c);
                        }});
    }
  }
  return result;
}

}  // namespace spherule::stages
