// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/delaunay.h"

#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>
#include <gtest/gtest.h>

#include <algorithm>
#include <map>
#include <set>

#include "core/base/int128.h"
#include "core/predicates.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr std::int32_t kLast = (1 << Lattice::coordinate_bits) - 1;

using Points = std::vector<LatticePoint>;

Points random_points(std::size_t count, std::int32_t extent, std::uint64_t seed, std::int32_t step = 1) {
  phantoms::Random random(seed);
  std::set<LatticePoint> points;
  const auto c = [&] { return step * static_cast<std::int32_t>(random.below(static_cast<std::uint64_t>(extent))); };
  while (points.size() < count) points.insert({c(), c(), c()});
  Points result(points.begin(), points.end());
  random.shuffle(result);
  return result;
}

Points grid_points(std::int32_t n, std::int32_t step) {
  Points points;
  for (std::int32_t z = 0; z < n; ++z) {
    for (std::int32_t y = 0; y < n; ++y) {
      for (std::int32_t x = 0; x < n; ++x) points.push_back({step * x, step * y, step * z});
    }
  }
  return points;
}

// Cells by the sorted coordinates of their corners: comparable between different numberings of the points.
using CellSet = std::set<std::array<LatticePoint, 4>>;
CellSet cell_set(const Points& points, const Tetrahedralization& cells) {
  CellSet result;
  for (const auto& [a, b, c, d] : cells) {
    std::array<LatticePoint, 4> corners{points[a], points[b], points[c], points[d]};
    std::ranges::sort(corners);
    result.insert(corners);
  }
  EXPECT_EQ(result.size(), cells.size());
  return result;
}

// Every four points whose perturbed sphere is empty of all others.
CellSet brute_force(const Points& points) {
  CellSet result;
  const std::size_t n = points.size();
  for (std::size_t a = 0; a < n; ++a) {
    for (std::size_t b = a + 1; b < n; ++b) {
      for (std::size_t c = b + 1; c < n; ++c) {
        for (std::size_t d = c + 1; d < n; ++d) {
          std::array<LatticePoint, 4> t{points[a], points[b], points[c], points[d]};
          const int o = exact::orientation(t[0], t[1], t[2], t[3]);
          if (o == 0) continue;
          if (o < 0) std::swap(t[0], t[1]);
          const bool empty = std::ranges::all_of(points, [&](LatticePoint p) {
            return std::ranges::find(t, p) != t.end() || exact::perturbed_in_sphere(t[0], t[1], t[2], t[3], p) < 0;
          });
          std::ranges::sort(t);
          if (empty) result.insert(t);
        }
      }
    }
  }
  return result;
}

Int128 six_volumes(const Points& points, const Tetrahedralization& cells) {
  Int128 sum = 0;
  for (const auto& [a, b, c, d] : cells) sum += exact::six_volumes(points[a], points[b], points[c], points[d]);
  return sum;
}

// What the header promises about any result.
void expect_well_formed(const Points& points, const Tetrahedralization& cells) {
  EXPECT_TRUE(std::ranges::is_sorted(cells));
  std::vector<bool> used(points.size());
  for (const Tetrahedron& t : cells) {
    ASSERT_EQ(*std::ranges::min_element(t), t[0]);
    ASSERT_GT(exact::orientation(points[t[0]], points[t[1]], points[t[2]], points[t[3]]), 0);
    for (const std::uint32_t v : t) used[v] = true;
  }
  EXPECT_EQ(std::ranges::count(used, cells.empty()), 0);
  const auto adjacent = neighbours(cells, points.size());
  EXPECT_EQ(count_not_delaunay(points, cells, adjacent), 0U);

  std::map<std::set<std::uint32_t>, std::vector<std::uint32_t>> facets;
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    for (std::size_t i = 0; i < 4; ++i) {
      std::set<std::uint32_t> f(cells[c].begin(), cells[c].end());
      f.erase(cells[c][i]);
      facets[f].push_back(c);
    }
  }
  ASSERT_EQ(adjacent.size(), cells.size());
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    for (std::size_t i = 0; i < 4; ++i) {
      std::set<std::uint32_t> f(cells[c].begin(), cells[c].end());
      f.erase(cells[c][i]);
      const auto& shared = facets[f];
      ASSERT_LE(shared.size(), 2U);
      ASSERT_EQ(adjacent[c][i], shared.size() == 1 ? no_cell : shared[0] + shared[1] - c);
    }
  }
}

TEST(Delaunay, TooFewOrFlatPointsHaveNoCells) {
  for (std::size_t n = 0; n < 4; ++n) {
    const Points points{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}};
    EXPECT_TRUE(tetrahedralize(std::span(points).first(n)).empty());
  }
  Points line, skew_line, plane, skew_plane;
  for (std::int32_t i = 0; i < 10; ++i) {
    line.push_back({7, i * i, 7});
    skew_line.push_back({i, 2 * i, 3 * i});
    for (std::int32_t j = 0; j < 10; ++j) {
      plane.push_back({i, j, 5});
      skew_plane.push_back({i, j, i + 2 * j});
    }
  }
  for (const Points& flat : {line, skew_line, plane, skew_plane}) {
    EXPECT_TRUE(tetrahedralize(flat).empty());
    auto solid = flat;
    solid.push_back({1, 0, 1000});
    expect_well_formed(solid, tetrahedralize(solid));
  }
}

TEST(Delaunay, FourPointsAreOneCellWhateverTheirOrder) {
  Points points{{0, 0, 0}, {kLast, 0, 0}, {0, kLast, 0}, {0, 0, kLast}};
  do {
    const auto cells = tetrahedralize(points);
    ASSERT_EQ(cells.size(), 1U);
    expect_well_formed(points, cells);
  } while (std::ranges::next_permutation(points).found);
}

TEST(Delaunay, ACubeIsCutIntoFiveOrSix) {
  for (const std::int32_t edge : {1, 2, 1000, kLast}) {
    const Points points = grid_points(2, edge);
    const auto cells = tetrahedralize(points);
    EXPECT_TRUE(cells.size() == 5 || cells.size() == 6) << cells.size();
    EXPECT_TRUE(six_volumes(points, cells) == Int128{6} * edge * edge * edge);
    expect_well_formed(points, cells);
  }
}

TEST(Delaunay, AFullGridFillsItsBox) {
  for (const std::int32_t step : {1, 4, kLast / 4}) {
    const Points points = grid_points(5, step);
    const auto cells = tetrahedralize(points);
    EXPECT_TRUE(six_volumes(points, cells) == Int128{6} * (4 * step) * (4 * Int128{step}) * (4 * Int128{step}));
    expect_well_formed(points, cells);
  }
}

TEST(Delaunay, IsWhatBruteForceFinds) {
  for (std::uint64_t seed = 0; seed < 60; ++seed) {
    const auto n = 4 + seed % 10;
    for (const auto& [extent, step] :
         {std::pair{3, 1}, std::pair{3, kLast / 2}, std::pair{5, 64}, std::pair{kLast, 1}}) {
      const Points points = random_points(n, extent, seed, step);
      ASSERT_EQ(cell_set(points, tetrahedralize(points)), brute_force(points)) << seed << " extent " << extent;
    }
  }
}

TEST(Delaunay, IsAFunctionOfTheSetOfPoints) {
  for (const auto& [extent, step] : {std::pair{9, 1}, std::pair{12, 64}, std::pair{100'000, 7}}) {
    Points points = random_points(500, extent, 3, step);
    const CellSet expected = cell_set(points, tetrahedralize(points));
    phantoms::Random random(5);
    for (unsigned n = 1; n <= 4; ++n) {
      random.shuffle(points);
      Context context;
      context.threads = n;
      const auto cells = tetrahedralize(points, context);
      EXPECT_EQ(cell_set(points, cells), expected);
      expect_well_formed(points, cells);
    }
  }
}

TEST(Delaunay, IsCgalsOwnTriangulation) {
  using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
  using Vertex = CGAL::Triangulation_vertex_base_with_info_3<std::uint32_t, Kernel>;
  using Reference = CGAL::Delaunay_triangulation_3<
      Kernel, CGAL::Triangulation_data_structure_3<Vertex, CGAL::Delaunay_triangulation_cell_base_3<Kernel>>>;
  const std::map<std::string, Points> sets{{"grid", grid_points(7, 3)},
                                           {"part of a grid", random_points(600, 10, 1, 1024)},
                                           {"jittered", random_points(4000, kLast, 2)},
                                           {"thin", [] {
                                              Points p = random_points(600, 60, 4);
                                              for (auto& q : p) q.z *= kLast / 60;
                                              return p;
                                            }()}};
  for (const auto& [label, points] : sets) {
    std::vector<std::pair<Kernel::Point_3, std::uint32_t>> input;
    for (std::uint32_t i = 0; i < points.size(); ++i)
      input.emplace_back(Kernel::Point_3(points[i].x, points[i].y, points[i].z), i);
    const Reference reference(input.begin(), input.end());
    Tetrahedralization expected;
    for (const auto cell : reference.finite_cell_handles()) {
      expected.push_back(
          {cell->vertex(0)->info(), cell->vertex(1)->info(), cell->vertex(2)->info(), cell->vertex(3)->info()});
    }
    const auto cells = tetrahedralize(points);
    EXPECT_EQ(cell_set(points, cells), cell_set(points, expected)) << label;
    expect_well_formed(points, cells);
  }
}

TEST(Delaunay, CountsABrokenCell) {
  // Two tetrahedra on one facet whose spheres hold each other's apex, and the three of the flip that is right.
  const Points points{{0, 0, 0}, {100, 0, 0}, {0, 100, 0}, {30, 30, 5}, {30, 30, -5}};
  const Tetrahedralization wrong{{0, 1, 2, 3}, {0, 2, 1, 4}};
  ASSERT_GT(exact::orientation(points[0], points[1], points[2], points[3]), 0);
  ASSERT_GT(exact::orientation(points[0], points[2], points[1], points[4]), 0);
  EXPECT_EQ(count_not_delaunay(points, wrong, neighbours(wrong, 5)), 1U);
  EXPECT_EQ(tetrahedralize(points).size(), 3U);
  // A cell that is inside out, and a flat one.
  const Tetrahedralization inverted{{0, 2, 1, 3}};
  EXPECT_EQ(count_not_delaunay(points, inverted, neighbours(inverted, 5)), 1U);
  const Points flat{{0, 0, 0}, {1, 0, 0}, {0, 1, 0}, {1, 1, 0}};
  const Tetrahedralization flat_cell{{0, 1, 2, 3}};
  EXPECT_EQ(count_not_delaunay(flat, flat_cell, neighbours(flat_cell, 4)), 1U);
}

TEST(Delaunay, StopsWhenCancelledAndReportsProgress) {
  const Points points = random_points(10'000, kLast, 6);
  std::stop_source stop;
  Context context;
  context.cancel = stop.get_token();
  double last = 0;
  int calls = 0;
  context.progress = [&](std::string_view stage, double fraction) {
    EXPECT_EQ(stage, "delaunay");
    EXPECT_GE(fraction, last);
    last = fraction;
    if (++calls == 2) stop.request_stop();
  };
  try {
    tetrahedralize(points, context);
    FAIL() << "not cancelled";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::cancelled);
  }
  EXPECT_EQ(calls, 2);
}

}  // namespace
}  // namespace spherule
