// SPDX-License-Identifier: GPL-3.0-or-later
//
// Analytic bodies, refined: volume of the tetrahedra against the formula, the order of convergence, and Betti numbers;
// volume and area of the union of their spheres, and how far the paper's observation 3 is from its bound; then the ball
// and the cylinder of the paper beside its published counts.
#include <cmath>
#include <cstdio>
#include <numbers>

#include "core/measure/solid.h"
#include "core/measure/union.h"
#include "core/pipeline.h"
#include "tests/bench/scans.h"
#include "tests/phantoms.h"

using namespace spherule;
namespace ph = spherule::phantoms;

namespace {

struct Body {
  const char* name;
  ph::Field field;
  double edge;    // of the sampled cube, mm
  double volume;  // mm3, analytic
  double area;    // mm2, analytic; 0 where the table of unions leaves the body out
  std::array<std::int64_t, 3> betti;
};

std::vector<Body> bodies() {
  constexpr double pi = std::numbers::pi;
  // Irrational centres keep the bodies off the grid's symmetries.
  const Vec3 c{0.1 * std::numbers::sqrt2, 0.1 * std::numbers::e, 0.1 / pi};
  return {
      {"ball R 10", ph::ball(c, 10), 26, 4.0 / 3 * pi * 1000, 4 * pi * 100, {1, 0, 0}},
      {"torus 8, 3", ph::torus(c, 8, 3), 26, 2 * pi * pi * 8 * 9, 4 * pi * pi * 8 * 3, {1, 1, 0}},
      {"cylinder R 6, h 16", ph::capped_cylinder(c, 6, 8), 26, pi * 36 * 16, 2 * pi * 6 * (16 + 6), {1, 0, 0}},
      {"cube 14", ph::cube(c, 7), 26, 14.0 * 14 * 14, 6 * 14.0 * 14, {1, 0, 0}},
      {"slab 9 (in a cube of 26)", ph::slab(c.z, 4.5), 26, 0, 0, {1, 0, 0}},
      {"two balls R 5",
       ph::either(ph::ball(c - Vec3{6, 0, 0}, 5), ph::ball(c + Vec3{6, 0, 0}, 5)),
       26,
       2 * 4.0 / 3 * pi * 125,
       2 * 4 * pi * 25,
       {2, 0, 0}},
      {"shell 10, 6", ph::shell(c, 10, 6), 26, 4.0 / 3 * pi * (1000 - 216), 4 * pi * (100 + 36), {1, 0, 1}},
  };
}

}  // namespace

int main() {
  std::printf(
      "| body | samples | points | spheres | V_T mm3 | error | order | betti "
      "|\n|---|---:|---:|---:|---:|---:|---:|---|\n");
  for (const Body& body : bodies()) {
    double previous = 0;
    for (const std::int32_t n : {16, 32, 64, 128}) {
      const Grid grid = ph::cubic_grid(n, body.edge);
      const BuiltModel built = build_model(ph::sample(body.field, grid), ph::threshold(0));
      const TetrahedraMeasures measures = measure_tetrahedra(*built.model.solid);
      // A slab fills the padded grid sideways: half a voxel beyond the samples.
      const double side = (n - 1) * grid.spacing.x + grid.spacing.x;
      const double truth = body.volume > 0 ? body.volume : side * side * 9;
      const double error = measures.volume_mm3 / truth - 1;
      const double order = previous != 0 ? std::log2(std::abs(previous / error)) : 0;
      const auto& b = measures.topology.betti;
      std::printf("| %s | %d³ | %zu | %zu | %.6g | %+.3e | %s | %lld %lld %lld%s |\n", body.name, n,
                  built.model.solid->boundary.points.size(), built.model.spheres.size(), measures.volume_mm3, error,
                  previous != 0 ? std::to_string(order).substr(0, 5).c_str() : "", static_cast<long long>(b[0]),
                  static_cast<long long>(b[1]), static_cast<long long>(b[2]), b == body.betti ? "" : " WRONG");
      previous = error;
    }
  }
  std::printf(
      "\n| union of the spheres of | samples | V_S error | order | A_S error | V_S - V_T mm3 | its bound | value / "
      "bound "
      "|\n|---|---:|---:|---:|---:|---:|---:|---:|\n");
  for (const Body& body : bodies()) {
    if (body.area == 0) continue;
    double previous = 0;
    for (const std::int32_t n : {16, 32, 64, 128}) {
      const BuiltModel built = build_model(ph::sample(body.field, ph::cubic_grid(n, body.edge)), ph::threshold(0));
      const UnionMeasures measures = measure_raw_union(built.model);
      const double solid = tetrahedra_moments(*built.model.solid).volume;
      const Observation excess =
          observations(built.model, built.boundary_point_density_mm, solid, measures.moments.volume).excess_volume_mm3;
      const double error = measures.moments.volume / body.volume - 1;
      const double order = previous != 0 ? std::log2(std::abs(previous / error)) : 0;
      std::printf("| %s | %d³ | %+.3e | %s | %+.3e | %.4g | %.4g | %.4f |\n", body.name, n, error,
                  previous != 0 ? std::to_string(order).substr(0, 5).c_str() : "", measures.area_mm2 / body.area - 1,
                  excess.value, excess.bound, excess.value / excess.bound);
      previous = error;
    }
  }
  std::printf(
      "\n| the paper's volume | threshold | published points | published spheres | points | spheres "
      "|\n|---|---:|---:|---:|---:|---:|\n");
  for (const std::int32_t n : {24, 32}) {
    const Grid grid = ph::cubic_grid(n, n);
    for (const bool ball : {true, false}) {
      const BuiltModel built =
          build_model(ph::sample(ball ? ph::paper_ball({}) : ph::paper_cylinder({}), grid, VoxelType::uint8),
                      ph::threshold(ball ? 30.5 : 100.5));
      std::printf("| %s in %d³ | %.1f | %d | %d | %zu | %zu |\n", ball ? "ball" : "cylinder", n, ball ? 30.5 : 100.5,
                  ball ? 1704 : 736, ball ? 5120 : 2381, built.model.solid->boundary.points.size(),
                  built.model.spheres.size());
    }
  }
}
