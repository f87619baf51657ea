// SPDX-License-Identifier: GPL-3.0-or-later
//
// Triangles in double precision. A ray's side of an edge is computed so that the two triangles at the edge get the
// same number with opposite signs, whatever is rounded: rays do not slip through between them.
//
// Sources: S. Woop, C. Benthin, I. Wald, Watertight Ray/Triangle Intersection (2013); J. Hanika, Hacking the Shadow
// Terminator (2021).
#include <algorithm>
#include <cmath>

#include "core/render/trace.h"

namespace spherule {
namespace {

// In loops over all triangles.
void look_up(std::size_t i, const Context& context) {
  if (i % 65536 == 0) context.throw_if_cancelled();
}

class Facets final : public Tracer, private Primitives {
 public:
  Facets(std::span<const Vec3> vertices, std::span<const Triangle> triangles, bool smooth, const Context& context)
      : vertices_(vertices), triangles_(triangles), smooth_(smooth) {
    for (const Vec3 v : vertices) bounds_.include(v);
    if (!bounds_.empty()) lift_ = 1e-7 * norm(bounds_.max - bounds_.min);
    hierarchy_.emplace(static_cast<const Primitives&>(*this), context);
    set_normals(context);
    set_curvatures(context);
  }

  Box bounds() const override { return bounds_; }
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override { hierarchy_->first_hits(rays, hits); }
  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    hierarchy_->blocked(rays, blocked, alike);
  }

  // The first facet seen from a point turns its back to it just when the point is inside.
  bool inside(Vec3 point) const override {
    // A direction along no axis and no edge of a grid.
    const Ray ray{point, normalised({0.8191, 0.4472, -0.3591})};
    const auto hit = first_hit(ray);
    return hit && dot(flat_normal(hit->primitive), ray.direction) > 0;
  }

  Place place(const Ray& ray, const Hit& hit) const override {
    const Vec3 point = ray.origin + hit.distance * ray.direction;
    Vec3 flat = flat_normal(hit.primitive);
    const double side = dot(flat, ray.direction) > 0 ? -1 : 1;  // seen from within an open surface
    flat = side * flat;
    if (!smooth_) return {point, flat, point + lift_ * flat};
    const Triangle& t = triangles_[hit.primitive];
    const Vec3 part = parts(hit.primitive, point);
    Vec3 normal, start = point;
    for (int i = 0; i < 3; ++i) {
      const Vec3 n = side * normals_[t[static_cast<std::size_t>(i)]];
      normal = normal + part[i] * n;
      // Shadow rays start on the rounded surface that the normals pretend, not below it.
      const double below = std::min(0.0, dot(point - vertices_[t[static_cast<std::size_t>(i)]], n));
      start = start - part[i] * below * n;
    }
    const double length = norm(normal);
    return {point, length > 1e-9 ? 1 / length * normal : flat, start + lift_ * flat};
  }

  Colour colour(Vec3 point, const Hit& hit, std::span<const Colour> table) const override {
    if (!smooth_) return table[hit.primitive];
    const Triangle& t = triangles_[hit.primitive];
    const Vec3 part = parts(hit.primitive, point);
    return part.x * table[t[0]] + part.y * table[t[1]] + part.z * table[t[2]];
  }
  double curvature(Vec3 point, const Hit& hit) const override {
    const Triangle& t = triangles_[hit.primitive];
    return dot(parts(hit.primitive, point), {curvatures_[t[0]], curvatures_[t[1]], curvatures_[t[2]]});
  }
  std::vector<double> typical_curvatures() const override { return curvatures_; }

 private:
  std::size_t size() const override { return triangles_.size(); }
  Box box(std::size_t index) const override {
    Box box;
    for (const std::uint32_t v : triangles_[index]) box.include(vertices_[v]);
    return box;
  }

  std::uint32_t meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin,
                     std::size_t end) const override {
    std::uint32_t met = 0;
    const Triangle& t = triangles_[index];
    for (std::size_t k = begin; k < end; ++k) {
      if (valid[k] == 0) continue;
      const Vec3 origin{lanes.ox[k], lanes.oy[k], lanes.oz[k]}, direction{lanes.dx[k], lanes.dy[k], lanes.dz[k]};
      const Vec3 a = vertices_[t[0]] - origin, b = vertices_[t[1]] - origin, c = vertices_[t[2]] - origin;
      // cross(a, b) and cross(b, a) round alike, so the sign belongs to the edge.
      const double u = dot(direction, cross(b, c)), v = dot(direction, cross(c, a)), w = dot(direction, cross(a, b));
      if (!((u >= 0 && v >= 0 && w >= 0) || (u <= 0 && v <= 0 && w <= 0))) continue;
      const double sum = u + v + w;
      if (sum == 0) continue;  // seen edge on
      const double distance = dot(direction, u / sum * a + v / sum * b + w / sum * c);
      if (!(distance >= 0) || distance > lanes.far[k] || (distance == lanes.far[k] && index >= lanes.primitive[k]))
        continue;
      lanes.far[k] = distance;
      lanes.primitive[k] = index;
      met |= 1U << k;
    }
    return met;
  }

  Vec3 flat_normal(std::uint32_t index) const {
    const Triangle& t = triangles_[index];
    const Vec3 n = cross(vertices_[t[1]] - vertices_[t[0]], vertices_[t[2]] - vertices_[t[0]]);
    const double length = norm(n);
    return length > 0 ? 1 / length * n : Vec3{0, 0, 1};
  }

  // Barycentric coordinates of a point of the triangle.
  Vec3 parts(std::uint32_t index, Vec3 point) const {
    const Triangle& t = triangles_[index];
    const Vec3 a = vertices_[t[0]], b = vertices_[t[1]], c = vertices_[t[2]];
    const Vec3 n = cross(b - a, c - a);
    const double whole = squared_norm(n);
    if (!(whole > 0)) return {1, 0, 0};
    const double v = std::clamp(dot(n, cross(c - a, point - a)) / -whole, 0.0, 1.0);
    const double w = std::clamp(dot(n, cross(b - a, point - a)) / whole, 0.0, 1.0 - v);
    return {1 - v - w, v, w};
  }

  // Of each vertex the mean of its triangles', weighted by area: marching cubes' slivers must not count as much as
  // their neighbours.
  void set_normals(const Context& context) {
    normals_.resize(vertices_.size());
    for (std::size_t i = 0; i < triangles_.size(); ++i) {
      look_up(i, context);
      const Triangle& t = triangles_[i];
      const Vec3 n = cross(vertices_[t[1]] - vertices_[t[0]], vertices_[t[2]] - vertices_[t[0]]);
      for (const std::uint32_t v : t) normals_[v] = normals_[v] + n;
    }
    for (Vec3& n : normals_) {
      const double length = norm(n);
      if (length > 0) n = 1 / length * n;
    }
  }

  // Half the divergence of the normals, which is even within a triangle; of each vertex the mean over its triangles,
  // weighted by area, and once more over its neighbours, since normals of a grid's surface are uneven.
  void set_curvatures(const Context& context) {
    std::vector<double> weights(vertices_.size());
    std::vector<double> of_triangle(triangles_.size());
    for (std::size_t i = 0; i < triangles_.size(); ++i) {
      look_up(i, context);
      const Triangle& t = triangles_[i];
      const Vec3 a = vertices_[t[0]], b = vertices_[t[1]], c = vertices_[t[2]], n = cross(b - a, c - a);
      const double squared = squared_norm(n);
      if (squared > 0)
        of_triangle[i] = 0.5 / squared *
                         (dot(normals_[t[0]], cross(n, c - b)) + dot(normals_[t[1]], cross(n, a - c)) +
                          dot(normals_[t[2]], cross(n, b - a)));
      for (const std::uint32_t v : t) weights[v] += std::sqrt(squared);
    }
    for (int round = 0; round < 2; ++round) {
      curvatures_.assign(vertices_.size(), 0);
      for (std::size_t i = 0; i < triangles_.size(); ++i) {
        look_up(i, context);
        const Triangle& t = triangles_[i];
        const double area = norm(cross(vertices_[t[1]] - vertices_[t[0]], vertices_[t[2]] - vertices_[t[0]]));
        for (const std::uint32_t v : t) curvatures_[v] += area * of_triangle[i];
      }
      for (std::size_t v = 0; v < curvatures_.size(); ++v)
        if (weights[v] > 0) curvatures_[v] /= weights[v];
      for (std::size_t i = 0; i < triangles_.size(); ++i) {
        look_up(i, context);
        const Triangle& t = triangles_[i];
        of_triangle[i] = (curvatures_[t[0]] + curvatures_[t[1]] + curvatures_[t[2]]) / 3;
      }
    }
  }

  std::span<const Vec3> vertices_;
  std::span<const Triangle> triangles_;
  bool smooth_;
  std::vector<Vec3> normals_;       // of the vertices
  std::vector<double> curvatures_;  // of the vertices
  Box bounds_;
  double lift_ = 0;
  std::optional<Hierarchy> hierarchy_;
};

}  // namespace

std::unique_ptr<const Tracer> trace_facets(std::span<const Vec3> vertices, std::span<const Triangle> triangles,
                                           bool smooth, const Context& context) {
  return std::make_unique<const Facets>(vertices, triangles, smooth, context);
}

}  // namespace spherule
