// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/report.h"

#include "core/base/check.h"
#include "core/base/progress.h"
#include "core/measure/enclosing.h"
#include "core/measure/power.h"

namespace spherule {

ModelMeasures measure_model(const SphereModel& model, const UnionMeasures& whole,
                            const std::optional<MeasuredObject>& object, const Context& context) {
  SPHERULE_CHECK(model.solid.has_value() == object.has_value());
  ModelMeasures measures;
  if (model.solid) {
    measures.tetrahedra = measure_tetrahedra(*model.solid, part_of(context, 0, 0.3));
    const InsideSamples samples = classify_samples(object->volume, object->rule, part_of(context, 0.3, 0.35));
    measures.voxels = measure_voxels(object->volume.grid, samples.inside);
    measures.marching_cubes = measure_marching_cubes(object->volume, object->rule, samples, model.solid->boundary,
                                                     part_of(context, 0.35, 0.45));
    measures.observations = observations(model, boundary_point_density(*model.solid, context),
                                         measures.tetrahedra->volume_mm3, whole.moments.volume);
  } else {
    context.report("topology", 0);
  }
  SpheresMeasures& spheres = measures.spheres;
  spheres.count = model.spheres.size();
  const RadiusHistogram radii = radius_histogram(model.spheres, 1);
  spheres.radius_min_mm = radii.min_mm;
  spheres.radius_max_mm = radii.max_mm;
  spheres.mass = mass_properties(whole.moments);
  spheres.area_mm2 = whole.area_mm2;
  for (const Sphere& ball : model.spheres) spheres.bounds.include(ball);
  spheres.topology =
      model.solid ? measures.tetrahedra->topology : union_topology(model.spheres, part_of(context, 0, 0.45));

  context.report("components", 0.45);
  measures.components = components(model, whole.parts, context);
  measures.smallest_enclosing = smallest_enclosing_sphere(model.spheres);
  const bool few = model.spheres.size() <= largest_inscribed_limit;
  measures.largest_inscribed = !model.solid && few
                                   ? largest_inscribed_sphere(model.spheres, part_of(context, 0.45, 0.5))
                                   : largest_sphere(model.spheres);
  measures.thickness =
      local_thickness(model, whole.moments.volume, 40, std::uint64_t{1} << 22, part_of(context, 0.5, 1));
  return measures;
}

}  // namespace spherule
