// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/delaunay.h"

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Delaunay_triangulation_cell_base_3.h>
#include <CGAL/Triangulation_data_structure_3.h>
#include <CGAL/Triangulation_vertex_base_3.h>

#include <algorithm>
#include <bit>
#include <numeric>
#include <string>
#include <utility>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/most_cells.h"
#include "core/predicates.h"
#include "core/spatial_order.h"

namespace spherule {

namespace {

// A lattice point that remembers its index; 16 bytes, so that a CGAL vertex has 24.
struct IndexedPoint {
  LatticePoint at;
  std::uint32_t index = 0;

  // For CGAL's approximate walk, whose result is then made exact.
  double x() const { return at.x; }
  double y() const { return at.y; }
  double z() const { return at.z; }
};

// Twice the signed area of three points, projected along the axis other than u and v.
std::int64_t area(LatticePoint p, LatticePoint q, LatticePoint r, int u, int v) {
  return (std::int64_t{q[u]} - p[u]) * (std::int64_t{r[v]} - p[v]) -
         (std::int64_t{q[v]} - p[v]) * (std::int64_t{r[u]} - p[u]);
}
// The first projection in which three points are not collinear, and their area there; 0 if they are collinear in space.
struct Projection {
  int u, v;
  std::int64_t area;
};
Projection projection(LatticePoint p, LatticePoint q, LatticePoint r) {
  for (const auto [u, v] : {std::array{0, 1}, std::array{1, 2}, std::array{0, 2}}) {
    if (const auto a = area(p, q, r, u, v); a != 0) return {u, v, a};
  }
  return {0, 1, 0};
}

// Of four coplanar points, whether t is within the circle through p, q, r (1 inside, 0 on it, -1 outside). The
// in-circle determinant of a plane changes only by a factor under the projection to two coordinates if the lifts stay
// those of space.
int in_coplanar_circle(LatticePoint p, LatticePoint q, LatticePoint r, LatticePoint t) {
  using exact::operator-;
  const auto [u, v, pqr] = projection(p, q, r);
  const exact::Wide lifted = exact::Wide{exact::squared_length(p - t)} * area(t, q, r, u, v) +
                             exact::Wide{exact::squared_length(q - t)} * area(t, r, p, u, v) +
                             exact::Wide{exact::squared_length(r - t)} * area(t, p, q, u, v);
  return pqr > 0 ? exact::sign(lifted) : -exact::sign(lifted);
}

// The geometry that CGAL's triangulation asks for, on integers. Types that its unused members name exist but hold
// nothing.
struct LatticeTraits {
  using Point_3 = IndexedPoint;
  struct Segment_3 {};
  struct Triangle_3 {};
  struct Tetrahedron_3 {};
  struct Line_3 {};
  struct Ray_3 {};
  struct Object_3 {};

  struct Construct_point_3 {
    using result_type = const Point_3&;
    const Point_3& operator()(const Point_3& p) const { return p; }
  };
  struct Construct_segment_3 {};
  struct Construct_triangle_3 {};
  struct Construct_tetrahedron_3 {};
  struct Compare_xyz_3 {
    CGAL::Comparison_result operator()(const Point_3& p, const Point_3& q) const {
      return p.at < q.at ? CGAL::SMALLER : p.at == q.at ? CGAL::EQUAL : CGAL::LARGER;
    }
  };
  struct Coplanar_orientation_3 {
    CGAL::Orientation operator()(const Point_3& p, const Point_3& q, const Point_3& r) const {
      return CGAL::sign(projection(p.at, q.at, r.at).area);
    }
  };
  struct Orientation_3 {
    CGAL::Orientation operator()(const Point_3& p, const Point_3& q, const Point_3& r, const Point_3& s) const {
      return static_cast<CGAL::Orientation>(exact::orientation(p.at, q.at, r.at, s.at));
    }
  };
  struct Coplanar_side_of_bounded_circle_3 {
    CGAL::Bounded_side operator()(const Point_3& p, const Point_3& q, const Point_3& r, const Point_3& t) const {
      return static_cast<CGAL::Bounded_side>(in_coplanar_circle(p.at, q.at, r.at, t.at));
    }
  };
  // Breaks ties itself, by CGAL's own rule, because the cofactors that decide are at hand.
  struct Side_of_oriented_sphere_3 {
    CGAL::Oriented_side operator()(const Point_3& p, const Point_3& q, const Point_3& r, const Point_3& s,
                                   const Point_3& t) const {
      return static_cast<CGAL::Oriented_side>(exact::perturbed_in_sphere(p.at, q.at, r.at, s.at, t.at));
    }
  };

  Construct_point_3 construct_point_3_object() const { return {}; }
  Construct_segment_3 construct_segment_3_object() const { return {}; }
  Construct_triangle_3 construct_triangle_3_object() const { return {}; }
  Construct_tetrahedron_3 construct_tetrahedron_3_object() const { return {}; }
  Compare_xyz_3 compare_xyz_3_object() const { return {}; }
  Coplanar_orientation_3 coplanar_orientation_3_object() const { return {}; }
  Orientation_3 orientation_3_object() const { return {}; }
  Coplanar_side_of_bounded_circle_3 coplanar_side_of_bounded_circle_3_object() const { return {}; }
  Side_of_oriented_sphere_3 side_of_oriented_sphere_3_object() const { return {}; }
};

using Triangulation = CGAL::Delaunay_triangulation_3<
    LatticeTraits, CGAL::Triangulation_data_structure_3<CGAL::Triangulation_vertex_base_3<LatticeTraits>,
                                                        CGAL::Delaunay_triangulation_cell_base_3<LatticeTraits>>>;

// Bowyer and Watson's insertion on CGAL's data structure, for triangulations that already span space. CGAL's own
// insertion does the same; this one links the new cells by hashing their rim edges instead of turning around each, and
// walks and tests without generic detours.
class Insertion {
 public:
  Insertion(Triangulation& triangulation, Poll& poll)
      : triangulation_(triangulation), tds_(triangulation.tds()), poll_(poll), edges_(256) {}

  // Adds a point that is not yet in the triangulation. The walk starts near the point added before.
  void insert(const IndexedPoint& p) {
    find_conflicts(p, walk(p));
    const auto v = tds_.create_vertex();
    v->set_point(p);
    if (edges_.size() < 4 * rim_.size()) edges_.assign(std::bit_ceil(8 * rim_.size()), Edge{});
    ++generation_;
    poll_(rim_.size());
    for (const auto& [inner, i] : rim_) {
      const Cell outer = inner->neighbor(i);
      const Cell cell = tds_.create_cell(inner->vertex(0), inner->vertex(1), inner->vertex(2), inner->vertex(3));
      cell->set_vertex(i, v);
      tds_.set_adjacency(cell, i, outer, outer->index(inner));
      for (int k = 0; k < 4; ++k) {
        if (k == i) continue;
        cell->vertex(k)->set_cell(cell);
        link(cell, k, i);
      }
      last_ = cell;
    }
    v->set_cell(last_);
    for (const Cell c : tested_) c->tds_data().clear();
    tds_.delete_cells(conflicts_.begin(), conflicts_.end());
  }

 private:
  using Cell = Triangulation::Cell_handle;
  using Vertex = Triangulation::Vertex_handle;

  // The facet between a new cell and the one that shares this edge of the rim.
  struct Edge {
    const void *a = nullptr, *b = nullptr;
    Cell cell;
    int opposite = 0;
    std::uint64_t generation = 0;
  };

  // A cell in conflict with p: the finite cell that holds it, or the infinite one behind the hull facet that p is
  // beyond. A visibility walk; in a Delaunay triangulation it cannot turn in circles.
  Cell walk(const IndexedPoint& p) const {
    Cell cell = last_ == Cell() ? triangulation_.infinite_vertex()->cell() : last_;
    int infinite;
    if (cell->has_vertex(triangulation_.infinite_vertex(), infinite)) cell = cell->neighbor(infinite);
    for (Cell from = cell;;) {
      std::array<LatticePoint, 4> corner;
      for (int i = 0; i < 4; ++i) corner[static_cast<std::size_t>(i)] = cell->vertex(i)->point().at;
      int exit = -1;
      for (int i = 0; i < 4 && exit < 0; ++i) {
        if (cell->neighbor(i) == from) continue;
        auto seen = corner;
        seen[static_cast<std::size_t>(i)] = p.at;
        if (exact::orientation(seen[0], seen[1], seen[2], seen[3]) < 0) exit = i;
      }
      if (exit < 0) return cell;
      from = cell;
      cell = cell->neighbor(exit);
      if (cell->has_vertex(triangulation_.infinite_vertex())) return cell;
    }
  }

  bool in_conflict(Cell cell, const IndexedPoint& p) const {
    if (cell->has_vertex(triangulation_.infinite_vertex()))
      return triangulation_.side_of_sphere(cell, p, true) == CGAL::ON_BOUNDED_SIDE;
    return exact::perturbed_in_sphere(cell->vertex(0)->point().at, cell->vertex(1)->point().at,
                                      cell->vertex(2)->point().at, cell->vertex(3)->point().at, p.at) > 0;
  }

  // Fills conflicts_ with the cells whose sphere holds p, and rim_ with the facets (cell in conflict, index) around
  // them.
  void find_conflicts(const IndexedPoint& p, Cell first) {
    conflicts_.assign(1, first);
    tested_.clear();
    rim_.clear();
    first->tds_data().mark_in_conflict();
    for (std::size_t n = 0; n < conflicts_.size(); ++n) {
      const Cell cell = conflicts_[n];
      for (int i = 0; i < 4; ++i) {
        const Cell next = cell->neighbor(i);
        if (next->tds_data().is_in_conflict()) continue;
        if (next->tds_data().is_clear()) {
          if (in_conflict(next, p)) {
            next->tds_data().mark_in_conflict();
            conflicts_.push_back(next);
            continue;
          }
          next->tds_data().mark_on_boundary();
          tested_.push_back(next);
        }
        rim_.emplace_back(cell, i);
      }
    }
  }

  // Joins the facet opposite vertex k of a new cell (whose new vertex is i) with the other new cell at the same rim
  // edge, if that exists already, else leaves word for it.
  void link(Cell cell, int k, int i) {
    const int u = CGAL::Triangulation_utils_3::next_around_edge(k, i), w = 6 - i - k - u;
    const void* a = &*cell->vertex(u);
    const void* b = &*cell->vertex(w);
    if (b < a) std::swap(a, b);
    const auto hash = (reinterpret_cast<std::uintptr_t>(a) * 0x9E3779B97F4A7C15ULL) ^
                      (reinterpret_cast<std::uintptr_t>(b) * 0xC2B2AE3D27D4EB4FULL);
    for (std::size_t at = hash >> 20;; ++at) {
      Edge& edge = edges_[at & (edges_.size() - 1)];
      if (edge.generation != generation_) {
        edge = {a, b, cell, k, generation_};
        return;
      }
      if (edge.a == a && edge.b == b) {
        tds_.set_adjacency(cell, k, edge.cell, edge.opposite);
        return;
      }
    }
  }

  Triangulation& triangulation_;
  Triangulation::Triangulation_data_structure& tds_;
  Poll& poll_;
  Cell last_;
  std::vector<Cell> conflicts_, tested_;
  std::vector<std::pair<Cell, int>> rim_;
  std::vector<Edge> edges_;  // open addressing; entries of earlier generations are free; a power of two
  std::uint64_t generation_ = 0;
};

// The same oriented tetrahedron, smallest index first, then the smallest of the rest.
Tetrahedron canonical(Tetrahedron t) {
  const auto least = std::ranges::min_element(t) - t.begin();
  // Swapping two pairs keeps the orientation.
  if (least == 1) t = {t[1], t[0], t[3], t[2]};
  if (least == 2) t = {t[2], t[3], t[0], t[1]};
  if (least == 3) t = {t[3], t[2], t[1], t[0]};
  std::rotate(t.begin() + 1, std::min_element(t.begin() + 1, t.end()), t.end());
  return t;
}

// Ascending order by counting on the first index; the few cells that share it are sorted directly.
Tetrahedralization sorted(const Tetrahedralization& cells, std::size_t point_count, const Context& context) {
  Poll poll(context);
  std::vector<std::size_t> start(point_count + 1, 0);
  for (const Tetrahedron& t : cells) poll(), ++start[t[0] + 1];
  std::partial_sum(start.begin(), start.end(), start.begin());
  Tetrahedralization result(cells.size());
  auto next = start;
  for (const Tetrahedron& t : cells) poll(4), result[next[t[0]]++] = t;
  parallel_for(context, {}, point_count, 1 << 14, [&](std::size_t begin, std::size_t end) {
    for (std::size_t v = begin; v < end; ++v) {
      std::sort(result.begin() + static_cast<std::ptrdiff_t>(start[v]),
                result.begin() + static_cast<std::ptrdiff_t>(start[v + 1]));
    }
  });
  return result;
}

Tetrahedralization finite_cells(std::span<const LatticePoint> points, const Context& context) {
  std::vector<std::uint32_t> order;
  {
    std::vector<Vec3> places;
    places.reserve(points.size());
    for (const LatticePoint p : points) places.push_back({double(p.x), double(p.y), double(p.z)});
    order = insertion_order(places, context);
  }

  constexpr std::size_t kReportEvery = 4096;
  const std::size_t most = most_cells(points.size());
  Triangulation triangulation;
  Poll poll(context, 1 << 12);  // cells made, at up to a microsecond each
  Insertion insertion(triangulation, poll);
  for (std::size_t i = 0; i < order.size(); ++i) {
    poll();
    if (i % kReportEvery == 0) {
      context.report("delaunay", 0.95 * static_cast<double>(i) / static_cast<double>(order.size()));
    }
    if (triangulation.number_of_cells() > most) {
      throw Error(ErrorCode::too_large,
                  "The object's boundary points lie near few curves that face each other, so that they would have more "
                  "than " +
                      std::to_string(most) + " tetrahedra; choose another threshold or a coarser volume.");
    }
    const IndexedPoint point{points[order[i]], order[i]};
    if (triangulation.dimension() < 3) {
      triangulation.insert(point);
    } else {
      insertion.insert(point);
    }
  }
  SPHERULE_CHECK(triangulation.number_of_vertices() == points.size());

  Tetrahedralization cells;
  if (triangulation.dimension() < 3) return cells;
  cells.reserve(triangulation.number_of_finite_cells());
  Poll listing(context);
  for (auto cell = triangulation.finite_cells_begin(); cell != triangulation.finite_cells_end(); ++cell) {
    listing(8);
    Tetrahedron t;
    for (int i = 0; i < 4; ++i) t[static_cast<std::size_t>(i)] = cell->vertex(i)->point().index;
    cells.push_back(canonical(t));
  }
  return cells;
}

// Numbers of cells, filed under one of their corners.
class Filed {
 public:
  Filed() = default;
  template <typename Corner>
  Filed(std::span<const Tetrahedron> cells, std::size_t point_count, Corner&& corner, const Context& context)
      : start_(point_count + 1, 0), cells_(cells.size()) {
    Poll poll(context);
    for (const Tetrahedron& t : cells) poll(), ++start_[corner(t)];
    std::partial_sum(start_.begin(), start_.end(), start_.begin());
    // Each file is filled from its end, which leaves its start.
    for (auto c = static_cast<std::uint32_t>(cells.size()); c-- > 0;) {
      poll(4);
      cells_[--start_[corner(cells[c])]] = c;
    }
  }
  std::span<const std::uint32_t> operator[](std::size_t point) const {
    return std::span(cells_).subspan(start_[point], start_[point + 1] - start_[point]);
  }

 private:
  std::vector<std::uint32_t> start_, cells_;
};

struct Facet {
  std::uint64_t others;  // its corners but the smallest
  std::uint32_t cell;
  std::uint32_t opposite;
};

// Beyond this many points an audit would dominate the tests of debug builds.
[[maybe_unused]] constexpr std::size_t kLargestAudit = 20'000;

[[maybe_unused]] bool is_delaunay(std::span<const LatticePoint> points, std::span<const Tetrahedron> cells) {
  return count_not_delaunay(points, cells, neighbours(cells, points.size())) == 0;
}

}  // namespace

Tetrahedralization tetrahedralize(std::span<const LatticePoint> points, const Context& context) {
  SPHERULE_CHECK(points.size() < no_cell);
  context.report("delaunay", 0);
  // The triangulation is freed before its cells are sorted: the peak is the triangulation plus one list of cells.
  const Tetrahedralization cells = finite_cells(points, context);
  Tetrahedralization result = sorted(cells, points.size(), context);
  context.report("delaunay", 1);
  SPHERULE_AUDIT(points.size() > kLargestAudit || is_delaunay(points, result));
  return result;
}

std::vector<std::array<std::uint32_t, 4>> neighbours(std::span<const Tetrahedron> cells, std::size_t point_count,
                                                     const Context& context) {
  // Three facets of a cell have its smallest corner, and the smallest of the fourth is the cell's second.
  Filed by_first, by_second;
  parallel_for(context, {}, 2, 1, [&](std::size_t task, std::size_t) {
    if (task == 0) {
      by_first = Filed(
          cells, point_count, [](const Tetrahedron& t) { return t[0]; }, context);
    } else {
      const auto second = [](const Tetrahedron& t) { return std::min({t[1], t[2], t[3]}); };
      by_second = Filed(cells, point_count, second, context);
    }
  });
  std::vector<std::array<std::uint32_t, 4>> result(cells.size(), {no_cell, no_cell, no_cell, no_cell});
  parallel_for(context, {}, point_count, 1 << 12, [&](std::size_t begin, std::size_t end) {
    std::vector<Facet> facets;  // with one smallest corner
    for (std::size_t v = begin; v < end; ++v) {
      facets.clear();
      const auto add = [&](std::uint32_t cell, unsigned opposite, std::uint32_t a, std::uint32_t b) {
        facets.push_back({std::uint64_t{std::min(a, b)} << 32 | std::max(a, b), cell, opposite});
      };
      for (const std::uint32_t c : by_first[v]) {
        const Tetrahedron& t = cells[c];
        add(c, 1, t[2], t[3]);
        add(c, 2, t[3], t[1]);
        add(c, 3, t[1], t[2]);
      }
      for (const std::uint32_t c : by_second[v]) {
        const auto& [_, i, j, k] = cells[c];
        add(c, 0, i == v ? j : i, k == v ? j : k);
      }
      std::ranges::sort(facets, {}, &Facet::others);
      for (std::size_t f = 1; f < facets.size(); ++f) {
        const Facet &p = facets[f - 1], &q = facets[f];
        if (p.others != q.others) continue;
        result[p.cell][p.opposite] = q.cell;
        result[q.cell][q.opposite] = p.cell;
      }
    }
  });
  return result;
}

std::size_t count_not_delaunay(std::span<const LatticePoint> points, std::span<const Tetrahedron> cells,
                               std::span<const std::array<std::uint32_t, 4>> neighbours, const Context& context) {
  SPHERULE_CHECK(cells.size() == neighbours.size());
  constexpr std::size_t kGrain = 1 << 16;
  std::vector<std::size_t> violations((cells.size() + kGrain - 1) / kGrain, 0);
  parallel_for(context, "empty spheres", cells.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      const auto& [a, b, d, e] = cells[c];
      if (exact::orientation(points[a], points[b], points[d], points[e]) <= 0) {
        ++violations[begin / kGrain];
        continue;
      }
      for (const std::uint32_t other : neighbours[c]) {
        if (other == no_cell || other < c) continue;
        const auto apex = std::ranges::find_if(
            cells[other], [&](std::uint32_t v) { return std::ranges::find(cells[c], v) == cells[c].end(); });
        SPHERULE_CHECK(apex != cells[other].end());
        violations[begin / kGrain] += exact::in_sphere(points[a], points[b], points[d], points[e], points[*apex]) > 0;
      }
    }
  });
  return std::accumulate(violations.begin(), violations.end(), std::size_t{0});
}

}  // namespace spherule
