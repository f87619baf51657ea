// SPDX-License-Identifier: GPL-3.0-or-later
//
// Maximum coverage: which k of many balls within an object cover most of its samples. Private to core/simplify.
//
// Sources: G. Nemhauser, L. Wolsey, M. Fisher, An analysis of approximations for maximizing submodular set functions
// (1978): greedy covers at least 1 - 1/e of the best; M. Minoux, Accelerated greedy algorithms (1978): lazily.
#pragma once

#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/sampled/object.h"
#include "core/spheres.h"

namespace spherule::detail {

struct Cover {
  std::vector<std::uint32_t> order;    ///< candidates, each adding most to those before it (ties: the first)
  std::vector<std::uint64_t> covered;  ///< inside samples in the first i + 1 of them
  std::uint64_t bound = 0;             ///< the most inside samples that any `order.size()` candidates can cover
};

/// Chooses up to k of the candidates (LPS mm); fewer once no other adds anything. O(rows of balls) an evaluation, on
/// bits; few candidates are evaluated more than a few times.
Cover greedy_cover(std::span<const Sphere> candidates, const SampledObject& object, std::size_t k,
                   const Context& context);

/// Candidates for covers of about k balls: those of `balls`, the largest first, that are not close to a larger one kept
/// (within 0.3 of the radius), up to a few dozen times k; all distinct ones where that leaves too few. O(n log n).
std::vector<Sphere> thinned(std::vector<Sphere> balls, std::size_t k, const Context& context = {});

/// The inside poles of a raw model, the largest inside ball at every boundary point (N. Amenta, M. Bern, Surface
/// reconstruction by Voronoi filtering, 1999), each once; all balls of any other model.
std::vector<Sphere> poles(const SphereModel& model, const Context& context = {});

}  // namespace spherule::detail
