// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/slice/plane_delaunay.h"

#include <CGAL/Delaunay_triangulation_2.h>

#include <algorithm>
#include <functional>

#include "core/base/check.h"
#include "core/base/poll.h"
#include "core/predicates.h"
#include "core/spatial_order.h"

namespace spherule {

namespace {

struct IndexedPoint {
  LatticePoint at;
  std::uint32_t index = 0;
};

template <typename T>
CGAL::Comparison_result compared(T a, T b) {
  return a < b ? CGAL::SMALLER : a == b ? CGAL::EQUAL : CGAL::LARGER;
}

// The geometry that CGAL's triangulation asks for, on integers. Types that its unused members name exist but hold
// nothing.
struct PlaneTraits {
  using Point_2 = IndexedPoint;
  struct Segment_2 {};
  struct Triangle_2 {};
  struct Line_2 {};
  struct Ray_2 {};

  struct Construct_point_2 {
    using result_type = const Point_2&;
    const Point_2& operator()(const Point_2& p) const { return p; }
  };
  struct Construct_segment_2 {};
  struct Construct_triangle_2 {};
  struct Construct_circumcenter_2 {};
  struct Construct_bisector_2 {};
  struct Compare_distance_2 {};
  struct Compare_x_2 {
    CGAL::Comparison_result operator()(const Point_2& p, const Point_2& q) const { return compared(p.at.x, q.at.x); }
  };
  struct Compare_y_2 {
    CGAL::Comparison_result operator()(const Point_2& p, const Point_2& q) const { return compared(p.at.y, q.at.y); }
  };
  struct Orientation_2 {
    CGAL::Orientation operator()(const Point_2& p, const Point_2& q, const Point_2& r) const {
      return static_cast<CGAL::Orientation>(exact::sign(exact::two_areas(p.at, q.at, r.at)));
    }
  };
  struct Side_of_oriented_circle_2 {
    CGAL::Oriented_side operator()(const Point_2& p, const Point_2& q, const Point_2& r, const Point_2& t) const {
      return static_cast<CGAL::Oriented_side>(exact::in_circle(p.at, q.at, r.at, t.at));
    }
  };

  Construct_point_2 construct_point_2_object() const { return {}; }
  Compare_x_2 compare_x_2_object() const { return {}; }
  Compare_y_2 compare_y_2_object() const { return {}; }
  Orientation_2 orientation_2_object() const { return {}; }
  Side_of_oriented_circle_2 side_of_oriented_circle_2_object() const { return {}; }
};

using Triangulation = CGAL::Delaunay_triangulation_2<PlaneTraits>;

}  // namespace

std::vector<PlaneTriangle> triangulate(std::span<const LatticePoint> points, const Context& context) {
  std::vector<Vec3> places;
  for (const LatticePoint p : points) places.push_back({double(p.x), double(p.y), 0});
  Poll poll(context, 256);
  Triangulation triangulation;
  Triangulation::Face_handle near;
  for (const std::uint32_t i : insertion_order(places, context)) {
    poll();
    near = triangulation.insert({points[i], i}, near)->face();
  }
  SPHERULE_CHECK(triangulation.number_of_vertices() == points.size());

  std::vector<PlaneTriangle> triangles;
  if (triangulation.dimension() < 2) return triangles;
  triangles.reserve(triangulation.number_of_faces());
  for (auto face = triangulation.finite_faces_begin(); face != triangulation.finite_faces_end(); ++face) {
    poll();
    PlaneTriangle t;
    for (int i = 0; i < 3; ++i) t[static_cast<std::size_t>(i)] = face->vertex(i)->point().index;
    std::ranges::rotate(t, std::ranges::min_element(t));
    triangles.push_back(t);
  }
  std::sort(triangles.begin(), triangles.end(), Polled(poll, std::less<>()));
  return triangles;
}

}  // namespace spherule
