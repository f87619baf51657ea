// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/power.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Filtered_predicate.h>
#include <CGAL/Regular_triangulation_3.h>
#include <CGAL/Triangulation_cell_base_with_info_3.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>
#include <string>
#include <tuple>
#include <utility>

#include "core/base/check.h"
#include "core/base/disjoint_sets.h"
#include "core/base/poll.h"
#include "core/most_cells.h"
#include "core/spatial_order.h"

namespace spherule {

namespace {

using Plain = CGAL::Exact_predicates_inexact_constructions_kernel;
using Exact = Plain::Exact_kernel;
using ExactRing = Plain::Exact_kernel_rt;  // without division, and much faster
using Interval = Plain::Approximate_kernel;

// A weighted point of ours has a radius in place of its weight, with the weight's sign: the square would be rounded.
// It is formed in the arithmetic that decides.
template <typename To>
struct Squaring : CGAL::Cartesian_converter<Plain, To> {
  using Base = CGAL::Cartesian_converter<Plain, To>;
  using Base::operator();
  typename To::Weighted_point_3 operator()(const Plain::Weighted_point_3& p) const {
    const typename To::FT radius = Base::operator()(p.weight());
    const typename To::FT square = radius * radius;
    return {Base::operator()(p.point()), p.weight() < 0 ? typename To::FT(-square) : square};
  }
};

template <template <typename> typename Predicate, typename Decides>
using Filtered =
    CGAL::Filtered_predicate<Predicate<Decides>, Predicate<Interval>, Squaring<Decides>, Squaring<Interval>>;

template <typename K>
using SideOfSphere = typename K::Power_side_of_oriented_power_sphere_3;
template <typename K>
using SideOfSmallest = typename K::Power_side_of_bounded_power_sphere_3;
template <typename K>
using CompareSize = typename K::Compare_weighted_squared_radius_3;

// The power at a ball's own centre: of another ball, compared with its own.
template <typename K>
struct ComparePowerAtCentre {
  using result_type = typename K::Comparison_result;
  result_type operator()(const typename K::Weighted_point_3& own, const typename K::Weighted_point_3& other) const {
    return CGAL::compare(typename K::FT(CGAL::squared_distance(own.point(), other.point()) - other.weight()),
                         typename K::FT(-own.weight()));
  }
};

// The distance of two centres, compared with the sum of the radii: here weights are radii.
template <typename K>
struct CompareReach {
  using result_type = typename K::Comparison_result;
  result_type operator()(const typename K::Weighted_point_3& a, const typename K::Weighted_point_3& b) const {
    const typename K::FT reach = a.weight() + b.weight();
    return CGAL::compare(typename K::FT(CGAL::squared_distance(a.point(), b.point())), typename K::FT(reach * reach));
  }
};

struct Traits : Plain {
  using Power_side_of_oriented_power_sphere_3 = Filtered<SideOfSphere, ExactRing>;
  Power_side_of_oriented_power_sphere_3 power_side_of_oriented_power_sphere_3_object() const { return {}; }
};

// Balls that lost their cell need not be remembered: none is ever taken away.
struct Nothing {
  using iterator = const Plain::Weighted_point_3*;
  using const_iterator = iterator;
  static iterator begin() { return nullptr; }
  static iterator end() { return nullptr; }
};
using VertexBase = CGAL::Triangulation_vertex_base_with_info_3<std::uint32_t, Traits,
                                                               CGAL::Regular_triangulation_vertex_base_3<Traits>>;
using CellBase =
    CGAL::Regular_triangulation_cell_base_3<Traits, CGAL::Triangulation_cell_base_with_info_3<std::uint32_t, Traits>,
                                            CGAL::Tag_false, Nothing>;
using Triangulation = CGAL::Regular_triangulation_3<Traits, CGAL::Triangulation_data_structure_3<VertexBase, CellBase>>;
using Weighted = Triangulation::Weighted_point;

constexpr std::uint32_t kFar = 0xffffffffU;  // the number of a vertex that is no ball
constexpr std::uint32_t kPoll = 64;

Weighted weighted(const Sphere& ball) {
  return Weighted(Plain::Point_3(ball.centre.x, ball.centre.y, ball.centre.z), ball.radius);
}

// The library needs four points that are not in one plane. These are far away, and no ball at all: their power is
// positive where any ball's is not, so they change nothing within the union.
std::array<Weighted, 4> surroundings(std::span<const Sphere> balls) {
  Box box;
  for (const Sphere& ball : balls) box.include(ball);
  const Vec3 size = box.max - box.min, middle = 0.5 * (box.min + box.max);
  const double far = 8 * std::max({size.x, size.y, size.z, 1.0});
  const auto at = [&](double x, double y, double z) {
    return Weighted({middle.x + far * x, middle.y + far * y, middle.z + far * z}, -far);
  };
  return {at(1, 1, 1), at(1, -1, -1), at(-1, 1, -1), at(-1, -1, 1)};
}

// Of balls with one centre the first of the largest.
std::vector<std::uint32_t> with_own_centre(std::span<const Sphere> balls, const Context& context) {
  std::vector<std::uint32_t> order(balls.size());
  std::iota(order.begin(), order.end(), 0U);
  const auto key = [&](std::uint32_t i) {
    const Sphere& b = balls[i];
    return std::tuple(b.centre.x, b.centre.y, b.centre.z, -b.radius, i);
  };
  Poll poll(context);
  std::sort(order.begin(), order.end(),
            Polled(poll, [&](std::uint32_t a, std::uint32_t b) { return key(a) < key(b); }));
  const auto same = [&](std::uint32_t a, std::uint32_t b) { return balls[a].centre == balls[b].centre; };
  order.erase(std::unique(order.begin(), order.end(), same), order.end());
  return order;
}

// Vertices bear the numbers of their balls.
Triangulation triangulated(std::span<const Sphere> balls, const Context& context) {
  SPHERULE_CHECK(balls.size() < kFar);
  const std::vector<std::uint32_t> own = with_own_centre(balls, context);
  std::vector<Vec3> centres;
  centres.reserve(own.size());
  for (const std::uint32_t i : own) centres.push_back(balls[i].centre);

  Triangulation triangulation;
  for (const Weighted& point : surroundings(balls)) triangulation.insert(point)->info() = kFar;
  const std::size_t most = most_cells(balls.size());
  Triangulation::Cell_handle near = triangulation.infinite_cell();
  Poll poll(context, kPoll);
  for (const std::uint32_t n : insertion_order(centres, context)) {
    const std::uint32_t i = own[n];
    poll();
    if (triangulation.number_of_cells() > most) {
      throw Error(ErrorCode::too_large,
                  "These spheres bound each other in too many places (their power diagram would have more than " +
                      std::to_string(most) + " cells); leave some of them out.");
    }
    const Weighted point = weighted(balls[i]);
    Triangulation::Locate_type kind;
    int facet, edge;
    near = triangulation.locate(point, kind, facet, edge, near);
    const Triangulation::Vertex_handle vertex = triangulation.insert(point, kind, near, facet, edge);
    if (vertex == Triangulation::Vertex_handle()) continue;  // hidden
    vertex->info() = i;
    near = vertex->cell();
  }
  return triangulation;
}

// The simplices of a power diagram's dual triangulation that are part of the dual complex: those whose smallest
// orthogonal sphere has no positive square and no other ball within (their balls' cells meet within these balls), and
// all faces of such.
class DualComplex {
 public:
  DualComplex(Triangulation& triangulation, std::size_t balls, const Context& context)
      : t_(triangulation), in_ball_(balls, 0), covered_(balls, 0), pieces_(balls), context_(context) {}

  Topology topology() {
    add_cells();
    add_facets();
    add_edges();
    add_vertices();
    topology_.euler_characteristic = counts_[0] - counts_[1] + counts_[2] - counts_[3];
    topology_.betti[1] = topology_.betti[0] + topology_.betti[2] - topology_.euler_characteristic;
    return topology_;
  }

 private:
  using Cell = Triangulation::Cell_handle;
  using Vertex = Triangulation::Vertex_handle;

  template <typename... Vertices>
  static bool far(Vertices... v) {
    return ((v->info() == kFar) || ...);
  }
  template <typename... Vertices>
  bool small(Vertices... v) const {
    return compare_size_(v->point()..., 0.0) != CGAL::LARGER;
  }
  // Whether no ball within the smallest orthogonal sphere of the first ones is v's.
  template <typename... Vertices>
  bool free_of(Vertex v, Vertices... simplex) const {
    return t_.is_infinite(v) || side_(simplex->point()..., v->point()) != CGAL::ON_BOUNDED_SIDE;
  }

  void add_cells() {
    std::uint32_t number = 0;
    for (const Cell c : t_.all_cell_handles()) c->info() = number++;
    in_cell_.assign(number, 0);
    in_facet_.assign(number, 0);
    Poll poll(context_, kPoll);
    for (const Cell c : t_.finite_cell_handles()) {
      poll();
      const Vertex p = c->vertex(0), q = c->vertex(1), r = c->vertex(2), s = c->vertex(3);
      if (far(p, q, r, s) || !small(p, q, r, s)) continue;
      in_cell_[c->info()] = 1;
      ++counts_[3];
    }
  }

  // Voids are what the rest of space falls into, joined through facets, but for the part around all.
  void add_facets() {
    DisjointSets rest(in_cell_.size());
    Poll poll(context_, kPoll);
    for (const auto& [c, i] : t_.all_facets()) {
      poll();
      const Cell other = c->neighbor(i);
      if (!holds_facet(c, i, other)) {
        rest.unite(c->info(), other->info());
        continue;
      }
      ++counts_[2];
      in_facet_[c->info()] |= static_cast<std::uint8_t>(1U << i);
      in_facet_[other->info()] |= static_cast<std::uint8_t>(1U << other->index(c));
    }
    // Infinite cells are all joined, through infinite facets.
    std::int64_t components = 0;
    for (std::uint32_t c = 0; c < in_cell_.size(); ++c) components += !in_cell_[c] && rest.is_root(c);
    topology_.betti[2] = components - 1;
  }
  bool holds_facet(Cell c, int i, Cell other) const {
    if (in_cell_[c->info()] || in_cell_[other->info()]) return true;
    const Vertex p = c->vertex((i + 1) & 3), q = c->vertex((i + 2) & 3), r = c->vertex((i + 3) & 3);
    if (t_.is_infinite(p) || t_.is_infinite(q) || t_.is_infinite(r) || far(p, q, r)) return false;
    return small(p, q, r) && free_of(c->vertex(i), p, q, r) && free_of(other->vertex(other->index(c)), p, q, r);
  }

  void add_edges() {
    Poll poll(context_, kPoll);
    for (const auto& e : t_.finite_edges()) {
      poll();
      const Vertex u = e.first->vertex(e.second), v = e.first->vertex(e.third);
      if (far(u) || far(v)) continue;
      // Whether a ball has its centre in its own cell is known from its neighbours.
      covered_[u->info()] |= at_centre_(u->point(), v->point()) == CGAL::SMALLER;
      covered_[v->info()] |= at_centre_(v->point(), u->point()) == CGAL::SMALLER;
      if (!holds_edge(e, u, v, poll)) continue;
      ++counts_[1];
      in_ball_[u->info()] = in_ball_[v->info()] = 1;
      pieces_.unite(u->info(), v->info());
    }
  }
  bool holds_edge(const Triangulation::Edge& e, Vertex u, Vertex v, Poll& poll) const {
    const bool is_small = small(u, v);
    bool is_free = is_small;
    auto facet = t_.incident_facets(e);
    const auto end = facet;
    do {
      poll();
      const auto& [c, i] = *facet;
      if (in_facet_[c->info()] >> i & 1) return true;
      const Vertex w = c->vertex(6 - i - c->index(u) - c->index(v));
      is_free = is_free && free_of(w, u, v);
    } while (++facet != end);
    return is_free;
  }

  void add_vertices() {
    for (const Vertex v : t_.finite_vertex_handles()) {
      if (far(v) || (!in_ball_[v->info()] && covered_[v->info()])) continue;
      ++counts_[0];
      topology_.betti[0] += pieces_.is_root(v->info());
    }
  }

  Triangulation& t_;
  std::vector<std::uint8_t> in_cell_, in_facet_;  // by the cell's number; a bit for each of its facets
  std::vector<std::uint8_t> in_ball_, covered_;   // whether an edge has it; whether another ball has its centre
  DisjointSets pieces_;
  const Context& context_;
  std::array<std::int64_t, 4> counts_{};  // simplices, by dimension
  Topology topology_;
  Filtered<CompareSize, Exact> compare_size_;
  Filtered<SideOfSmallest, Exact> side_;
  Filtered<ComparePowerAtCentre, ExactRing> at_centre_;
};

}  // namespace

bool meet(const Sphere& a, const Sphere& b) {
  const double distance = squared_norm(a.centre - b.centre), reach = a.radius + b.radius, limit = reach * reach;
  // Either side has gone through at most five roundings of numbers of one sign.
  if (std::abs(distance - limit) > 0x1p-49 * (distance + limit)) return distance < limit;
  using Radii =
      CGAL::Filtered_predicate<CompareReach<ExactRing>, CompareReach<Interval>,
                               CGAL::Cartesian_converter<Plain, ExactRing>, CGAL::Cartesian_converter<Plain, Interval>>;
  return Radii()(weighted(a), weighted(b)) != CGAL::LARGER;
}

Topology union_topology(std::span<const Sphere> balls, const Context& context) {
  if (balls.empty()) return {};
  Triangulation triangulation = triangulated(balls, context);
  return DualComplex(triangulation, balls.size(), context).topology();
}

PowerNeighbours power_neighbours(std::span<const Sphere> balls, const Context& context) {
  PowerNeighbours result{.begin = std::vector<std::size_t>(balls.size() + 1, 0),
                         .balls = {},
                         .hidden = std::vector<std::uint8_t>(balls.size(), 1)};
  if (balls.empty()) return result;
  const Triangulation triangulation = triangulated(balls, context);
  for (const auto v : triangulation.finite_vertex_handles()) {
    if (v->info() != kFar) result.hidden[v->info()] = 0;
  }
  const auto for_each_pair = [&](auto visit) {
    Poll poll(context, kPoll);
    for (const auto& e : triangulation.finite_edges()) {
      poll();
      const std::uint32_t u = e.first->vertex(e.second)->info(), v = e.first->vertex(e.third)->info();
      if (u != kFar && v != kFar) visit(u, v), visit(v, u);
    }
  };
  for_each_pair([&](std::uint32_t u, std::uint32_t) { ++result.begin[u + 1]; });
  std::partial_sum(result.begin.begin(), result.begin.end(), result.begin.begin());
  result.balls.resize(result.begin.back());
  std::vector<std::size_t> next(result.begin.begin(), result.begin.end() - 1);
  for_each_pair([&](std::uint32_t u, std::uint32_t v) { result.balls[next[u]++] = v; });
  Poll poll(context);
  for (std::size_t i = 0; i < balls.size(); ++i) {
    poll(1 + result.of(i).size());
    std::sort(result.balls.begin() + static_cast<std::ptrdiff_t>(result.begin[i]),
              result.balls.begin() + static_cast<std::ptrdiff_t>(result.begin[i + 1]));
  }
  return result;
}

}  // namespace spherule
