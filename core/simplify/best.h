// SPDX-License-Identifier: GPL-3.0-or-later
//
// The k spheres whose union overlaps best with the object: greedy choice among the model's own balls, then refinement.
// Beyond the paper.
#pragma once

#include <cstddef>
#include <cstdint>
#include <optional>

#include "core/base/context.h"
#include "core/sampled/object.h"
#include "core/simplify/result.h"
#include "core/spheres.h"

namespace spherule {

struct BestOptions {
  enum class Mode : std::uint8_t {
    inner,  ///< no outside sample is in any ball (never_spills holds)
    best,   ///< the largest overlap
    outer,  ///< every inside sample is in some ball (covers_all holds)
  };
  Mode mode = Mode::best;
  // Exactly one of these.
  std::optional<std::uint32_t> k{};  ///< spheres wanted: 1 … the model's count, at most 65,535
  std::optional<double> iou{};       ///< overlap to reach, in (0, 1], with about the fewest spheres that do
};

struct BestSpheres {
  Simplification simplification;
  /// inner: the part by which a better choice of as many of the candidates could at most cover more samples.
  std::optional<double> optimality_gap;
};

/// Throws what best_spheres throws for options out of their bounds for a model of so many spheres.
void check_options(const BestOptions& options, std::size_t model_count);

/// Candidates are the model's inside poles, thinned. A lazy greedy cover orders them by the samples that each adds, on
/// rows of bits; they hold no outside sample. `inner` is that order. Else the first 1, 2, 4 … k of it are refined, each
/// set by itself: all balls together climb the gradient of a softened overlap, balls that are worth less than the best
/// candidate move to it, and at last one ball at a time tries small steps, which stay where they gain samples. Up to 16
/// (256 of an object of at most 100,000 samples) also start from average splitting's clusters, and the better set
/// stays. Then, for `best`, all radii change alike until the union's exact volume is the object's (where that hardly
/// costs overlap), and for `outer` every ball takes in the samples of its power cell. Level k shows the last refined
/// set and the next of the order. Fewer than k spheres come back when they cover every sample. Every sphere of the
/// model is a member, of the sphere in whose power cell it is centred. A function of its arguments alone. Works on
/// about 200,000 samples or 1,000 a sphere where there are more, and at last on all; sets of fewer than k on fewer.
/// About 10 bytes a sample. Throws invalid_argument for other than one of k and iou or one out of its bounds, unusable
/// for an overlap that is not reached and for a model without volume. Reports stage "best".
BestSpheres best_spheres(const SphereModel& model, const SampledObject& object, const BestOptions& options = {},
                         const Context& context = {});

}  // namespace spherule
