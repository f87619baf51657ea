// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/solid.h"

#include <algorithm>
#include <cmath>
#include <functional>
#include <limits>
#include <numbers>
#include <numeric>

#include "core/base/check.h"
#include "core/base/disjoint_sets.h"
#include "core/base/elementary.h"
#include "core/base/int128.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/predicates.h"

namespace spherule {

namespace {

// Different edges of the cells, each counted at its smaller end.
std::size_t count_edges(std::span<const Tetrahedron> cells, std::size_t point_count, const Context& context) {
  constexpr std::size_t kGrain = 1 << 14;
  const auto for_each_edge = [&](auto visit) {
    Poll poll(context);
    for (const Tetrahedron& t : cells) {
      poll(8);
      for (std::size_t i = 0; i < 4; ++i) {
        for (std::size_t j = i + 1; j < 4; ++j) visit(std::min(t[i], t[j]), std::max(t[i], t[j]));
      }
    }
  };
  std::vector<std::size_t> start(point_count + 1, 0);
  for_each_edge([&](std::uint32_t lo, std::uint32_t) { ++start[lo + 1]; });
  std::partial_sum(start.begin(), start.end(), start.begin());
  std::vector<std::uint32_t> ends(start.back());
  {
    auto next = start;
    for_each_edge([&](std::uint32_t lo, std::uint32_t hi) { ends[next[lo]++] = hi; });
  }
  std::vector<std::size_t> part((point_count + kGrain - 1) / kGrain, 0);
  parallel_for(context, {}, point_count, kGrain, [&](std::size_t begin, std::size_t end) {
    Poll poll(context);
    for (std::size_t v = begin; v < end; ++v) {
      const auto from = ends.begin() + static_cast<std::ptrdiff_t>(start[v]),
                 to = ends.begin() + static_cast<std::ptrdiff_t>(start[v + 1]);
      std::sort(from, to, Polled(poll, std::less<>()));
      part[begin / kGrain] += static_cast<std::size_t>(std::unique(from, to) - from);
    }
  });
  return std::accumulate(part.begin(), part.end(), std::size_t{0});
}

// Pieces by corners; voids are the components of the rest of space, joined through facets, that do not reach infinity
// (around every edge and corner that the solid does not hold, the outside cells are joined through facets); tunnels
// from the Euler characteristic V - E + F - T.
Topology topology_of(const Solid& solid, std::span<const std::array<std::uint32_t, 4>> adjacent,
                     std::uint64_t boundary_facets, const Context& context) {
  const auto inside = std::span(solid.cells).first(solid.inside_count);
  const std::size_t point_count = solid.boundary.points.size();

  std::vector<std::uint8_t> used(point_count, 0);
  DisjointSets pieces(point_count);
  Poll poll(context);
  for (const Tetrahedron& t : inside) {
    poll(8);
    for (const std::uint32_t v : t) {
      used[v] = 1;
      pieces.unite(t[0], v);
    }
  }
  Topology topology;
  std::int64_t vertices = 0;
  for (std::uint32_t v = 0; v < point_count; ++v) {
    poll();
    vertices += used[v];
    topology.betti[0] += used[v] && pieces.is_root(v);
  }

  const std::size_t outside_count = solid.cells.size() - solid.inside_count;
  const auto infinite = static_cast<std::uint32_t>(outside_count);
  DisjointSets rest(outside_count + 1);
  for (std::size_t c = solid.inside_count; c < solid.cells.size(); ++c) {
    poll(8);
    for (const std::uint32_t other : adjacent[c]) {
      const auto here = static_cast<std::uint32_t>(c - solid.inside_count);
      if (other == no_cell) {
        rest.unite(here, infinite);
      } else if (other >= solid.inside_count) {
        rest.unite(here, static_cast<std::uint32_t>(other - solid.inside_count));
      }
    }
  }
  std::int64_t components = 0;
  for (std::uint32_t c = 0; c <= infinite; ++c) components += rest.is_root(c);
  topology.betti[2] = components - 1;

  const auto cells = static_cast<std::int64_t>(inside.size());
  const auto facets = (4 * cells + static_cast<std::int64_t>(boundary_facets)) / 2;
  const auto edges = static_cast<std::int64_t>(count_edges(inside, point_count, context));
  topology.euler_characteristic = vertices - edges + facets - cells;
  topology.betti[1] = topology.betti[0] + topology.betti[2] - topology.euler_characteristic;
  return topology;
}

// The integrals of 1, x and x·xᵀ over lattice tetrahedra, times 6, 24 and 120: whole numbers. Over anything that does
// not overlap itself within the lattice's cube of edge 2^24 the largest of them is below 120 · 2^120 < 2^127, so the
// sums fit.
struct LatticeMoments {
  Int128 volume = 0;
  std::array<Int128, 3> first{};
  std::array<Int128, 6> second{};  // xx, yy, zz, xy, yz, zx

  void add(const std::array<LatticePoint, 4>& corners) {
    const Int128 six = exact::six_volumes(corners[0], corners[1], corners[2], corners[3]);
    std::array<std::int64_t, 3> sum{};
    std::array<std::int64_t, 6> products{};
    for (const LatticePoint p : corners) {
      const std::int64_t x = p.x, y = p.y, z = p.z;
      sum[0] += x, sum[1] += y, sum[2] += z;
      products[0] += x * x, products[1] += y * y, products[2] += z * z;
      products[3] += x * y, products[4] += y * z, products[5] += z * x;
    }
    volume += six;
    for (std::size_t a = 0; a < 3; ++a) {
      first[a] += six * sum[a];
      second[a] += six * (products[a] + sum[a] * sum[a]);
      second[a + 3] += six * (products[a + 3] + sum[a] * sum[(a + 1) % 3]);
    }
  }
  LatticeMoments& operator+=(const LatticeMoments& other) {
    volume += other.volume;
    for (std::size_t a = 0; a < 3; ++a) first[a] += other.first[a];
    for (std::size_t a = 0; a < 6; ++a) second[a] += other.second[a];
    return *this;
  }
  // About the frame's origin, mm.
  Moments on(const Lattice& lattice) const {
    const auto at = [&](std::size_t a) { return static_cast<double>(second[a]) / 120; };
    const auto of = [&](std::size_t a) { return static_cast<double>(first[a]) / 24; };
    const Moments own{.volume = static_cast<double>(volume) / 6,
                      .first = {of(0), of(1), of(2)},
                      .second = {{Vec3{at(0), at(3), at(5)}, Vec3{at(3), at(1), at(4)}, Vec3{at(5), at(4), at(2)}}}};
    return translated(transformed(own, lattice.grid.direction, lattice.unit_mm), lattice.to_patient(LatticePoint{}));
  }
};

}  // namespace

VoxelMeasures measure_voxels(const Grid& grid, const SampleBits& inside) {
  const std::uint64_t count = inside.count();
  return {count, static_cast<double>(count) * (grid.spacing.x * grid.spacing.y * grid.spacing.z)};
}

Moments tetrahedra_moments(const Solid& solid, const Context& context) {
  const auto& points = solid.boundary.points;
  constexpr std::size_t kGrain = 1 << 16;
  std::vector<LatticeMoments> parts((solid.inside_count + kGrain - 1) / kGrain);
  parallel_for(context, {}, solid.inside_count, kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto& t = solid.cells[c];
      parts[begin / kGrain].add({points[t[0]], points[t[1]], points[t[2]], points[t[3]]});
    }
  });
  LatticeMoments moments;
  for (const LatticeMoments& part : parts) moments += part;
  return moments.on(solid.boundary.lattice);
}

TetrahedraMeasures measure_tetrahedra(const Solid& solid, const Context& context) {
  using exact::operator-;
  const auto& points = solid.boundary.points;
  TetrahedraMeasures measures;
  if (solid.inside_count == 0) return measures;
  const double unit = solid.boundary.lattice.unit_mm;

  context.report("tetrahedra", 0);
  const auto adjacent = neighbours(solid.cells, points.size(), context);
  constexpr std::size_t kGrain = 1 << 16;
  struct Part {
    double area = 0;
    std::uint64_t facets = 0;
  };
  std::vector<Part> parts((solid.inside_count + kGrain - 1) / kGrain);
  parallel_for(context, {}, solid.inside_count, kGrain, [&](std::size_t begin, std::size_t end) {
    Part& part = parts[begin / kGrain];
    for (std::size_t c = begin; c < end; ++c) {
      const auto& t = solid.cells[c];
      for (std::size_t i = 0; i < 4; ++i) {
        if (adjacent[c][i] < solid.inside_count) continue;
        const LatticePoint p = points[t[(i + 1) % 4]];
        const auto u = points[t[(i + 2) % 4]] - p, v = points[t[(i + 3) % 4]] - p;
        // Components of the cross product are below 2^49, exact in double.
        const Vec3 normal{static_cast<double>(u.y * v.z - u.z * v.y), static_cast<double>(u.z * v.x - u.x * v.z),
                          static_cast<double>(u.x * v.y - u.y * v.x)};
        part.area += norm(normal) / 2;
        ++part.facets;
      }
    }
  });
  for (const Part& part : parts) {
    measures.area_mm2 += part.area;
    measures.boundary_facets += part.facets;
  }
  measures.moments = tetrahedra_moments(solid, context);
  measures.volume_mm3 = measures.moments.volume;
  measures.area_mm2 *= unit * unit;
  context.report("tetrahedra", 0.5);
  measures.topology = topology_of(solid, adjacent, measures.boundary_facets, context);
  context.report("tetrahedra", 1);
  return measures;
}

RadiusHistogram radius_histogram(std::span<const Sphere> spheres, std::size_t buckets, RadiusScale scale) {
  if (buckets < 1 || buckets > 65536) {
    throw Error(ErrorCode::invalid_argument, "The number of buckets must be within 1 and 65536.",
                {{"buckets", "must be 1 to 65536"}});
  }
  const bool logarithmic = scale == RadiusScale::logarithmic;
  RadiusHistogram histogram{.scale = scale, .counts = std::vector<std::uint64_t>(buckets, 0)};
  double least = std::numeric_limits<double>::infinity(), most = 0;
  for (const Sphere& s : spheres) {
    if (logarithmic && !(s.radius > 0)) {
      ++histogram.zero_radius;
      continue;
    }
    least = std::min(least, s.radius), most = std::max(most, s.radius);
  }
  if (histogram.zero_radius == spheres.size()) return histogram;
  histogram.min_mm = least;
  histogram.max_mm = most;
  const auto place = [&](double radius) { return logarithmic ? elementary::log(radius) : radius; };
  const double from = place(least), width = (place(most) - from) / static_cast<double>(buckets);
  for (const Sphere& s : spheres) {
    if (logarithmic && !(s.radius > 0)) continue;
    const double bucket = width > 0 ? (place(s.radius) - from) / width : 0;
    ++histogram.counts[std::min(static_cast<std::size_t>(bucket), buckets - 1)];
  }
  return histogram;
}

Observations observations(const SphereModel& model, double density_mm, double tetrahedra_volume_mm3,
                          double spheres_volume_mm3) {
  SPHERULE_CHECK(model.solid.has_value());
  const BoundaryPoints& boundary = model.solid->boundary;
  const auto points = static_cast<double>(boundary.points.size());
  return {.excess_volume_mm3 = {.value = spheres_volume_mm3 - tetrahedra_volume_mm3,
                                .bound = (points - 2) * 4 / 3 * std::numbers::pi * elementary::pow(density_mm, 3)},
          .density_mm = {.value = density_mm, .bound = norm(boundary.lattice.grid.spacing) + boundary.lattice.unit_mm}};
}

}  // namespace spherule
