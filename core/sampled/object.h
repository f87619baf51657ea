// SPDX-License-Identifier: GPL-3.0-or-later
//
// What a simplified model is measured against: the samples of the object, and which of them balls hold.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/inside.h"
#include "core/volume.h"

namespace spherule {

/// An object as samples on a grid. Beyond a closed border every sample is outside; beyond an open one none exists.
struct SampledObject {
  Grid grid;
  SampleBits inside;
  Border border = Border::closed;

  double sample_mm3() const { return grid.spacing.x * grid.spacing.y * grid.spacing.z; }
};

/// The union of balls as an object of its own, for models that came without a scan: on a grid of cubic voxels along the
/// axes of the frame, about `samples` of them in the box around the balls. O(samples + rows of balls). Precondition: at
/// least one ball.
SampledObject sample_union(std::span<const Sphere> balls, std::size_t samples = std::size_t{1} << 22,
                           const Context& context = {});
/// The same on a given grid: its samples that some ball holds. A sample on a sphere is in the ball, to rounding.
SampledObject sample_union(std::span<const Sphere> balls, const Grid& grid, const Context& context = {});

/// Every steps[a]-th sample along each axis a, from the first. O(samples).
SampledObject subsampled(const SampledObject& object, std::array<std::int32_t, 3> steps, const Context& context = {});

/// Numbers of samples in and around a union of balls. A sample on a sphere is in the ball, to rounding.
struct Overlap {
  std::uint64_t inside = 0;   ///< of the object
  std::uint64_t covered = 0;  ///< of them, in some ball
  std::uint64_t spilled = 0;  ///< outside samples in some ball, beyond a closed border too

  double iou() const { return static_cast<double>(covered) / static_cast<double>(inside + spilled); }
};

/// O(rows of balls); about a bit for each sample of one slice of the box around the balls and a thread. Reports stage
/// "overlap".
Overlap measure_overlap(std::span<const Sphere> balls, const SampledObject& object, const Context& context = {});

// Promises that are proven, not sampled: distances are compared with a bound for the rounding of every operation, and
// what is in doubt counts against the promise.

/// Whether no ball holds or touches any outside sample.
bool never_spills(std::span<const Sphere> balls, const SampledObject& object, const Context& context = {});
/// The inside samples (indices) that are not within any ball beyond doubt, ascending by z, y, x.
std::vector<std::array<std::int32_t, 3>> not_covered(std::span<const Sphere> balls, const SampledObject& object,
                                                     const Context& context = {});
/// Whether there are none of these: every inside sample is within some ball.
bool covers_all(std::span<const Sphere> balls, const SampledObject& object, const Context& context = {});

/// The ball with its radius cut to where never_spills holds for it; radius 0 when its centre is on an outside sample.
/// O(rows of the ball).
Sphere cut_to_object(const Sphere& ball, const SampledObject& object, const Context& context = {});
/// The least radius about `centre`, at least `radius`, with which covers_all holds for a sample at `sample` (indices).
double radius_to_reach(Vec3 centre, double radius, std::array<std::int32_t, 3> sample, const SampledObject& object);

}  // namespace spherule
