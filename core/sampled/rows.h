// SPDX-License-Identifier: GPL-3.0-or-later
//
// The samples within a ball, row by row. Private to core/simplify.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <cstdint>
#include <span>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/inside.h"
#include "core/volume.h"

namespace spherule::detail {

/// A half-open box of sample indices.
struct Window {
  std::array<std::int32_t, 3> begin{0, 0, 0}, end{0, 0, 0};
  std::int32_t size(std::size_t axis) const { return end[axis] - begin[axis]; }
};

/// LPS mm to mm along the grid's axes from its first sample.
inline Vec3 to_grid(const Grid& grid, Vec3 p) {
  const Vec3 d = p - grid.origin;
  return {dot(grid.direction.column(0), d), dot(grid.direction.column(1), d), dot(grid.direction.column(2), d)};
}
inline Sphere to_grid(const Grid& grid, const Sphere& ball) { return {to_grid(grid, ball.centre), ball.radius}; }

/// How far rounding can move the distance between a sample of the grid and a ball's surface, mm. Of the two dozen
/// roundings that lead from LPS coordinates to a chord's end, each is at most 2^-53 of the largest number that occurs
/// (for squares: 2^-53 of the radius); axes of the grid are unit vectors to 2^-50.
inline double rounding_bound(const Grid& grid, const Sphere& ball) {
  double largest = ball.radius;
  for (int a = 0; a < 3; ++a) {
    largest +=
        std::abs(ball.centre[a]) + std::abs(grid.origin[a]) + grid.spacing[a] * grid.dims[static_cast<std::size_t>(a)];
  }
  return 0x1p-46 * largest;
}

/// Samples along one axis, half-open.
struct Run {
  std::int32_t begin = 0, end = 0;
};

/// The indices i within [begin, end) of the samples with |i · spacing - at| <= reach. Rounding up and down by
/// conversion to integers: without it this is most of the time that small balls take.
inline Run samples_within(double per_mm, double at, double reach, std::int32_t begin, std::int32_t end) {
  const double lo = std::clamp((at - reach) * per_mm, double(begin), double(end));
  const double hi = std::clamp((at + reach) * per_mm, double(begin) - 1, double(end) - 1);
  auto first = static_cast<std::int32_t>(lo), last = static_cast<std::int32_t>(hi);
  first += first < lo;
  last -= last > hi;
  return {first, last + 1};
}

/// Calls visit(j, k, run) for every row of the window that the ball (in grid mm) reaches, z then y ascending; runs are
/// not empty.
template <typename Visit>
void visit_rows(Vec3 spacing, const Sphere& ball, const Window& window, Visit&& visit) {
  const Vec3 per_mm{1 / spacing.x, 1 / spacing.y, 1 / spacing.z};
  const Run ks = samples_within(per_mm.z, ball.centre.z, ball.radius, window.begin[2], window.end[2]);
  for (std::int32_t k = ks.begin; k < ks.end; ++k) {
    const double dz = k * spacing.z - ball.centre.z;
    const double disk = std::max(ball.radius * ball.radius - dz * dz, 0.0);
    const Run js = samples_within(per_mm.y, ball.centre.y, std::sqrt(disk), window.begin[1], window.end[1]);
    for (std::int32_t j = js.begin; j < js.end; ++j) {
      const double dy = j * spacing.y - ball.centre.y;
      const double half = std::sqrt(std::max(disk - dy * dy, 0.0));
      const Run run = samples_within(per_mm.x, ball.centre.x, half, window.begin[0], window.end[0]);
      if (run.begin < run.end) visit(j, k, run);
    }
  }
}

/// Calls f(word, mask) for each word that holds some of the bits [begin, end).
template <typename F>
void visit_words(std::size_t begin, std::size_t end, F&& f) {
  for (std::size_t w = begin / 64; w * 64 < end; ++w) {
    std::uint64_t mask = ~std::uint64_t{0};
    if (w == begin / 64) mask &= ~std::uint64_t{0} << (begin % 64);
    if (end < (w + 1) * 64) mask &= ~(~std::uint64_t{0} << (end % 64));
    f(w, mask);
  }
}

/// The window that holds every sample of the balls (in grid mm); empty for none. Indices are kept within a tenth of
/// what an int32 holds.
Window window_of(Vec3 spacing, std::span<const Sphere> balls);

/// The samples of a window that some ball (in grid mm) holds; sample 0 of the result is the window's first.
SampleBits held_samples(std::span<const Sphere> balls, Vec3 spacing, const Window& window, const Context& context);

}  // namespace spherule::detail
