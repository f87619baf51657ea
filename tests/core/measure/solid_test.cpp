// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/solid.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <map>
#include <set>
#include <vector>

#include "core/measure/union.h"
#include "core/pipeline.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

using Simplex = std::vector<std::uint32_t>;

// The rank over the field of two elements of a matrix given by the rows that are set in each column: by elimination of
// the largest row.
std::size_t rank(const std::vector<std::set<std::size_t>>& columns) {
  std::map<std::size_t, std::set<std::size_t>> by_largest;
  for (auto column : columns) {
    while (!column.empty() && by_largest.contains(*column.rbegin())) {
      std::set<std::size_t> sum;
      std::ranges::set_symmetric_difference(column, by_largest[*column.rbegin()], std::inserter(sum, sum.end()));
      column = std::move(sum);
    }
    if (!column.empty()) by_largest[*column.rbegin()] = column;
  }
  return by_largest.size();
}

// Betti numbers by simplicial homology: all simplices, boundary matrices, ranks. Solids in space have no torsion, so
// the field does not matter.
Topology homology(const Solid& solid) {
  std::array<std::set<Simplex>, 4> simplices;
  for (std::size_t c = 0; c < solid.inside_count; ++c) {
    Simplex t(solid.cells[c].begin(), solid.cells[c].end());
    std::ranges::sort(t);
    for (unsigned subset = 1; subset < 16; ++subset) {
      Simplex s;
      for (unsigned v = 0; v < 4; ++v) {
        if ((subset >> v) & 1) s.push_back(t[v]);
      }
      simplices[s.size() - 1].insert(s);
    }
  }
  std::array<std::size_t, 5> ranks{};
  for (std::size_t d = 1; d < 4; ++d) {
    std::map<Simplex, std::size_t> row;
    for (const Simplex& s : simplices[d - 1]) row.emplace(s, row.size());
    std::vector<std::set<std::size_t>> columns;
    for (const Simplex& s : simplices[d]) {
      auto& column = columns.emplace_back();
      for (std::size_t i = 0; i < s.size(); ++i) {
        Simplex facet = s;
        facet.erase(facet.begin() + static_cast<std::ptrdiff_t>(i));
        column.insert(row.at(facet));
      }
    }
    ranks[d] = rank(columns);
  }
  Topology topology;
  for (std::size_t d = 0; d < 4; ++d) {
    const auto n = static_cast<std::int64_t>(simplices[d].size());
    topology.euler_characteristic += d % 2 == 0 ? n : -n;
    if (d < 3) topology.betti[d] = n - static_cast<std::int64_t>(ranks[d] + ranks[d + 1]);
  }
  return topology;
}

// Area and volume facet by facet and cell by cell, in double.
std::array<double, 2> area_and_volume(const Solid& solid) {
  const auto corner = [&](std::uint32_t v) { return solid.boundary.lattice.to_patient(solid.boundary.points[v]); };
  std::map<std::set<std::uint32_t>, int> facets;
  double area = 0, volume = 0;
  for (std::size_t c = 0; c < solid.inside_count; ++c) {
    const auto& t = solid.cells[c];
    const Vec3 a = corner(t[0]);
    volume += std::abs(dot(corner(t[1]) - a, cross(corner(t[2]) - a, corner(t[3]) - a))) / 6;
    for (const std::uint32_t v : t) {
      std::set<std::uint32_t> f(t.begin(), t.end());
      f.erase(v);
      ++facets[f];
    }
  }
  for (const auto& [f, count] : facets) {
    if (count == 2) continue;
    auto v = f.begin();
    const Vec3 a = corner(*v++), b = corner(*v++), c = corner(*v);
    area += norm(cross(b - a, c - a)) / 2;
  }
  return {area, volume};
}

// A box of nx × ny × nz inside samples with room around.
SphereModel box_model(std::array<std::int32_t, 3> size, Vec3 spacing) {
  const Grid grid{.dims = {size[0] + 2, size[1] + 2, size[2] + 2}, .spacing = spacing, .origin = {}, .direction = {}};
  const Volume volume = phantoms::sample(
      [&](Vec3 p) {
        return p.x > 0.5 * spacing.x && p.x < (size[0] + 0.5) * spacing.x && p.y > 0.5 * spacing.y &&
                       p.y < (size[1] + 0.5) * spacing.y && p.z > 0.5 * spacing.z && p.z < (size[2] + 0.5) * spacing.z
                   ? 1
                   : 0;
      },
      grid, VoxelType::uint8);
  return build_model(volume, phantoms::labels({1})).model;
}

// Points half a voxel beyond the samples of a box: the hull is the box of the samples (edges a, b, c voxels) plus an
// octahedron of radius 1/2, of which faces, chamfered edges and corners follow.
TEST(Tetrahedra, OfABoxOfVoxelsHaveItsClosedForm) {
  for (const auto& size :
       {std::array{1, 1, 1}, std::array{2, 1, 1}, std::array{2, 3, 4}, std::array{5, 5, 5}, std::array{9, 2, 6}}) {
    const double a = size[0] - 1, b = size[1] - 1, c = size[2] - 1;
    const double h = 0.75;
    const auto model = box_model(size, {h, h, h});
    const auto measures = measure_tetrahedra(*model.solid);
    const double volume = a * b * c + a * b + b * c + c * a + (a + b + c) / 2 + 1.0 / 6;
    const double area = 2 * (a * b + b * c + c * a) + 2 * std::sqrt(2.0) * (a + b + c) + std::sqrt(3.0);
    EXPECT_NEAR(measures.volume_mm3, volume * h * h * h, 1e-12 * volume);
    EXPECT_NEAR(measures.area_mm2, area * h * h, 1e-12 * area);
    EXPECT_EQ(measures.topology.betti, (std::array<std::int64_t, 3>{1, 0, 0}));
    EXPECT_EQ(measures.topology.euler_characteristic, 1);

    // The volume of the stretched box is stretched. Planes are off by half a unit, a voxel has a thousand at least.
    const auto stretched = measure_tetrahedra(*box_model(size, {1, 2, 5}).solid);
    EXPECT_NEAR(stretched.volume_mm3, volume * 10, 1e-3 * volume * 10);
  }
}

TEST(Tetrahedra, AgreeWithSimplicialHomologyOnNoise) {
  std::set<std::array<std::int64_t, 3>> seen;
  std::uint64_t seed = 0;
  for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{1, 2, 5}}) {
    for (const Border border : {Border::closed, Border::open}) {
      for (int n = 0; n < 8; ++n) {
        const Grid grid{.dims = {5, 4, 5}, .spacing = spacing, .origin = {}, .direction = {}};
        const Volume volume = phantoms::noise(grid, 9, ++seed);
        for (const ObjectRule& rule : {phantoms::threshold(2.5, border), phantoms::threshold(6, border),
                                       phantoms::labels({0, 3, 4, 8}, border), phantoms::range(1.5, 4.5, border)}) {
          const auto model = build_model(volume, rule).model;
          const auto measures = measure_tetrahedra(*model.solid);
          const auto expected = homology(*model.solid);
          ASSERT_EQ(measures.topology.betti, expected.betti) << seed;
          ASSERT_EQ(measures.topology.euler_characteristic, expected.euler_characteristic) << seed;
          const auto [area, cells_volume] = area_and_volume(*model.solid);
          ASSERT_NEAR(measures.area_mm2, area, 1e-9 * area);
          ASSERT_NEAR(measures.volume_mm3, cells_volume, 1e-9 * cells_volume);
          seen.insert(expected.betti);
        }
      }
    }
  }
  EXPECT_GT(seen.size(), 20U);
}

TEST(Tetrahedra, AreMeasuredTheSameForEveryThreadCount) {
  const auto model = build_model(phantoms::noise(phantoms::cubic_grid(16, 15), 9, 1), phantoms::threshold(4)).model;
  const auto expected = measure_tetrahedra(*model.solid);
  for (unsigned threads = 2; threads <= 4; ++threads) {
    Context context;
    context.threads = threads;
    const auto measures = measure_tetrahedra(*model.solid, context);
    EXPECT_EQ(measures.area_mm2, expected.area_mm2);
    EXPECT_EQ(measures.volume_mm3, expected.volume_mm3);
    EXPECT_EQ(measures.topology.betti, expected.topology.betti);
  }
}

TEST(Tetrahedra, OfNothingMeasureNothing) {
  const auto measures = measure_tetrahedra(Solid{});
  EXPECT_EQ(measures.volume_mm3, 0);
  EXPECT_EQ(measures.area_mm2, 0);
  EXPECT_EQ(measures.topology.betti, (std::array<std::int64_t, 3>{0, 0, 0}));
}

// Lattice points that make one solid: all cells of their hull are inside.
Solid hull_of(std::vector<LatticePoint> points, const Grid& grid) {
  Solid solid{.boundary = {.lattice = make_lattice(grid), .points = std::move(points)}, .cells = {}, .inside_count = 0};
  solid.cells = tetrahedralize(solid.boundary.points);
  solid.inside_count = solid.cells.size();
  return solid;
}

// A turned and moved grid, far from the frame's origin.
Grid turned_grid() {
  return {.dims = {100, 100, 100},
          .spacing = {0.5, 0.5, 0.5},
          .origin = {200, -300, 400},
          .direction = {{Vec3{0.6, 0, -0.8}, Vec3{0.8, 0, 0.6}, Vec3{0, -1, 0}}}};
}

TEST(Tetrahedra, OfABoxHaveItsMomentsOfInertia) {
  std::vector<LatticePoint> corners;
  const std::int32_t a = 3'000'000, b = 2'000'000, c = 1'000'000, at = 5'000'000;
  for (int i = 0; i < 8; ++i) corners.push_back({at + (i & 1) * a, at + (i >> 1 & 1) * b, at + (i >> 2) * c});
  const Solid solid = hull_of(corners, turned_grid());
  const MassProperties mass = mass_properties(measure_tetrahedra(solid).moments);
  const double u = solid.boundary.lattice.unit_mm, x = a * u, y = b * u, z = c * u, volume = x * y * z;
  EXPECT_NEAR(mass.volume_mm3, volume, 1e-14 * volume);
  const Vec3 middle = solid.boundary.lattice.to_patient(Vec3{at + a / 2.0, at + b / 2.0, at + c / 2.0});
  EXPECT_NEAR(norm(mass.centroid_mm - middle), 0, 1e-11);
  const std::array<double, 3> moments{volume / 12 * (y * y + z * z), volume / 12 * (x * x + z * z),
                                      volume / 12 * (x * x + y * y)};
  for (std::size_t i = 0; i < 3; ++i) {
    EXPECT_NEAR(mass.principal_moments_mm5[i], moments[i], 1e-10 * moments[i]);
    EXPECT_NEAR(std::abs(dot(mass.principal_axes.rows[i], solid.boundary.lattice.grid.direction.column(int(i)))), 1,
                1e-12);
  }
}

TEST(Tetrahedra, OfOneHaveItsMomentsOfInertia) {
  const std::int32_t at = 100'000, a = 4'000'000, b = 3'000'000, c = 5'000'000;
  const Grid grid{.dims = {3, 3, 3}, .spacing = {1, 1, 1}, .origin = {}, .direction = {}};
  const Solid solid = hull_of({{at, at, at}, {at + a, at, at}, {at, at + b, at}, {at, at, at + c}}, grid);
  ASSERT_EQ(solid.inside_count, 1U);
  const Moments own = transformed(
      translated(measure_tetrahedra(solid).moments, -solid.boundary.lattice.to_patient(LatticePoint{at, at, at})),
      Mat3{}, 1 / solid.boundary.lattice.unit_mm);
  // About the corner: the integrals of x^i y^j z^k are a^(i+1) … i! j! k! / (i + j + k + 3)!.
  const double volume = double(a) * b * c / 6;
  EXPECT_NEAR(own.volume, volume, 1e-13 * volume);
  for (const auto& [value, exact] :
       {std::pair{own.first.x, volume * a / 4}, std::pair{own.first.z, volume * c / 4},
        std::pair{own.second.rows[0].x, volume * a * a / 10}, std::pair{own.second.rows[1].y, volume * b * b / 10},
        std::pair{own.second.rows[0].y, volume * a * b / 20}, std::pair{own.second.rows[2].y, volume * c * b / 20}}) {
    EXPECT_NEAR(value, exact, 1e-11 * exact);
  }
}

// The largest sums that the lattice allows.
TEST(Tetrahedra, OfTheWholeLatticeDoNotOverflow) {
  std::vector<LatticePoint> corners;
  constexpr std::int32_t kLast = (1 << 24) - 1;
  for (int i = 0; i < 8; ++i) corners.push_back({(i & 1) * kLast, (i >> 1 & 1) * kLast, (i >> 2) * kLast});
  const Solid solid = hull_of(corners, turned_grid());
  const MassProperties mass = mass_properties(measure_tetrahedra(solid).moments);
  const double edge = kLast * solid.boundary.lattice.unit_mm, moment = std::pow(edge, 5) / 6;
  EXPECT_NEAR(mass.volume_mm3, edge * edge * edge, 1e-14 * edge * edge * edge);
  for (const double m : mass.principal_moments_mm5) EXPECT_NEAR(m, moment, 1e-11 * moment);
}

TEST(Tetrahedra, OfABallHaveItsInertia) {
  const Volume volume = phantoms::sample(phantoms::ball({0.1, -0.2, 0.3}, 2), phantoms::cubic_grid(48, 6));
  const auto model = build_model(volume, phantoms::threshold(0)).model;
  const MassProperties mass = mass_properties(measure_tetrahedra(*model.solid).moments);
  const double moment = 0.4 * mass.volume_mm3 * 4;
  EXPECT_NEAR(norm(mass.centroid_mm - Vec3{0.1, -0.2, 0.3}), 0, 1e-3);
  for (const double m : mass.principal_moments_mm5) EXPECT_NEAR(m, moment, 0.005 * moment);
}

TEST(Observations, HoldAndTheirSlackShrinks) {
  for (const auto& [name, field] : {std::pair{"ball", phantoms::ball({0.02, 0.01, 0}, 1)},
                                    std::pair{"torus", phantoms::torus({0.02, 0.01, 0}, 0.8, 0.3)},
                                    std::pair{"cylinder", phantoms::capped_cylinder({0, 0, 0}, 0.7, 0.9)}}) {
    double slack = 0;
    for (const std::int32_t n : {16, 32, 64}) {
      const BuiltModel built = build_model(phantoms::sample(field, phantoms::cubic_grid(n, 3)), phantoms::threshold(0));
      const double tetrahedra = measure_tetrahedra(*built.model.solid).volume_mm3;
      const Observations o = observations(built.model, built.boundary_point_density_mm, tetrahedra,
                                          measure_union(built.model).moments.volume);
      EXPECT_GT(o.excess_volume_mm3.value, 0) << name << n;
      EXPECT_GT(o.excess_volume_mm3.slack(), 0) << name << n;
      EXPECT_GE(o.density_mm.slack(), 0) << name << n;
      if (n > 16) {
        EXPECT_LT(o.excess_volume_mm3.slack(), 0.75 * slack) << name << n;
      }
      slack = o.excess_volume_mm3.slack();
    }
  }
}

TEST(Voxels, AreCountedAndWeighed) {
  const Volume volume =
      phantoms::noise({.dims = {70, 3, 2}, .spacing = {0.5, 2, 3}, .origin = {}, .direction = {}}, 2, 1);
  const auto samples = classify_samples(volume, phantoms::threshold(1));
  const auto measures = measure_voxels(volume.grid, samples.inside);
  EXPECT_EQ(measures.count, samples.inside.count());
  EXPECT_GT(measures.count, 100U);
  EXPECT_EQ(measures.volume_mm3, 3.0 * static_cast<double>(measures.count));
}

TEST(RadiusHistogram, DividesRatiosEvenlyOnALogarithmicScale) {
  std::vector<Sphere> spheres;
  for (const double r : {0.0, 1.0, 1.9, 2.1, 3.9, 4.1, 8.1, 15.9, 16.0, 0.0}) spheres.push_back({{}, r});
  const auto histogram = radius_histogram(spheres, 4, RadiusScale::logarithmic);
  EXPECT_EQ(histogram.min_mm, 1);
  EXPECT_EQ(histogram.max_mm, 16);
  EXPECT_EQ(histogram.counts, (std::vector<std::uint64_t>{2, 2, 1, 3}));
  EXPECT_EQ(histogram.zero_radius, 2U);
  const auto points = radius_histogram(std::span(spheres).first(1), 2, RadiusScale::logarithmic);
  EXPECT_EQ(points.counts, (std::vector<std::uint64_t>{0, 0}));
  EXPECT_EQ(points.zero_radius, 1U);
  EXPECT_EQ(radius_histogram({}, 2, RadiusScale::logarithmic).zero_radius, 0U);
}

TEST(RadiusHistogram, PutsEveryRadiusInItsBucket) {
  std::vector<Sphere> spheres;
  for (const double r : {1.0, 1.25, 1.5, 1.75, 1.99, 2.0}) spheres.push_back({{}, r});
  const auto histogram = radius_histogram(spheres, 4);
  EXPECT_EQ(histogram.min_mm, 1);
  EXPECT_EQ(histogram.max_mm, 2);
  EXPECT_EQ(histogram.counts, (std::vector<std::uint64_t>{1, 1, 1, 3}));
  EXPECT_EQ(radius_histogram(spheres).counts.size(), 40U);
  EXPECT_EQ(radius_histogram(std::span(spheres).first(1), 3).counts, (std::vector<std::uint64_t>{1, 0, 0}));
  EXPECT_EQ(radius_histogram({}, 2).counts, (std::vector<std::uint64_t>{0, 0}));
  EXPECT_EQ(radius_histogram(spheres, 65536).counts.back(), 1U);
  for (const std::size_t bad : {std::size_t{0}, std::size_t{65537}}) {
    try {
      radius_histogram(spheres, bad);
      FAIL() << bad;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    }
  }
}

}  // namespace
}  // namespace spherule
