// SPDX-License-Identifier: GPL-3.0-or-later
//
// Local thickness: at every point of a union of balls, the diameter of the largest ball that holds it.
// Source: T. Hildebrand, P. Rüegsegger, A new method for the model-independent assessment of thickness in
// three-dimensional images (1997); the model's own balls take the place of all balls within the object.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/spheres.h"

namespace spherule {

/// Figures weigh every point of the union alike. All zero for a union without volume.
struct LocalThickness {
  static constexpr std::array<int, 5> percents{5, 25, 50, 75, 95};

  double mean_mm = 0, sd_mm = 0, min_mm = 0, max_mm = 0;
  std::array<double, 5> percentiles_mm{};  ///< of `percents` of the volume the thickness is at most this
  std::vector<double> volumes_mm3;         ///< in equal intervals of [min_mm, max_mm]; the last one is closed
  std::uint64_t samples = 0;               ///< points of the lattice in the union
  double spacing_mm = 0;                   ///< of the lattice
  double sampled_volume_mm3 =
      0;  ///< samples times the lattice's cell: its distance from the exact volume shows the error
};

/// Samples the union on a cubic lattice, oblique to the frame, of which about `samples` points lie in the union: its
/// spacing is the cube root of volume_mm3 / samples, where volume_mm3 is that of the union (measure_union). Each point
/// takes the first ball, in descending order of radius, that holds it. The error of a mean is that of counting
/// lattice points: with the default, some 1e-4 of it for a head or a liver.
/// O(n log n + rows of lattice points in balls that larger balls have left open), and a little for every ball in each
/// block of 64³ points that it reaches. Memory: 60 bytes a ball.
/// Throws invalid_argument unless buckets is within 1 … 65536. Reports stage "thickness".
LocalThickness local_thickness(std::span<const Sphere> balls, double volume_mm3, std::size_t buckets = 40,
                               std::uint64_t samples = std::uint64_t{1} << 22, const Context& context = {});

/// The same of a model; a raw one takes far less time, where thousands of balls may nearly coincide, for which part
/// of the union belongs to which ball is known beforehand. Memory: 110 bytes a ball.
LocalThickness local_thickness(const SphereModel& model, double volume_mm3, std::size_t buckets = 40,
                               std::uint64_t samples = std::uint64_t{1} << 22, const Context& context = {});

}  // namespace spherule
