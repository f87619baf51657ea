// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/report.h"

#include <gtest/gtest.h>

#include <cmath>
#include <filesystem>
#include <numbers>

#include "core/pipeline.h"
#include "core/read/read.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

ModelMeasures measures_of(const Volume& volume, const ObjectRule& rule, const Context& context = {}) {
  const SphereModel model = build_model(volume, rule).model;
  return measure_model(model, measure_union(model, context), MeasuredObject{volume, rule}, context);
}

// Every representation of a ring: the same volume, area, inertia and topology, the better the finer.
TEST(Measures, OfATorusAgreeBetweenRepresentations) {
  const double ring = 0.9, tube = 0.35;
  const Volume volume = phantoms::sample(phantoms::torus({0.02, 0.01, -0.03}, ring, tube), phantoms::cubic_grid(64, 3));
  const ModelMeasures m = measures_of(volume, phantoms::threshold(0));
  const double exact_volume = 2 * kPi * kPi * ring * tube * tube, exact_area = 4 * kPi * kPi * ring * tube;
  for (const double v :
       {m.spheres.mass.volume_mm3, m.tetrahedra->volume_mm3, m.marching_cubes->volume_mm3, m.voxels->volume_mm3}) {
    EXPECT_NEAR(v, exact_volume, 0.04 * exact_volume);
  }
  EXPECT_NEAR(m.tetrahedra->area_mm2, exact_area, 0.02 * exact_area);
  EXPECT_NEAR(m.marching_cubes->area_mm2, exact_area, 0.01 * exact_area);
  EXPECT_EQ(m.spheres.topology.betti, (std::array<std::int64_t, 3>{1, 1, 0}));
  EXPECT_EQ(m.tetrahedra->topology.euler_characteristic, 0);
  EXPECT_EQ(m.marching_cubes->euler_characteristic, 0);
  const MassProperties tetrahedra = mass_properties(m.tetrahedra->moments);
  // About the axis, and across it.
  const double axial = exact_volume * (ring * ring + 0.75 * tube * tube),
               lateral = exact_volume * (ring * ring / 2 + 0.625 * tube * tube);
  for (const MassProperties& mass : {m.spheres.mass, tetrahedra}) {
    EXPECT_NEAR(norm(mass.centroid_mm - Vec3{0.02, 0.01, -0.03}), 0, 1e-3);
    EXPECT_NEAR(mass.principal_moments_mm5[0], lateral, 0.04 * lateral);
    EXPECT_NEAR(mass.principal_moments_mm5[2], axial, 0.04 * axial);
    EXPECT_NEAR(std::abs(mass.principal_axes.rows[2].z), 1, 1e-3);
  }
  EXPECT_NEAR(m.thickness.mean_mm, 2 * tube, 0.1 * tube);
  EXPECT_NEAR(m.smallest_enclosing.radius, ring + tube, 0.01);
  EXPECT_NEAR(m.largest_inscribed.radius, tube, 0.02);
  ASSERT_EQ(m.components.size(), 1U);
  EXPECT_NEAR(m.components[0].volume_mm3, m.spheres.mass.volume_mm3, 1e-9);
  EXPECT_GT(m.observations->excess_volume_mm3.value, 0);
  EXPECT_GT(m.observations->excess_volume_mm3.slack(), 0);
}

TEST(Measures, OfImportedBallsHaveNoTetrahedra) {
  const SphereModel model{.spheres = {{{0, 0, 0}, 1}, {{10, 0, 0}, 2}, {{10, 0, 0}, 1}}, .solid = {}};
  const ModelMeasures m = measure_model(model, measure_union(model), {});
  EXPECT_FALSE(m.tetrahedra || m.marching_cubes || m.voxels || m.observations);
  EXPECT_NEAR(m.spheres.mass.volume_mm3, 12 * kPi, 1e-12 * 12 * kPi);
  EXPECT_NEAR(m.spheres.area_mm2, 20 * kPi, 1e-12 * 20 * kPi);
  EXPECT_EQ(m.spheres.topology.betti, (std::array<std::int64_t, 3>{2, 0, 0}));
  EXPECT_EQ(m.spheres.count, 3U);
  EXPECT_EQ(m.spheres.bounds.max, (Vec3{12, 2, 2}));
  EXPECT_EQ(m.components.size(), 2U);
  EXPECT_EQ(m.largest_inscribed, (Sphere{{10, 0, 0}, 2}));
}

TEST(Measures, ReportProgressThatNeverGoesBackAndCanBeCancelled) {
  const Volume volume = phantoms::sample(phantoms::ball({0, 0, 0}, 1), phantoms::cubic_grid(24, 3));
  double last = 0;
  Context context;
  context.progress = [&](std::string_view, double fraction) {
    EXPECT_GE(fraction, last - 1e-12);
    EXPECT_LE(fraction, 1);
    last = fraction;
  };
  const SphereModel model = build_model(volume, phantoms::threshold(0)).model;
  const UnionMeasures whole = measure_union(model);
  const ObjectRule rule = phantoms::threshold(0);
  measure_model(model, whole, MeasuredObject{volume, rule}, context);
  EXPECT_NEAR(last, 1, 1e-9);
  std::stop_source stop;
  stop.request_stop();
  context.cancel = stop.get_token();
  context.progress = {};
  EXPECT_THROW(measure_model(model, whole, MeasuredObject{volume, rule}, context), Error);
}

TEST(Measures, OfARealScanAgreeBetweenRepresentationsAndThreads) {
  const std::filesystem::path file = std::filesystem::path(SPHERULE_SHARED_DATA) / "spect.nii";
  if (!std::filesystem::exists(file)) GTEST_SKIP() << "needs the shared test volumes";
  const Volume volume = read_volume({file});
  const ModelMeasures one = measures_of(volume, phantoms::threshold(1000));
  const double counted = one.voxels->volume_mm3;
  EXPECT_NEAR(counted, 1.4795e6, 0.001e6);
  for (const double v : {one.spheres.mass.volume_mm3, one.tetrahedra->volume_mm3, one.marching_cubes->volume_mm3}) {
    EXPECT_NEAR(v, counted, 0.03 * counted);
  }
  EXPECT_LT(one.tetrahedra->volume_mm3, one.spheres.mass.volume_mm3);
  EXPECT_NEAR(one.thickness.sampled_volume_mm3, one.spheres.mass.volume_mm3, 2e-4 * counted);
  EXPECT_EQ(one.components.size(), static_cast<std::size_t>(one.tetrahedra->topology.betti[0]));
  const ModelMeasures two =
      measures_of(volume, phantoms::threshold(1000), {.threads = 3, .cancel = {}, .progress = {}});
  EXPECT_EQ(two.spheres.mass.volume_mm3, one.spheres.mass.volume_mm3);
  EXPECT_EQ(two.spheres.mass.inertia_mm5, one.spheres.mass.inertia_mm5);
  EXPECT_EQ(two.tetrahedra->area_mm2, one.tetrahedra->area_mm2);
  EXPECT_EQ(two.marching_cubes->area_mm2, one.marching_cubes->area_mm2);
  EXPECT_EQ(two.thickness.mean_mm, one.thickness.mean_mm);
  EXPECT_EQ(two.smallest_enclosing, one.smallest_enclosing);
}

}  // namespace
}  // namespace spherule
