// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/power.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Fixed_alpha_shape_3.h>
#include <CGAL/Fixed_alpha_shape_cell_base_3.h>
#include <CGAL/Fixed_alpha_shape_vertex_base_3.h>
#include <CGAL/Regular_triangulation_3.h>
#include <CGAL/Triangulation_cell_base_with_info_3.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>

#include <algorithm>
#include <array>
#include <utility>
#include <vector>

#include "core/base/disjoint_sets.h"

namespace spherule {

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Numbered = CGAL::Triangulation_vertex_base_with_info_3<std::uint32_t, Kernel,
                                                             CGAL::Regular_triangulation_vertex_base_3<Kernel>>;
using NumberedCell =
    CGAL::Triangulation_cell_base_with_info_3<std::uint32_t, Kernel, CGAL::Regular_triangulation_cell_base_3<Kernel>>;
using Vertex = CGAL::Fixed_alpha_shape_vertex_base_3<Kernel, Numbered>;
using Cell = CGAL::Fixed_alpha_shape_cell_base_3<Kernel, NumberedCell>;
using Triangulation = CGAL::Regular_triangulation_3<Kernel, CGAL::Triangulation_data_structure_3<Vertex, Cell>>;
using DualComplex = CGAL::Fixed_alpha_shape_3<Triangulation>;
using Weighted = Triangulation::Weighted_point;

// The library needs four points that are not in one plane. These are far away, and no ball at all: their power is
// positive where any ball's is not, so they change nothing within the union.
std::array<Weighted, 4> surroundings(const Box& box) {
  const Vec3 size = box.max - box.min, middle = 0.5 * (box.min + box.max);
  const double far = 8 * std::max({size.x, size.y, size.z, 1.0});
  const auto at = [&](double x, double y, double z) {
    return Weighted({middle.x + far * x, middle.y + far * y, middle.z + far * z}, -far * far);
  };
  return {at(1, 1, 1), at(1, -1, -1), at(-1, 1, -1), at(-1, -1, 1)};
}

}  // namespace

Topology union_topology(std::span<const Sphere> balls, const Context& context) {
  if (balls.empty()) return {};
  Box box;
  std::vector<Weighted> points;
  points.reserve(balls.size() + 4);
  for (const Sphere& s : balls) {
    box.include(s);
    points.emplace_back(Kernel::Point_3(s.centre.x, s.centre.y, s.centre.z), s.radius * s.radius);
  }
  for (const Weighted& point : surroundings(box)) points.push_back(point);
  context.throw_if_cancelled();
  Triangulation triangulation(points.begin(), points.end());
  context.throw_if_cancelled();
  DualComplex complex(triangulation, 0);
  context.throw_if_cancelled();
  const auto holds = [&](const auto& simplex) { return complex.classify(simplex) != DualComplex::EXTERIOR; };

  std::uint32_t vertex_count = 0, cell_count = 0;
  for (const auto v : complex.all_vertex_handles()) v->info() = vertex_count++;
  for (const auto c : complex.all_cell_handles()) c->info() = cell_count++;

  Topology topology;
  std::int64_t vertices = 0, edges = 0, facets = 0, cells = 0;
  DisjointSets pieces(vertex_count), rest(cell_count);
  for (const auto& e : complex.finite_edges()) {
    if (!holds(e)) continue;
    ++edges;
    pieces.unite(e.first->vertex(e.second)->info(), e.first->vertex(e.third)->info());
  }
  for (const auto v : complex.finite_vertex_handles()) {
    if (!holds(v)) continue;
    ++vertices;
    topology.betti[0] += pieces.is_root(v->info());
  }
  for (const auto& f : complex.all_facets()) {
    if (!complex.is_infinite(f) && holds(f)) {
      ++facets;
    } else {
      rest.unite(f.first->info(), f.first->neighbor(f.second)->info());
    }
  }
  // Infinite cells are all joined, through infinite facets.
  std::int64_t components = 0;
  for (const auto c : complex.all_cell_handles()) {
    if (!complex.is_infinite(c) && holds(c)) {
      ++cells;
    } else {
      components += rest.is_root(c->info());
    }
  }
  topology.betti[2] = components - 1;
  topology.euler_characteristic = vertices - edges + facets - cells;
  topology.betti[1] = topology.betti[0] + topology.betti[2] - topology.euler_characteristic;
  return topology;
}

}  // namespace spherule
