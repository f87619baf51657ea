// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/evaluate.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/base/poll.h"
#include "core/base/progress.h"
#include "core/measure/power.h"
#include "core/measure/union.h"
#include "core/sampled/rows.h"
#include "core/simplify/distance.h"
#include "core/simplify/frame.h"

namespace spherule {

using detail::Window;

namespace {

constexpr double kMostSamples = 0x1p27;

double samples_of(const Window& window) { return double(window.size(0)) * window.size(1) * window.size(2); }

// The object's samples over a window of the extended grid.
SampleBits within(const SampledObject& object, const Window& window, const Context& context) {
  Poll poll(context);
  SampleBits bits({window.size(0), window.size(1), window.size(2)});
  for (std::int32_t k = std::max(window.begin[2], 0); k < std::min(window.end[2], object.grid.dims[2]); ++k) {
    for (std::int32_t j = std::max(window.begin[1], 0); j < std::min(window.end[1], object.grid.dims[1]); ++j) {
      poll(static_cast<std::uint64_t>(window.size(0)));
      const auto row = bits.row(j - window.begin[1], k - window.begin[2]);
      for (std::int32_t i = std::max(window.begin[0], 0); i < std::min(window.end[0], object.grid.dims[0]); ++i) {
        const auto at = static_cast<std::size_t>(i - window.begin[0]);
        if (object.inside.test(i, j, k)) row[at / 64] |= std::uint64_t{1} << (at % 64);
      }
    }
  }
  return bits;
}

// The greatest distance from a sample of one set to the other set.
double farthest(const SampleBits& from, const SampleBits& to, Vec3 spacing, const Context& context) {
  const std::vector<float> squared = detail::squared_distances(to, spacing, context);
  const auto [nx, ny, nz] = from.dims();
  float most = 0;
  std::size_t row_start = 0;
  Poll poll(context);
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j, row_start += static_cast<std::size_t>(nx)) {
      poll(static_cast<std::uint64_t>(nx));
      const auto row = from.row(j, k);
      for (std::size_t w = 0; w < row.size(); ++w) {
        for (std::uint64_t bits = row[w]; bits != 0; bits &= bits - 1) {
          most = std::max(most, squared[row_start + 64 * w + static_cast<std::size_t>(std::countr_zero(bits))]);
        }
      }
    }
  }
  return std::sqrt(static_cast<double>(most));
}

std::optional<Achieved::Hausdorff> hausdorff(std::span<const Sphere> balls, const SampledObject& full,
                                             const Context& context) {
  SampledObject object = full;
  std::vector<Sphere> local;
  for (const Sphere& ball : balls) local.push_back(detail::to_grid(object.grid, ball));
  Window of_object = detail::window_of(object.inside), window;
  const auto both = [&] {
    Window box = detail::window_of(object.grid.spacing, local);
    for (std::size_t a = 0; a < 3; ++a) {
      box.begin[a] = std::min(box.begin[a], of_object.begin[a]);
      box.end[a] = std::max(box.end[a], of_object.end[a]);
      if (object.border == Border::open) {
        box.begin[a] = std::max(box.begin[a], 0);
        box.end[a] = std::min(box.end[a], object.grid.dims[a]);
      }
    }
    return box;
  };
  for (window = both(); samples_of(window) > kMostSamples; window = both()) {
    object = subsampled(object, {2, 2, 2}, context);
    of_object = detail::window_of(object.inside);
  }
  const SampleBits in_object = within(object, window, context);
  const SampleBits in_balls = detail::held_samples(local, object.grid.spacing, window, context);
  if (in_balls.count() == 0 || in_object.count() == 0) return std::nullopt;
  Achieved::Hausdorff result;
  result.to_spheres = farthest(in_object, in_balls, object.grid.spacing, context);
  result.to_object = farthest(in_balls, in_object, object.grid.spacing, context);
  result.mm = std::max(result.to_spheres, result.to_object);
  const Vec3 s = object.grid.spacing;
  result.of_diagonal = result.mm / norm({s.x * of_object.size(0), s.y * of_object.size(1), s.z * of_object.size(2)});
  return result;
}

}  // namespace

Reference reference_of(const SphereModel& model, const Context& context) {
  if (model.solid) {
    const TetrahedraMeasures t = measure_tetrahedra(*model.solid, context);
    return {t.area_mm2, t.topology};
  }
  return {measure_union(model, context).area_mm2, union_topology(model.spheres, context)};
}

Achieved evaluate(std::span<const Sphere> balls, const SampledObject& object, const Reference& reference,
                  const Context& whole) {
  const Context context = quiet(whole);
  whole.report("evaluate", 0);
  Achieved a;
  a.spheres = balls.size();
  const Overlap overlap = measure_overlap(balls, object, context);
  a.iou = overlap.iou();
  a.object_mm3 = static_cast<double>(overlap.inside) * object.sample_mm3();
  a.covered_mm3 = static_cast<double>(overlap.covered) * object.sample_mm3();
  a.spilled_mm3 = static_cast<double>(overlap.spilled) * object.sample_mm3();
  a.never_spills = overlap.spilled == 0 && never_spills(balls, object, context);
  a.covers_all = overlap.covered == overlap.inside && covers_all(balls, object, context);
  whole.report("evaluate", 0.3);
  const UnionMeasures measures = measure_union(balls, context);
  a.volume_mm3 = measures.moments.volume;
  a.volume_error = a.volume_mm3 / a.object_mm3 - 1;
  a.area_mm2 = measures.area_mm2;
  a.area_error = reference.area_mm2 > 0 ? a.area_mm2 / reference.area_mm2 - 1 : 0;
  whole.report("evaluate", 0.5);
  a.hausdorff = hausdorff(balls, object, context);
  a.before = reference.topology;
  a.after = union_topology(balls, context);
  whole.report("evaluate", 1);
  return a;
}

}  // namespace spherule
