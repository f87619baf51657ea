// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/power.h"

#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Fixed_alpha_shape_3.h>
#include <CGAL/Fixed_alpha_shape_cell_base_3.h>
#include <CGAL/Fixed_alpha_shape_vertex_base_3.h>
#include <CGAL/Regular_triangulation_3.h>
#include <gtest/gtest.h>
#include <gudhi/Alpha_complex_3d.h>
#include <gudhi/Persistent_cohomology.h>
#include <gudhi/Simplex_tree.h>

#include <cmath>
#include <numbers>

#include "core/measure/ball_cell.h"
#include "core/measure/union.h"
#include "tests/core/balls.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;
using Betti = std::array<std::int64_t, 3>;

Betti betti_of(const std::vector<Sphere>& balls) {
  const Topology t = union_topology(balls);
  EXPECT_EQ(t.euler_characteristic, t.betti[0] - t.betti[1] + t.betti[2]);
  return t.betti;
}

TEST(UnionTopology, OfFewBalls) {
  EXPECT_EQ(betti_of({}), (Betti{0, 0, 0}));
  EXPECT_EQ(betti_of({{{1, 2, 3}, 1}}), (Betti{1, 0, 0}));
  EXPECT_EQ(betti_of({{{1, 2, 3}, 0}}), (Betti{1, 0, 0}));
  EXPECT_EQ(betti_of({{{0, 0, 0}, 1}, {{1, 0, 0}, 1}}), (Betti{1, 0, 0}));
  EXPECT_EQ(betti_of({{{0, 0, 0}, 1}, {{2.5, 0, 0}, 1}}), (Betti{2, 0, 0}));
  EXPECT_EQ(betti_of({{{0, 0, 0}, 1}, {{2, 0, 0}, 1}}), (Betti{1, 0, 0})) << "balls that touch are joined";
  EXPECT_EQ(betti_of({{{0, 0, 0}, 2}, {{0, 0, 0}, 2}, {{0.5, 0, 0}, 1}}), (Betti{1, 0, 0})) << "identical and hidden";
}

std::vector<Sphere> ring(int count, double ring_radius, double radius, Vec3 centre = {}) {
  std::vector<Sphere> balls;
  for (int i = 0; i < count; ++i) {
    const double a = 2 * kPi * i / count;
    balls.push_back({centre + Vec3{ring_radius * std::cos(a), ring_radius * std::sin(a), 0}, radius});
  }
  return balls;
}

// Balls that overlap along the lattice's 300 edges only: 300 - 125 + 1 loops.
std::vector<Sphere> cubic_lattice() {
  std::vector<Sphere> balls;
  for (int i = 0; i < 125; ++i) balls.push_back({{double(i % 5), double(i / 5 % 5), double(i / 25)}, 0.6});
  return balls;
}

TEST(UnionTopology, OfKnownSolids) {
  EXPECT_EQ(betti_of(cubic_lattice()), (Betti{1, 176, 0}));
  EXPECT_EQ(betti_of(ring(12, 4, 1.5)), (Betti{1, 1, 0}));
  std::vector<Sphere> two = ring(12, 4, 1.5);
  for (const Sphere& s : ring(12, 4, 1.5, {9, 0, 0})) two.push_back(s);
  EXPECT_EQ(betti_of(two), (Betti{1, 2, 0})) << "genus two";
  std::vector<Sphere> shell;
  for (int i = 0; i < 400; ++i) {  // evenly on a sphere, by the golden angle
    const double z = 1 - (2 * i + 1) / 400.0, a = i * kPi * (3 - std::sqrt(5.0)), r = std::sqrt(1 - z * z);
    shell.push_back({{5 * r * std::cos(a), 5 * r * std::sin(a), 5 * z}, 0.8});
  }
  EXPECT_EQ(betti_of(shell), (Betti{1, 0, 1}));
  shell.push_back({{0, 0, 0}, 1});
  EXPECT_EQ(betti_of(shell), (Betti{2, 0, 1})) << "a ball in the void";
}

// Persistent homology of the weighted alpha filtration up to 0, by Gudhi with exact numbers.
Betti betti_by_gudhi(const std::vector<Sphere>& balls) {
  using Complex = Gudhi::alpha_complex::Alpha_complex_3d<Gudhi::alpha_complex::complexity::EXACT, true>;
  using Tree = Gudhi::Simplex_tree<>;
  std::vector<Complex::Bare_point_3> points;
  std::vector<double> weights;
  for (const Sphere& s : balls) {
    points.emplace_back(s.centre.x, s.centre.y, s.centre.z);
    weights.push_back(s.radius * s.radius);
  }
  Complex complex(points, weights);
  Tree tree;
  complex.create_complex(tree);
  Gudhi::persistent_cohomology::Persistent_cohomology<Tree, Gudhi::persistent_cohomology::Field_Zp> homology(tree,
                                                                                                             true);
  homology.init_coefficients(2);
  homology.compute_persistent_cohomology(-1);
  Betti betti{};
  for (int d = 0; d < 3; ++d) betti[static_cast<std::size_t>(d)] = homology.persistent_betti_number(d, 0, 0);
  return betti;
}

TEST(UnionTopology, AgreesWithGudhi) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    // From dust over a sponge to a solid with voids.
    const double size = 0.35 + 0.05 * static_cast<double>(seed);
    const std::vector<Sphere> balls = random_balls(400, 6, 0.5 * size, size, seed);
    EXPECT_EQ(betti_of(balls), betti_by_gudhi(balls)) << seed;
  }
  // Structured sets, whose centres are co-spherical by the hundred.
  EXPECT_EQ(betti_of(cubic_lattice()), betti_by_gudhi(cubic_lattice()));
  std::vector<Sphere> knot;
  for (int i = 0; i < 90; ++i) {
    const double t = 2 * kPi * i / 90;
    knot.push_back({{std::sin(t) + 2 * std::sin(2 * t), std::cos(t) - 2 * std::cos(2 * t), -std::sin(3 * t)}, 0.3});
  }
  EXPECT_EQ(betti_of(knot), (Betti{1, 1, 0}));
  EXPECT_EQ(betti_of(knot), betti_by_gudhi(knot));
}

// Every pair of balls, one cell after the other: what measure_union does with less work.
struct Slow {
  double volume = 0, area = 0;
  int patch_characteristics = 0, patch_corners = 0;
};
Slow slow_union(const std::vector<Sphere>& balls) {
  Slow sum;
  BallCell cell;
  for (const Sphere& a : balls) {
    cell.reset(a.radius);
    for (const Sphere& b : balls) {
      const Vec3 d = b.centre - a.centre;
      const double distance = norm(d);
      if (&a == &b || distance >= a.radius + b.radius) continue;
      const double offset = (distance * distance + a.radius * a.radius - b.radius * b.radius) / (2 * distance);
      if (!cell.cut((1 / distance) * d, offset)) break;
    }
    const BallPiece piece = cell.measure(a.radius);
    sum.volume += piece.moments.volume;
    sum.area += piece.area;
    sum.patch_characteristics += piece.characteristic;
    sum.patch_corners += piece.corners;
  }
  return sum;
}

// Areas are found by the theorem of Gauss and Bonnet with each patch's Euler characteristic, which must add to the
// surface's own: patches, less the arcs between two of them, plus the corners between three. The surface of a solid
// has twice the solid's, and that CGAL's exact predicates tell.
TEST(Union, PatchesAddToTheEulerCharacteristicOfTheSurface) {
  for (std::uint64_t seed = 1; seed <= 8; ++seed) {
    const double size = 0.4 + 0.06 * static_cast<double>(seed);
    const std::vector<Sphere> balls = random_balls(500, 6, 0.5 * size, size, 100 + seed);
    const Slow slow = slow_union(balls);
    ASSERT_EQ(slow.patch_corners % 6, 0);
    EXPECT_EQ(slow.patch_characteristics - slow.patch_corners / 6, 2 * union_topology(balls).euler_characteristic);
    const UnionMeasures fast = measure_union(std::span(balls));
    EXPECT_NEAR(fast.moments.volume, slow.volume, 1e-12 * slow.volume);
    EXPECT_NEAR(fast.area_mm2, slow.area, 1e-12 * slow.area);
  }
}

// Volume by inclusion and exclusion over the dual complex: the tetrahedra of the complex, and outside them the balls,
// lenses and triangles' common parts by the angles that are left (Edelsbrunner and Fu, 1994), with CGAL's
// triangulation.
namespace inclusion_exclusion {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Vertex = CGAL::Fixed_alpha_shape_vertex_base_3<Kernel, CGAL::Regular_triangulation_vertex_base_3<Kernel>>;
using Cell = CGAL::Fixed_alpha_shape_cell_base_3<Kernel, CGAL::Regular_triangulation_cell_base_3<Kernel>>;
using Triangulation = CGAL::Regular_triangulation_3<Kernel, CGAL::Triangulation_data_structure_3<Vertex, Cell>>;
using Complex = CGAL::Fixed_alpha_shape_3<Triangulation>;

double solid_angle(Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  b = normalised(b - a), c = normalised(c - a), d = normalised(d - a);
  const double turn = std::atan2(std::abs(dot(b, cross(c, d))), 1 + dot(b, c) + dot(c, d) + dot(d, b));
  return 2 * turn / (4 * kPi);
}
double dihedral(Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  const Vec3 e = b - a, m = cross(e, c - a), n = cross(e, d - a);
  return std::atan2(norm(cross(m, n)), dot(m, n)) / (2 * kPi);
}
double ball(const Sphere& s) { return 4 * kPi / 3 * s.radius * s.radius * s.radius; }
double lens(const Sphere& a, const Sphere& b) {
  const double d = norm(b.centre - a.centre), plane = (d * d + a.radius * a.radius - b.radius * b.radius) / (2 * d);
  const auto cap = [](double r, double height) { return kPi * height * height * (3 * r - height) / 3; };
  return cap(a.radius, a.radius - plane) + cap(b.radius, b.radius - (d - plane));
}
double common(const Sphere& a, const Sphere& b, const Sphere& c) {
  // The two points on all three spheres are over the point of equal power in the plane of the centres.
  const Vec3 u = b.centre - a.centre, v = c.centre - a.centre, n = cross(u, v);
  const double pu = (squared_norm(u) + a.radius * a.radius - b.radius * b.radius) / 2,
               pv = (squared_norm(v) + a.radius * a.radius - c.radius * c.radius) / 2;
  const Vec3 foot = (1 / squared_norm(n)) * (pu * cross(v, n) + pv * cross(n, u));
  const double over = std::sqrt(a.radius * a.radius - squared_norm(foot)) / norm(n);
  const Vec3 A = a.centre, B = b.centre, C = c.centre, p = A + foot + over * n;
  return 2 *
         (std::abs(dot(u, cross(v, p - A))) / 6 - solid_angle(A, B, C, p) * ball(a) -
          solid_angle(B, A, C, p) * ball(b) - solid_angle(C, A, B, p) * ball(c) + dihedral(A, B, C, p) * lens(a, b) +
          dihedral(A, C, B, p) * lens(a, c) + dihedral(B, C, A, p) * lens(b, c));
}

double volume(const std::vector<Sphere>& balls) {
  std::vector<Triangulation::Weighted_point> points;
  for (const Sphere& s : balls)
    points.emplace_back(Kernel::Point_3(s.centre.x, s.centre.y, s.centre.z), s.radius * s.radius);
  Triangulation triangulation(points.begin(), points.end());
  Complex complex(triangulation, 0);
  const auto holds = [&](const auto& simplex) { return complex.classify(simplex) != Complex::EXTERIOR; };
  const auto sphere = [](const auto v) {
    const auto& p = v->point();
    return Sphere{{p.x(), p.y(), p.z()}, std::sqrt(p.weight())};
  };
  double sum = 0;
  for (const auto v : complex.finite_vertex_handles())
    if (holds(v)) sum += ball(sphere(v));
  for (const auto& e : complex.finite_edges())
    if (holds(e)) sum -= lens(sphere(e.first->vertex(e.second)), sphere(e.first->vertex(e.third)));
  for (const auto& f : complex.finite_facets()) {
    if (!holds(f)) continue;
    const auto corner = [&](int i) { return sphere(f.first->vertex((f.second + i) % 4)); };
    sum += common(corner(1), corner(2), corner(3));
  }
  // Four balls' common part is what makes the alternating sum over a covered tetrahedron its volume.
  for (const auto c : complex.finite_cell_handles()) {
    if (!holds(c)) continue;
    std::array<Sphere, 4> s;
    std::array<Vec3, 4> x;
    for (int i = 0; i < 4; ++i) {
      s[static_cast<std::size_t>(i)] = sphere(c->vertex(i));
      x[static_cast<std::size_t>(i)] = s[static_cast<std::size_t>(i)].centre;
    }
    double within = std::abs(dot(x[1] - x[0], cross(x[2] - x[0], x[3] - x[0]))) / 6;
    for (std::size_t i = 0; i < 4; ++i) {
      within -= solid_angle(x[i], x[(i + 1) % 4], x[(i + 2) % 4], x[(i + 3) % 4]) * ball(s[i]);
      within -= common(s[(i + 1) % 4], s[(i + 2) % 4], s[(i + 3) % 4]) / 2;
      for (std::size_t j = i + 1; j < 4; ++j) {
        std::array<std::size_t, 2> others{};
        std::size_t n = 0;
        for (std::size_t k = 0; k < 4; ++k)
          if (k != i && k != j) others[n++] = k;
        within += dihedral(x[i], x[j], x[others[0]], x[others[1]]) * lens(s[i], s[j]);
      }
    }
    sum += within;
  }
  return sum;
}

}  // namespace inclusion_exclusion

TEST(Union, AgreesWithInclusionAndExclusionOverTheDualComplex) {
  for (const double size : {0.4, 0.6, 0.9}) {
    const std::vector<Sphere> balls = random_balls(2000, 12, 0.6 * size, size, 11);
    const double expected = inclusion_exclusion::volume(balls);
    EXPECT_NEAR(measure_union(std::span(balls)).moments.volume, expected, 1e-10 * expected) << size;
  }
}

}  // namespace
}  // namespace spherule
