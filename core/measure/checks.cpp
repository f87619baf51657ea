// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/checks.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <numbers>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/base/progress.h"
#include "core/measure/solid.h"
#include "core/predicates.h"

namespace spherule {

namespace {

constexpr std::size_t kGrain = 1 << 10;

// Sets a run of bits of one row; rows may be shared between threads. Bits are only ever set, so order does not matter.
void set_run(std::span<std::uint64_t> row, std::size_t first, std::size_t last) {
  for (std::size_t w = first / 64; w <= last / 64; ++w) {
    std::uint64_t mask = ~std::uint64_t{0};
    if (w == first / 64) mask &= ~std::uint64_t{0} << (first % 64);
    if (w == last / 64) mask &= ~std::uint64_t{0} >> (63 - last % 64);
    std::atomic_ref<std::uint64_t> word(row[w]);
    if ((word.load(std::memory_order_relaxed) & mask) != mask) word.fetch_or(mask, std::memory_order_relaxed);
  }
}

// Marks, over the padded grid, the samples strictly inside the circumsphere of one cell; exact. Coordinates are below
// 2^24. A ball that matters has a radius below 2^25, so squared distances are below 2^50 and, over four roundings, off
// by less than 1 square unit in double, half chords by less than 1 unit. Planes are at least 64 units apart: only the
// two samples at the ends of a chord can be in doubt, and those are tested with the exact predicate.
class BallRasteriser {
 public:
  BallRasteriser(const Lattice& lattice, Border border)
      : lattice_(lattice), margin_(border == Border::closed ? 1 : 0) {}

  void mark(const std::array<LatticePoint, 4>& corners, Vec3 centre, double radius, SampleBits& covered,
            Poll& poll) const {
    const auto [k0, k1] = planes_within(2, centre.z, radius + 1);
    for (std::int32_t k = k0; k <= k1; ++k) {
      const double dz = lattice_.plane(2, k) - centre.z;
      const double disk = radius * radius - dz * dz;
      if (disk < -1) continue;
      const auto [j0, j1] = planes_within(1, centre.y, std::sqrt(std::max(disk, 0.0)) + 1);
      for (std::int32_t j = j0; j <= j1; ++j) {
        poll(16);
        const double dy = lattice_.plane(1, j) - centre.y;
        const double chord = disk - dy * dy;
        if (chord < -1) continue;
        auto [i0, i1] = planes_within(0, centre.x, std::sqrt(std::max(chord, 0.0)) + 1);
        while (i0 <= i1 && !holds(corners, i0, j, k)) ++i0;
        while (i0 <= i1 && !holds(corners, i1, j, k)) --i1;
        if (i0 <= i1)
          set_run(covered.row(j + 1, k + 1), static_cast<std::size_t>(i0 + 1), static_cast<std::size_t>(i1 + 1));
      }
    }
  }

 private:
  // Sample planes with |plane - at| <= reach, as an index range (empty: first > second).
  std::array<std::int32_t, 2> planes_within(int axis, double at, double reach) const {
    const auto& planes = lattice_.planes[static_cast<std::size_t>(axis)];
    const auto begin = planes.begin() + (1 - margin_), end = planes.end() - (1 - margin_);
    const double steps = static_cast<double>(planes.size() - 1) / planes.back();
    const auto guess = [&](double coordinate) {
      return begin + static_cast<std::ptrdiff_t>(
                         std::clamp(coordinate * steps - (1 - margin_), 0.0, static_cast<double>(end - begin)));
    };
    auto low = guess(at - reach), high = guess(at + reach);
    while (low > begin && *(low - 1) >= at - reach) --low;
    while (low < end && *low < at - reach) ++low;
    while (high > begin && *(high - 1) > at + reach) --high;
    while (high < end && *high <= at + reach) ++high;
    return {static_cast<std::int32_t>(low - planes.begin()) - 1, static_cast<std::int32_t>(high - planes.begin()) - 2};
  }
  bool holds(const std::array<LatticePoint, 4>& c, std::int32_t i, std::int32_t j, std::int32_t k) const {
    return exact::in_sphere(c[0], c[1], c[2], c[3],
                            {lattice_.plane(0, i), lattice_.plane(1, j), lattice_.plane(2, k)}) > 0;
  }

  const Lattice& lattice_;
  int margin_;
};

SampleBits covered_samples(const Solid& solid, Border border, const Context& context) {
  const auto [nx, ny, nz] = solid.boundary.lattice.grid.dims;
  SampleBits covered({nx + 2, ny + 2, nz + 2});
  const BallRasteriser rasteriser(solid.boundary.lattice, border);
  const auto& points = solid.boundary.points;
  parallel_for(context, "samples in balls", solid.inside_count, kGrain, [&](std::size_t begin, std::size_t end) {
    Poll poll(context);
    for (std::size_t c = begin; c < end; ++c) {
      poll(16);
      const auto& [p, q, r, s] = solid.cells[c];
      const std::array<LatticePoint, 4> corners{points[p], points[q], points[r], points[s]};
      const Sphere ball = circumsphere(corners);
      rasteriser.mark(corners, ball.centre, ball.radius, covered, poll);
    }
  });
  return covered;
}

// Samples that an open border leaves outside the hull of the boundary points: no tetrahedron can hold them.
class Hull {
 public:
  Hull(const Solid& solid, std::span<const std::array<std::uint32_t, 4>> adjacent, Poll& poll) : poll_(poll) {
    const auto& points = solid.boundary.points;
    for (std::size_t c = 0; c < adjacent.size(); ++c) {
      poll_(4);
      for (std::size_t i = 0; i < 4; ++i) {
        if (adjacent[c][i] != no_cell) continue;
        auto t = solid.cells[c];
        // The apex first, by an even permutation of the corners: then (apex, facet) is positively oriented.
        if (i == 1) t = {t[1], t[0], t[3], t[2]};
        if (i == 2) t = {t[2], t[3], t[0], t[1]};
        if (i == 3) t = {t[3], t[2], t[1], t[0]};
        facets_.push_back({points[t[1]], points[t[2]], points[t[3]]});
      }
    }
  }
  // Neighbouring samples are mostly beyond the same facet, so the last one that decided is tried first.
  bool excludes(LatticePoint p) {
    const auto beyond = [p](const auto& f) { return exact::orientation(p, f[0], f[1], f[2]) < 0; };
    if (last_ < facets_.size() && beyond(facets_[last_])) return true;
    for (last_ = 0; last_ < facets_.size(); ++last_) {
      poll_();
      if (beyond(facets_[last_])) return true;
    }
    return false;
  }

 private:
  Poll& poll_;
  std::vector<std::array<LatticePoint, 3>> facets_;
  std::size_t last_ = 0;
};

}  // namespace

ModelChecks check_model(const SphereModel& model, const SampleBits& inside, Border border, const Context& context) {
  SPHERULE_CHECK(model.solid.has_value());
  const Solid& solid = *model.solid;
  const Lattice& lattice = solid.boundary.lattice;
  SPHERULE_CHECK(inside.dims() == lattice.grid.dims);
  ModelChecks checks;

  const auto adjacent = neighbours(solid.cells, solid.boundary.points.size(), context);
  checks.criteria.boundary_points_inside_balls =
      count_not_delaunay(solid.boundary.points, solid.cells, adjacent, context);

  std::vector<std::uint8_t> touched(solid.boundary.points.size(), 0);
  Poll poll(context);
  for (const Tetrahedron& t : std::span(solid.cells).first(solid.inside_count)) {
    poll(4);
    for (const std::uint32_t v : t) touched[v] = 1;
  }
  checks.criteria.boundary_points_on_no_ball = static_cast<std::uint64_t>(std::ranges::count(touched, 0));

  const SampleBits expected = padded(inside);
  const SampleBits covered = covered_samples(solid, border, context);
  std::optional<Hull> hull;
  if (border == Border::open) hull.emplace(solid, adjacent, poll);
  const auto [px, py, pz] = expected.dims();
  for (std::int32_t k = 0; k < pz; ++k) {
    for (std::int32_t j = 0; j < py; ++j) {
      const auto want = expected.row(j, k), have = covered.row(j, k);
      poll(want.size());
      for (std::size_t w = 0; w < want.size(); ++w) {
        checks.criteria.outside_samples_covered += static_cast<std::uint64_t>(std::popcount(have[w] & ~want[w]));
        for (std::uint64_t missing = want[w] & ~have[w]; missing != 0; missing &= missing - 1) {
          poll();
          const auto i = static_cast<std::int32_t>(64 * w) + std::countr_zero(missing);
          const LatticePoint sample{lattice.plane(0, i - 1), lattice.plane(1, j - 1), lattice.plane(2, k - 1)};
          if (!hull || !hull->excludes(sample)) ++checks.criteria.inside_samples_not_covered;
        }
      }
    }
  }

  const double delta = boundary_point_density(solid, context);
  const double volume = measure_tetrahedra(solid, quiet(context)).volume_mm3;
  const auto n = static_cast<double>(solid.boundary.points.size());
  checks.bounds = {.density_mm = delta,
                   .density_bound_mm = norm(lattice.grid.spacing) + lattice.unit_mm,
                   .cells_per_point = static_cast<double>(solid.inside_count) / n,
                   .tetrahedra_volume_mm3 = volume,
                   .spheres_volume_bound_mm3 = volume + (n - 2) * 4 / 3 * std::numbers::pi * delta * delta * delta};
  return checks;
}

}  // namespace spherule
