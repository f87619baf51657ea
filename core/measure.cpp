// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/check.h"
#include "core/base/disjoint_sets.h"
#include "core/base/int128.h"
#include "core/base/parallel.h"
#include "core/predicates.h"

namespace spherule {

namespace {

// Different edges of the cells, each counted at its smaller end.
std::size_t count_edges(std::span<const Tetrahedron> cells, std::size_t point_count, const Context& context) {
  constexpr std::size_t kGrain = 1 << 14;
  const auto for_each_edge = [&](auto visit) {
    for (const Tetrahedron& t : cells) {
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
    for (std::size_t v = begin; v < end; ++v) {
      const auto from = ends.begin() + static_cast<std::ptrdiff_t>(start[v]),
                 to = ends.begin() + static_cast<std::ptrdiff_t>(start[v + 1]);
      std::sort(from, to);
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
  for (const Tetrahedron& t : inside) {
    for (const std::uint32_t v : t) {
      used[v] = 1;
      pieces.unite(t[0], v);
    }
  }
  Topology topology;
  std::int64_t vertices = 0;
  for (std::uint32_t v = 0; v < point_count; ++v) {
    vertices += used[v];
    topology.betti[0] += used[v] && pieces.is_root(v);
  }

  const std::size_t outside_count = solid.cells.size() - solid.inside_count;
  const auto infinite = static_cast<std::uint32_t>(outside_count);
  DisjointSets rest(outside_count + 1);
  for (std::size_t c = solid.inside_count; c < solid.cells.size(); ++c) {
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

}  // namespace

VoxelMeasures measure_voxels(const Grid& grid, const SampleBits& inside) {
  const std::uint64_t count = inside.count();
  return {count, static_cast<double>(count) * (grid.spacing.x * grid.spacing.y * grid.spacing.z)};
}

TetrahedraMeasures measure_tetrahedra(const Solid& solid, const Context& context) {
  using exact::operator-;
  const auto& points = solid.boundary.points;
  const double unit = solid.boundary.lattice.unit_mm;
  TetrahedraMeasures measures;

  // 2^32 cells of at most 2^74 each: the sum fits.
  Int128 six_volumes = 0;
  for (const auto& [a, b, c, d] : std::span(solid.cells).first(solid.inside_count)) {
    six_volumes += exact::six_volumes(points[a], points[b], points[c], points[d]);
  }
  measures.volume_mm3 = static_cast<double>(six_volumes) / 6 * unit * unit * unit;

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
      for (std::size_t i = 0; i < 4; ++i) {
        if (adjacent[c][i] < solid.inside_count) continue;
        const auto& t = solid.cells[c];
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
  measures.area_mm2 *= unit * unit;
  measures.topology = topology_of(solid, adjacent, measures.boundary_facets, context);
  return measures;
}

RadiusHistogram radius_histogram(std::span<const Sphere> spheres, std::size_t buckets) {
  if (buckets < 1 || buckets > 65536) {
    throw Error(ErrorCode::invalid_argument, "The number of buckets must be within 1 and 65536.",
                {{"buckets", "must be 1 to 65536"}});
  }
  RadiusHistogram histogram{.counts = std::vector<std::uint64_t>(buckets, 0)};
  if (spheres.empty()) return histogram;
  const auto [least, largest] = std::ranges::minmax(spheres, {}, &Sphere::radius);
  histogram.min_mm = least.radius;
  histogram.max_mm = largest.radius;
  const double width = (histogram.max_mm - histogram.min_mm) / static_cast<double>(buckets);
  for (const Sphere& s : spheres) {
    const double bucket = width > 0 ? (s.radius - histogram.min_mm) / width : 0;
    ++histogram.counts[std::min(static_cast<std::size_t>(bucket), buckets - 1)];
  }
  return histogram;
}

}  // namespace spherule
