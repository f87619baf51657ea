// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/compare/marching_cubes.h"

#include <gtest/gtest.h>

#include <algorithm>
#include <cmath>
#include <filesystem>
#include <map>
#include <numbers>
#include <numeric>
#include <vector>

#include "core/measure/solid.h"
#include "core/read/read.h"
#include "tests/phantoms.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;

struct Drawn {
  BoundaryPoints boundary;
  Mesh mesh;
  MarchingCubesMeasures measures;
};

Drawn draw(const Volume& volume, const ObjectRule& rule, const Context& context = {}) {
  const InsideSamples samples = classify_samples(volume, rule);
  Drawn drawn{.boundary = extract_boundary(volume, rule, samples), .mesh = {}, .measures = {}};
  drawn.mesh = marching_cubes(volume, rule, samples, drawn.boundary, context);
  drawn.measures = measure_marching_cubes(volume, rule, samples, drawn.boundary, context);
  return drawn;
}

double volume_of(const Mesh& mesh) {
  double six = 0;
  for (const auto& [a, b, c] : mesh.triangles) six += dot(mesh.vertices[a], cross(mesh.vertices[b], mesh.vertices[c]));
  return six / 6;
}
double area_of(const Mesh& mesh) {
  double two = 0;
  for (const auto& [a, b, c] : mesh.triangles) {
    two += norm(cross(mesh.vertices[b] - mesh.vertices[a], mesh.vertices[c] - mesh.vertices[a]));
  }
  return two / 2;
}

// Directed edges that are not met by as many in the opposite direction.
std::vector<std::array<std::uint32_t, 2>> torn_edges(const Mesh& mesh) {
  std::map<std::array<std::uint32_t, 2>, int> count;
  for (const auto& t : mesh.triangles) {
    for (std::size_t m = 0; m < 3; ++m) {
      const std::uint32_t a = t[m], b = t[(m + 1) % 3];
      count[{std::min(a, b), std::max(a, b)}] += a < b ? 1 : -1;
    }
  }
  std::vector<std::array<std::uint32_t, 2>> torn;
  for (const auto& [edge, n] : count) {
    if (n != 0) torn.push_back(edge);
  }
  return torn;
}

// The solid's Euler characteristic from its parts in cells, faces, edges and samples: in a closed cell they are balls,
// one for each set of inside corners that edges and joined faces connect.
std::int64_t euler_by_cells(const Volume& volume, const ObjectRule& rule) {
  const SampleBits inside = classify_samples(volume, rule).inside;
  const auto n = volume.grid.dims;
  const auto in = [&](std::array<int, 3> s) { return inside.test_or_outside(s[0], s[1], s[2]); };
  // The bilinear interpolation of an ambiguous face at its saddle.
  const auto joined = [&](const std::array<std::array<int, 3>, 4>& f) {
    if (rule.kind == ObjectRule::Kind::labels) return true;
    std::array<double, 4> v;
    for (std::size_t m = 0; m < 4; ++m) v[m] = value_at(volume, f[m][0], f[m][1], f[m][2]);
    const double saddle = (v[0] * v[2] - v[1] * v[3]) / (v[0] + v[2] - v[1] - v[3]);
    return rule.side == Side::above ? saddle >= rule.lo : saddle < rule.lo;
  };
  std::int64_t euler = 0;
  for (int k = -1; k < n[2]; ++k) {
    for (int j = -1; j < n[1]; ++j) {
      for (int i = -1; i < n[0]; ++i) {
        for (unsigned axes = 0; axes < 8; ++axes) {
          // The closed cell spanned by these axes from sample (i, j, k).
          std::vector<std::array<int, 3>> corners;
          for (unsigned c = 0; c < 8; ++c) {
            if ((c & ~axes) == 0) corners.push_back({i + int(c & 1), j + int(c >> 1 & 1), k + int(c >> 2)});
          }
          std::vector<std::size_t> part(corners.size());
          std::iota(part.begin(), part.end(), std::size_t{0});
          const auto unite = [&](std::size_t a, std::size_t b) {
            const std::size_t from = part[a], to = part[b];
            std::ranges::replace(part, from, to);
          };
          const auto differ = [&](std::size_t a, std::size_t b) {
            return std::abs(corners[a][0] - corners[b][0]) + std::abs(corners[a][1] - corners[b][1]) +
                   std::abs(corners[a][2] - corners[b][2]);
          };
          for (std::size_t a = 0; a < corners.size(); ++a) {
            for (std::size_t b = a + 1; b < corners.size(); ++b) {
              if (!in(corners[a]) || !in(corners[b])) continue;
              if (differ(a, b) == 1) unite(a, b);
              if (differ(a, b) != 2) continue;
              std::vector<std::size_t> others;
              for (std::size_t c = 0; c < corners.size(); ++c) {
                if (differ(a, c) == 1 && differ(b, c) == 1) others.push_back(c);
              }
              if (in(corners[others[0]]) || in(corners[others[1]])) continue;
              if (joined({corners[a], corners[others[0]], corners[b], corners[others[1]]})) unite(a, b);
            }
          }
          std::int64_t pieces = 0;
          for (std::size_t a = 0; a < corners.size(); ++a) pieces += in(corners[a]) && part[a] == a;
          euler += std::popcount(axes) % 2 == 1 ? pieces : -pieces;
        }
      }
    }
  }
  return euler;
}

Grid grid_of(std::array<std::int32_t, 3> dims, Vec3 spacing = {1, 1, 1}) {
  return {.dims = dims, .spacing = spacing, .origin = {}, .direction = {}};
}

struct Shape {
  const char* name;
  phantoms::Field field;
  double volume, area;
  std::int64_t euler;
};

std::vector<Shape> shapes() {
  using namespace phantoms;
  const Vec3 o{0.03, -0.02, 0.01};
  return {{"ball", ball(o, 1), 4 * kPi / 3, 4 * kPi, 1},
          {"torus", torus(o, 0.8, 0.35), 2 * kPi * kPi * 0.8 * 0.35 * 0.35, 4 * kPi * kPi * 0.8 * 0.35, 0},
          {"shell", shell(o, 1.1, 0.6), 4 * kPi / 3 * (1.1 * 1.1 * 1.1 - 0.6 * 0.6 * 0.6),
           4 * kPi * (1.1 * 1.1 + 0.6 * 0.6), 2},
          {"two balls", either(ball({-0.7, 0, 0}, 0.5), ball({0.7, 0.1, 0}, 0.5)), kPi / 3, 2 * kPi, 2},
          // A chain of two rings.
          {"double torus", either(torus({-0.55, 0, 0}, 0.5, 0.2), torus({0.55, 0, 0}, 0.5, 0.2)), 0, 0, -1}};
}

TEST(MarchingCubes, ConvergeToTheirClosedForms) {
  for (const Shape& shape : shapes()) {
    double coarse_volume = 0, coarse_area = 0;
    for (const std::int32_t n : {24, 48, 96}) {
      const Drawn drawn = draw(phantoms::sample(shape.field, phantoms::cubic_grid(n, 3)), phantoms::threshold(0));
      EXPECT_EQ(drawn.measures.euler_characteristic, shape.euler) << shape.name << n;
      EXPECT_TRUE(torn_edges(drawn.mesh).empty());
      if (shape.volume == 0) continue;
      const double volume = std::abs(drawn.measures.volume_mm3 / shape.volume - 1),
                   area = std::abs(drawn.measures.area_mm2 / shape.area - 1);
      // Errors fall with the square of the step.
      if (n > 24) {
        EXPECT_LT(volume, coarse_volume / 3) << shape.name << n;
        EXPECT_LT(area, coarse_area / 3) << shape.name << n;
      }
      coarse_volume = volume, coarse_area = area;
    }
    if (shape.volume != 0) {
      EXPECT_LT(coarse_volume, 3e-3) << shape.name;
      EXPECT_LT(coarse_area, 2e-3) << shape.name;
    }
  }
}

TEST(MarchingCubes, OfOneSampleAreAnOctahedron) {
  Volume volume = phantoms::noise(grid_of({3, 3, 3}, {1, 2, 3}), 1, 0);
  phantoms::set_stored(volume, {1, 1, 1}, 1);
  const Drawn drawn = draw(volume, phantoms::labels({1}));
  EXPECT_EQ(drawn.measures.triangles, 8U);
  EXPECT_EQ(drawn.measures.euler_characteristic, 1);
  EXPECT_NEAR(drawn.measures.volume_mm3, 4.0 / 3 * 0.5 * 1 * 1.5, 1e-6);
  EXPECT_NEAR(drawn.measures.area_mm2, 4 * std::sqrt(0.25 + 0.5625 + 2.25), 1e-5);
}

TEST(MarchingCubes, MeetAClosedBorderHalfAVoxelBeyondAndStopAtAnOpenOne) {
  const Volume full = phantoms::noise(grid_of({4, 5, 6}), 1, 0);
  const Drawn closed = draw(full, phantoms::threshold(0));
  // The box of the samples, half a voxel put on each of its faces, its edges chamfered.
  const double a = 3, b = 4, c = 5;
  EXPECT_NEAR(closed.measures.volume_mm3, a * b * c + a * b + b * c + c * a + (a + b + c) / 2 + 1.0 / 6, 1e-12 * 120);
  EXPECT_EQ(closed.measures.euler_characteristic, 1);
  const Drawn open = draw(full, phantoms::threshold(0, Border::open));
  EXPECT_NEAR(open.measures.volume_mm3, a * b * c, 1e-12 * 60);
  EXPECT_EQ(open.measures.area_mm2, 0);
  EXPECT_EQ(open.measures.triangles, 0U);
  EXPECT_EQ(open.measures.euler_characteristic, 1);
  EXPECT_TRUE(open.mesh.triangles.empty());

  // A cylinder from border to border.
  const Grid grid{.dims = {49, 49, 11}, .spacing = {0.1, 0.1, 0.5}, .origin = {-2.4, -2.4, 0}, .direction = {}};
  const Drawn tube =
      draw(phantoms::sample(phantoms::cylinder({0, 0, 0}, 2), grid), phantoms::threshold(0, Border::open));
  EXPECT_NEAR(tube.measures.volume_mm3, kPi * 4 * 5, 0.002 * kPi * 20);
  EXPECT_NEAR(tube.measures.area_mm2, 2 * kPi * 2 * 5, 0.002 * kPi * 20);
  EXPECT_NEAR(area_of(tube.mesh), tube.measures.area_mm2, 1e-9 * tube.measures.area_mm2);
  EXPECT_EQ(tube.measures.euler_characteristic, 1);
}

// A range that no sample is in still has its two surfaces.
TEST(MarchingCubes, DrawARangeThatIsJumpedOver) {
  const Volume ramp = phantoms::sample([](Vec3 p) { return p.x; }, grid_of({8, 6, 5}), VoxelType::float64);
  for (const Border border : {Border::closed, Border::open}) {
    const Drawn sheet = draw(ramp, phantoms::range(3.25, 3.75, border));
    EXPECT_NEAR(sheet.measures.volume_mm3, 0.5 * 5 * 4, 1e-5);
    EXPECT_NEAR(sheet.measures.area_mm2, 2 * 5 * 4 + (border == Border::closed ? 2 * 0.5 * (5 + 4) : 0), 1e-4);
    EXPECT_EQ(sheet.measures.euler_characteristic, 1);
    EXPECT_EQ(torn_edges(sheet.mesh).empty(), border == Border::closed);
    // Its complement: two blocks.
    const Drawn rest = draw(ramp, phantoms::range(3.25, 3.75, border, Side::below));
    EXPECT_EQ(rest.measures.euler_characteristic, 2);
    EXPECT_EQ(torn_edges(rest.mesh).empty(), border == Border::closed);
    if (border == Border::open) {
      EXPECT_NEAR(rest.measures.volume_mm3, 6.5 * 5 * 4, 1e-5);
    }
  }
  const Volume distance = phantoms::sample(phantoms::ball({0, 0, 0}, 2), phantoms::cubic_grid(40, 5));
  const Drawn shell = draw(distance, phantoms::range(0, 0.05));
  EXPECT_NEAR(shell.measures.volume_mm3, 4 * kPi / 3 * (8 - 1.95 * 1.95 * 1.95), 0.02);
  EXPECT_EQ(shell.measures.euler_characteristic, 2);
}

TEST(MarchingCubes, HaveNoHolesOnNoiseAndTheTopologyOfTheirCells) {
  std::uint64_t seed = 0;
  std::size_t triangles = 0;
  for (const Vec3 spacing : {Vec3{1, 1, 1}, Vec3{1, 2, 5}}) {
    for (int n = 0; n < 12; ++n) {
      const Volume volume = phantoms::noise(grid_of({9, 7, 8}, spacing), 17, ++seed);
      for (const Side side : {Side::above, Side::below}) {
        for (const Border border : {Border::closed, Border::open}) {
          for (const ObjectRule& rule :
               {phantoms::threshold(7.5, border, side), phantoms::threshold(11, border, side),
                phantoms::labels({1, 3, 4, 8, 9, 12, 15}, border, side), phantoms::range(4.5, 9.25, border, side),
                phantoms::range(6, 6, border, side)}) {
            const Drawn drawn = draw(volume, rule);
            ASSERT_EQ(drawn.measures.triangles, drawn.mesh.triangles.size());
            ASSERT_NEAR(drawn.measures.area_mm2, area_of(drawn.mesh), 1e-9 * drawn.measures.area_mm2);
            const auto torn = torn_edges(drawn.mesh);
            if (border == Border::closed) {
              ASSERT_TRUE(torn.empty()) << seed;
              ASSERT_NEAR(drawn.measures.volume_mm3, volume_of(drawn.mesh), 1e-9 * drawn.measures.area_mm2);
            } else {
              const auto on_border = [&](std::uint32_t v) {
                const LatticePoint p = drawn.boundary.points[v];
                for (int axis = 0; axis < 3; ++axis) {
                  const auto size = volume.grid.dims[static_cast<std::size_t>(axis)];
                  if (p[axis] == drawn.boundary.lattice.plane(axis, 0) ||
                      p[axis] == drawn.boundary.lattice.plane(axis, size - 1))
                    return true;
                }
                return false;
              };
              for (const auto& [a, b] : torn) ASSERT_TRUE(on_border(a) && on_border(b));
            }
            if (rule.kind != ObjectRule::Kind::range) {
              ASSERT_EQ(drawn.measures.euler_characteristic, euler_by_cells(volume, rule)) << seed;
              triangles += drawn.mesh.triangles.size();
            }
          }
        }
      }
    }
  }
  EXPECT_GT(triangles, 10000U);
}

// Samples that are not finite are outside, whichever side of a range their neighbours are on.
TEST(MarchingCubes, HaveNoHolesBesideSamplesThatAreNotFinite) {
  for (std::uint64_t seed = 1; seed <= 12; ++seed) {
    const Volume volume = phantoms::noise_with_gaps(grid_of({9, 7, 8}, {1, 2, 1.5}), 17, seed);
    for (const Side side : {Side::above, Side::below}) {
      for (const ObjectRule& rule :
           {phantoms::threshold(7.5, Border::closed, side), phantoms::range(4.5, 9.25, Border::closed, side),
            phantoms::range(6, 6, Border::closed, side), phantoms::labels({1, 3, 4, 8, 9}, Border::closed, side)}) {
        const Drawn drawn = draw(volume, rule);
        ASSERT_TRUE(torn_edges(drawn.mesh).empty()) << seed;
        ASSERT_NEAR(drawn.measures.volume_mm3, volume_of(drawn.mesh), 1e-9 * drawn.measures.area_mm2);
      }
    }
  }
}

// What is between two surfaces of a range is what is above one and not above the other.
TEST(MarchingCubes, OfARangeAreTheDifferenceOfTwoThresholds) {
  for (std::uint64_t seed = 1; seed <= 6; ++seed) {
    const Volume volume = phantoms::noise(grid_of({8, 9, 7}, {1, 1, 2}), 1000, seed, VoxelType::uint16);
    const auto measured = [&](const ObjectRule& rule) { return draw(volume, rule).measures; };
    const auto low = measured(phantoms::threshold(300.5, Border::open)),
               high = measured(phantoms::threshold(700.5, Border::open)),
               between = measured(phantoms::range(300.5, 700.5, Border::open)),
               beyond = measured(phantoms::range(300.5, 700.5, Border::open, Side::below));
    const double whole = 7 * 8 * 12;
    EXPECT_NEAR(between.volume_mm3, low.volume_mm3 - high.volume_mm3, 1e-9 * whole);
    EXPECT_NEAR(beyond.volume_mm3, whole - between.volume_mm3, 1e-9 * whole);
    EXPECT_NEAR(between.area_mm2, low.area_mm2 + high.area_mm2, 1e-9 * low.area_mm2);
    EXPECT_NEAR(beyond.area_mm2, between.area_mm2, 1e-9 * low.area_mm2);
    EXPECT_EQ(between.triangles, low.triangles + high.triangles);
  }
}

TEST(MarchingCubes, TurnWithTheGrid) {
  const Volume volume = phantoms::noise(grid_of({7, 8, 9}, {1, 2, 1.5}), 9, 5);
  const Drawn plain = draw(volume, phantoms::threshold(4));
  Volume turned = volume;
  turned.grid.origin = {10, -20, 30};
  turned.grid.direction = {{Vec3{0.6, -0.8, 0}, Vec3{0.8, 0.6, 0}, Vec3{0, 0, -1}}};  // left-handed
  const Drawn mirrored = draw(turned, phantoms::threshold(4));
  EXPECT_EQ(mirrored.measures.volume_mm3, plain.measures.volume_mm3);
  EXPECT_EQ(mirrored.measures.area_mm2, plain.measures.area_mm2);
  EXPECT_NEAR(volume_of(mirrored.mesh), volume_of(plain.mesh), 1e-9 * plain.measures.volume_mm3);
}

TEST(MarchingCubes, AreTheSameForAnyThreadCount) {
  const Volume volume = phantoms::noise(grid_of({70, 30, 40}), 9, 11);
  for (const ObjectRule& rule : {phantoms::threshold(4), phantoms::range(2.5, 5.5)}) {
    const Drawn one = draw(volume, rule);
    for (const unsigned threads : {2U, 5U}) {
      const Drawn many = draw(volume, rule, {.threads = threads, .cancel = {}, .progress = {}});
      EXPECT_EQ(many.mesh.triangles, one.mesh.triangles);
      EXPECT_EQ(many.mesh.vertices, one.mesh.vertices);
      EXPECT_EQ(many.measures.volume_mm3, one.measures.volume_mm3);
      EXPECT_EQ(many.measures.area_mm2, one.measures.area_mm2);
    }
  }
}

TEST(MarchingCubes, CanBeCancelled) {
  const Volume volume = phantoms::noise(grid_of({20, 20, 20}), 9, 3);
  std::stop_source stop;
  stop.request_stop();
  const Context context{.threads = 2, .cancel = stop.get_token(), .progress = {}};
  EXPECT_THROW(draw(volume, phantoms::threshold(4), context), Error);
}

// A level set of a ball of radius 3, and a head.
TEST(MarchingCubes, OfRealDataAgreeWithVoxels) {
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  if (!std::filesystem::exists(folder / "ch2.nii.gz")) GTEST_SKIP() << "needs the shared test volumes";
  const Volume ball = read_volume({folder / "sphere-levelset.vdb"});
  const auto measures = draw(ball, phantoms::threshold(0, Border::closed, Side::below)).measures;
  EXPECT_NEAR(measures.volume_mm3, 36 * kPi, 0.001 * 36 * kPi);
  EXPECT_NEAR(measures.area_mm2, 36 * kPi, 0.001 * 36 * kPi);
  EXPECT_EQ(measures.euler_characteristic, 1);

  const Volume head = read_volume({folder / "ch2.nii.gz"});
  const ObjectRule rule = phantoms::threshold(60.5);
  const Drawn drawn = draw(head, rule);
  const VoxelMeasures voxels = measure_voxels(head.grid, classify_samples(head, rule).inside);
  EXPECT_NEAR(drawn.measures.volume_mm3, voxels.volume_mm3, 0.01 * voxels.volume_mm3);
  EXPECT_EQ(drawn.measures.triangles, drawn.mesh.triangles.size());
  EXPECT_NEAR(volume_of(drawn.mesh), drawn.measures.volume_mm3, 1e-9 * drawn.measures.volume_mm3);
  EXPECT_TRUE(torn_edges(drawn.mesh).empty());
}

}  // namespace
}  // namespace spherule
