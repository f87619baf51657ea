// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/union.h"

#include <gtest/gtest.h>

#include <cmath>
#include <numbers>

#include "core/pipeline.h"
#include "tests/core/balls.h"

namespace spherule {
namespace {

constexpr double kPi = std::numbers::pi;
constexpr double kClosedForm = 1e-12;  // relative, as promised for closed forms

double cube(double x) { return x * x * x; }
double ball_volume(double r) { return 4 * kPi / 3 * cube(r); }
double cap_volume(double r, double height) { return kPi * height * height * (3 * r - height) / 3; }

void expect_near_relative(double actual, double expected, double tolerance) {
  EXPECT_NEAR(actual, expected, tolerance * std::abs(expected));
}

UnionMeasures measure(const std::vector<Sphere>& balls) { return measure_union(std::span(balls)); }

TEST(Union, OfNothingIsNothing) {
  const UnionMeasures m = measure({});
  EXPECT_EQ(m.moments.volume, 0);
  EXPECT_EQ(m.area_mm2, 0);
  EXPECT_TRUE(m.parts.empty());
}

TEST(Union, OfOneBall) {
  const UnionMeasures m = measure({{{1, -2, 3}, 2.5}});
  expect_near_relative(m.moments.volume, ball_volume(2.5), kClosedForm);
  expect_near_relative(m.area_mm2, 4 * kPi * 2.5 * 2.5, kClosedForm);
  const MassProperties mass = mass_properties(m.moments);
  EXPECT_NEAR(mass.centroid_mm.x, 1, 1e-14);
  EXPECT_NEAR(mass.centroid_mm.y, -2, 1e-14);
  EXPECT_NEAR(mass.centroid_mm.z, 3, 1e-14);
  for (const double moment : mass.principal_moments_mm5)
    expect_near_relative(moment, 0.4 * ball_volume(2.5) * 2.5 * 2.5, kClosedForm);
}

class TwoBalls : public testing::TestWithParam<double> {};

TEST_P(TwoBalls, AreKnownInClosedForm) {
  const double R = 2, r = 1, d = GetParam();
  // Anywhere, along a direction that is no axis.
  const Vec3 at{10, -20, 5}, along = normalised({1, 2, -0.5});
  const UnionMeasures m = measure({{at, R}, {at + d * along, r}});
  double volume = ball_volume(R), area = 4 * kPi * R * R;
  if (d >= R + r) {
    volume += ball_volume(r);
    area += 4 * kPi * r * r;
  } else if (d > R - r) {
    const double plane = (d * d + R * R - r * r) / (2 * d);
    volume += ball_volume(r) - cap_volume(R, R - plane) - cap_volume(r, r - (d - plane));
    area += 4 * kPi * r * r - 2 * kPi * R * (R - plane) - 2 * kPi * r * (r - (d - plane));
  }
  expect_near_relative(m.moments.volume, volume, kClosedForm);
  expect_near_relative(m.area_mm2, area, kClosedForm);
  expect_near_relative(m.parts[0].volume_mm3 + m.parts[1].volume_mm3, volume, kClosedForm);
}
INSTANTIATE_TEST_SUITE_P(FromConcentricToApart, TwoBalls,
                         testing::Values(0.0, 0.3, 0.999999, 1.0, 1.000001, 1.3, std::sqrt(3.0), 2.0, 2.5, 2.999999,
                                         3.0, 3.000001, 4.0));

// The angle at apex `a` of the cone over triangle bcd, as a part of the whole sphere (Van Oosterom and Strackee, 1983).
double solid_angle(Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  b = normalised(b - a), c = normalised(c - a), d = normalised(d - a);
  return 2 * std::atan2(std::abs(dot(b, cross(c, d))), 1 + dot(b, c) + dot(c, d) + dot(d, b)) / (4 * kPi);
}
// The angle at edge ab between triangles abc and abd, as a part of the whole turn.
double dihedral(Vec3 a, Vec3 b, Vec3 c, Vec3 d) {
  const Vec3 e = b - a, m = cross(e, c - a), n = cross(e, d - a);
  return std::atan2(norm(cross(m, n)), dot(m, n)) / (2 * kPi);
}
double lens(const Sphere& a, const Sphere& b) {
  const double d = norm(b.centre - a.centre);
  const double plane = (d * d + a.radius * a.radius - b.radius * b.radius) / (2 * d);
  return cap_volume(a.radius, a.radius - plane) + cap_volume(b.radius, b.radius - (d - plane));
}
// The common part of three balls whose spheres meet in two points, one of them p: the tetrahedron over the centres,
// covered by sectors, less wedges (H. Edelsbrunner, P. Fu, Measuring space filling diagrams and voids, 1994).
double common(const Sphere& a, const Sphere& b, const Sphere& c, Vec3 p) {
  const Vec3 A = a.centre, B = b.centre, C = c.centre;
  const double tetrahedron = std::abs(dot(B - A, cross(C - A, p - A))) / 6;
  return 2 *
         (tetrahedron - solid_angle(A, B, C, p) * ball_volume(a.radius) -
          solid_angle(B, A, C, p) * ball_volume(b.radius) - solid_angle(C, A, B, p) * ball_volume(c.radius) +
          dihedral(A, B, C, p) * lens(a, b) + dihedral(A, C, B, p) * lens(a, c) + dihedral(B, C, A, p) * lens(b, c));
}

TEST(Union, OfThreeBalls) {
  const Vec3 p{0.2, 0.1, 0.9};
  const std::vector<Vec3> centres{{0, 0, 0}, {1.1, 0, 0}, {0.3, 1.2, 0}};
  std::vector<Sphere> balls;
  for (const Vec3& c : centres) balls.push_back({c, norm(p - c)});
  const double expected = ball_volume(balls[0].radius) + ball_volume(balls[1].radius) + ball_volume(balls[2].radius) -
                          lens(balls[0], balls[1]) - lens(balls[0], balls[2]) - lens(balls[1], balls[2]) +
                          common(balls[0], balls[1], balls[2], p);
  expect_near_relative(measure(balls).moments.volume, expected, kClosedForm);
}

TEST(Union, OfAChain) {
  // Unit balls at distance 1: neighbours overlap, others touch at most.
  const int n = 50;
  std::vector<Sphere> balls;
  for (int i = 0; i < n; ++i) balls.push_back({{1.0 * i, 0.25, -3}, 1});
  const UnionMeasures m = measure(balls);
  expect_near_relative(m.moments.volume, n * ball_volume(1) - (n - 1) * 2 * cap_volume(1, 0.5), kClosedForm);
  expect_near_relative(m.area_mm2, n * 4 * kPi - (n - 1) * 2 * (2 * kPi * 0.5), kClosedForm);
  expect_near_relative(m.moments.first.x / m.moments.volume, (n - 1) / 2.0, kClosedForm);
}

TEST(Union, OfEightBallsOnACube) {
  // Edge 1.2: balls at opposite corners of a face overlap not; each ball loses three caps that do not meet.
  std::vector<Sphere> apart;
  // Edge 1 and radius √3/2: all eight meet in the middle, and each one's cell is an octant of space.
  std::vector<Sphere> meeting;
  for (int c = 0; c < 8; ++c) {
    const Vec3 corner{double(c & 1), double(c >> 1 & 1), double(c >> 2)};
    apart.push_back({1.2 * corner, 0.8});
    meeting.push_back({corner, std::sqrt(3.0) / 2});
  }
  const UnionMeasures a = measure(apart);
  expect_near_relative(a.moments.volume, 8 * (ball_volume(0.8) - 3 * cap_volume(0.8, 0.2)), kClosedForm);
  expect_near_relative(a.area_mm2, 8 * (4 * kPi * 0.64 - 3 * 2 * kPi * 0.8 * 0.2), kClosedForm);
  // By symmetry, eight times the first ball's part; its three caps overlap in pairs here, so count what is left with
  // the octants of the ball: each of the caps' complement is the cube of half edge 0.5 where all three are cut.
  const UnionMeasures m = measure(meeting);
  for (const BallPart& part : m.parts) {
    expect_near_relative(part.volume_mm3, m.moments.volume / 8, kClosedForm);
    expect_near_relative(part.area_mm2, m.area_mm2 / 8, kClosedForm);
  }
  const double grown = 1e-5;
  const auto volume_at = [&](double growth) {
    std::vector<Sphere> balls = meeting;
    for (Sphere& b : balls) b.radius += growth;
    return measure(balls).moments.volume;
  };
  expect_near_relative((volume_at(2 * grown) - volume_at(0)) / (2 * grown),
                       measure([&] {
                         std::vector<Sphere> balls = meeting;
                         for (Sphere& b : balls) b.radius += grown;
                         return balls;
                       }())
                           .area_mm2,
                       1e-8);
}

TEST(Union, HiddenIdenticalTangentConcentricAndPointBallsAreOrdinary) {
  const std::vector<Sphere> balls{{{0, 0, 0}, 2}, {{0.5, 0, 0}, 1},   {{0, 0, 0}, 2}, {{0, 0, 0}, 1},
                                  {{3, 0, 0}, 1}, {{0, 0, 1.5}, 0.5}, {{9, 9, 9}, 0}, {{1, 0, 0}, 0}};
  const UnionMeasures m = measure(balls);
  expect_near_relative(m.moments.volume, ball_volume(2) + ball_volume(1), kClosedForm);
  expect_near_relative(m.area_mm2, 4 * kPi * 5, kClosedForm);
  expect_near_relative(m.parts[0].volume_mm3, ball_volume(2), kClosedForm);
  expect_near_relative(m.parts[4].area_mm2, 4 * kPi, kClosedForm);
  for (const std::size_t nothing : {1U, 2U, 3U, 5U, 6U, 7U}) {
    EXPECT_EQ(m.parts[nothing].volume_mm3, 0) << nothing;
    EXPECT_EQ(m.parts[nothing].area_mm2, 0) << nothing;
  }
}

TEST(Union, GrowsByItsArea) {
  const std::vector<Sphere> balls = random_balls(300, 6, 0.3, 1.0, 1);
  const auto volume_at = [&](double growth) {
    std::vector<Sphere> grown = balls;
    for (Sphere& b : grown) b.radius += growth;
    return measure(grown).moments.volume;
  };
  // Richardson's extrapolation of central differences: the error is of the fourth order in the step.
  const auto slope = [&](double step) { return (volume_at(step) - volume_at(-step)) / (2 * step); };
  const double step = 1e-4;
  expect_near_relative((4 * slope(step) - slope(2 * step)) / 3, measure(balls).area_mm2, 1e-8);
}

TEST(Union, PartsAreItsDerivatives) {
  const std::vector<Sphere> balls = random_balls(60, 3, 0.3, 1.0, 2);
  const UnionMeasures m = measure(balls);
  const double step = 1e-5;
  for (std::size_t i = 0; i < balls.size(); ++i) {
    const auto slope = [&](auto change) {
      std::vector<Sphere> more = balls, less = balls;
      change(more[i], step);
      change(less[i], -step);
      return (measure(more).moments.volume - measure(less).moments.volume) / (2 * step);
    };
    EXPECT_NEAR(slope([](Sphere& s, double d) { s.radius += d; }), m.parts[i].area_mm2, 1e-6) << i;
    EXPECT_NEAR(slope([](Sphere& s, double d) { s.centre.x += d; }), m.parts[i].push_mm2.x, 1e-6) << i;
    EXPECT_NEAR(slope([](Sphere& s, double d) { s.centre.y += d; }), m.parts[i].push_mm2.y, 1e-6) << i;
    EXPECT_NEAR(slope([](Sphere& s, double d) { s.centre.z += d; }), m.parts[i].push_mm2.z, 1e-6) << i;
  }
}

// The i-th point of Halton's sequence in a base.
double halton(std::uint64_t i, std::uint64_t base) {
  double f = 1, x = 0;
  for (; i > 0; i /= base) x += (f /= static_cast<double>(base)) * static_cast<double>(i % base);
  return x;
}

TEST(Union, AgreesWithQuasiMonteCarlo) {
  const double side = 18;
  const std::vector<Sphere> balls = random_balls(10000, side, 0.3, 0.7, 3);
  // Balls by unit cells of space, so that each point asks few.
  constexpr int n = 20;
  std::vector<std::vector<Sphere>> bins(n * n * n);
  const auto bin = [](int x, int y, int z) { return static_cast<std::size_t>(((z + 1) * n + (y + 1)) * n + x + 1); };
  for (const Sphere& b : balls)
    bins[bin(static_cast<int>(b.centre.x), static_cast<int>(b.centre.y), static_cast<int>(b.centre.z))].push_back(b);
  const auto inside = [&](Vec3 p) {
    const int x = static_cast<int>(p.x), y = static_cast<int>(p.y), z = static_cast<int>(p.z);
    for (int k = -1; k <= 1; ++k)
      for (int j = -1; j <= 1; ++j)
        for (int i = -1; i <= 1; ++i)
          for (const Sphere& b : bins[bin(x + i, y + j, z + k)])
            if (squared_norm(p - b.centre) < b.radius * b.radius) return true;
    return false;
  };
  std::vector<Sphere> within;  // the cube of the samples holds all
  for (const Sphere& b : balls) {
    bool fits = true;
    for (int a = 0; a < 3; ++a) fits = fits && b.centre[a] > b.radius && b.centre[a] < side - b.radius;
    if (fits) within.push_back(b);
  }
  for (auto& b : bins) b.clear();
  for (const Sphere& b : within)
    bins[bin(static_cast<int>(b.centre.x), static_cast<int>(b.centre.y), static_cast<int>(b.centre.z))].push_back(b);
  const std::uint64_t samples = 400'000;
  std::uint64_t hits = 0;
  for (std::uint64_t s = 1; s <= samples; ++s)
    hits += inside({side * halton(s, 2), side * halton(s, 3), side * halton(s, 5)});
  const double estimate = cube(side) * static_cast<double>(hits) / static_cast<double>(samples);
  // Independent samples would be off by 0.08 % (one standard deviation); these are better.
  expect_near_relative(measure(within).moments.volume, estimate, 2e-3);
}

TEST(Union, IsTheSameForAnyThreadCount) {
  const std::vector<Sphere> balls = random_balls(9000, 15, 0.3, 1.0, 4);
  const UnionMeasures one = measure_union(std::span(balls), {.threads = 1, .cancel = {}, .progress = {}});
  const UnionMeasures three = measure_union(std::span(balls), {.threads = 3, .cancel = {}, .progress = {}});
  EXPECT_EQ(one.moments.volume, three.moments.volume);
  EXPECT_EQ(one.area_mm2, three.area_mm2);
  EXPECT_EQ(one.moments.second, three.moments.second);
}

TEST(Union, CanBeCancelled) {
  std::stop_source stop;
  stop.request_stop();
  const std::vector<Sphere> balls = random_balls(100, 5, 0.3, 1.0, 5);
  EXPECT_THROW(measure_union(std::span(balls), {.threads = 2, .cancel = stop.get_token(), .progress = {}}), Error);
}

SphereModel model_of(const phantoms::Field& field, const Grid& grid, VoxelType type = VoxelType::float64) {
  return build_model(phantoms::sample(field, grid, type), phantoms::threshold(0)).model;
}

void expect_same_union(const SphereModel& model, double tolerance) {
  const UnionMeasures caps = measure_raw_union(model), cells = measure_union(std::span(model.spheres));
  expect_near_relative(caps.moments.volume, cells.moments.volume, tolerance);
  expect_near_relative(caps.area_mm2, cells.area_mm2, tolerance);
  const MassProperties a = mass_properties(caps.moments), b = mass_properties(cells.moments);
  EXPECT_NEAR(norm(a.centroid_mm - b.centroid_mm), 0, tolerance * norm(bounds(model).max - bounds(model).min));
  for (std::size_t i = 0; i < 3; ++i)
    expect_near_relative(a.principal_moments_mm5[i], b.principal_moments_mm5[i], tolerance);
  double volume = 0, area = 0;
  for (const BallPart& part : caps.parts) {
    EXPECT_GE(part.volume_mm3, 0);
    volume += part.volume_mm3;
    area += part.area_mm2;
  }
  expect_near_relative(volume, caps.moments.volume, 1e-12);
  expect_near_relative(area, caps.area_mm2, 1e-12);
}

// Raw sets are the worst that the general way can be given: it meets the promised 1e-14 a ball only to 1e-9 there,
// since hundreds of planes meet in each boundary point.
TEST(RawUnion, IsTheUnionOfAllItsBalls) {
  const Grid grid = phantoms::cubic_grid(12, 11);
  expect_same_union(model_of(phantoms::ball({0.1, 0.2, -0.3}, 4.1), grid), 1e-9);
  expect_same_union(model_of(phantoms::torus({0.1, 0.2, -0.3}, 3.1, 1.4), grid), 1e-9);
  expect_same_union(model_of(phantoms::shell({0.1, 0.2, -0.3}, 4.6, 2.2), grid), 1e-9);
  Grid flat = grid;
  flat.spacing = {0.7, 1, 1.9};
  flat.direction = {{Vec3{0, 1, 0}, Vec3{0.6, 0, 0.8}, Vec3{0.8, 0, -0.6}}};
  expect_same_union(model_of(phantoms::either(phantoms::ball({2, 3, 0}, 2.5), phantoms::ball({2, 3, 7}, 2.2)), flat),
                    1e-9);
}

// Here the general way must tell apart balls whose centres differ by rounding.
TEST(RawUnion, OfGridsWhereManyCellsShareASphere) {
  const Grid grid = phantoms::cubic_grid(9, 8);
  expect_same_union(model_of(phantoms::cube({0, 0, 0}, 2.5), grid), 1e-8);
  expect_same_union(build_model(phantoms::noise(phantoms::cubic_grid(6, 5), 2, 7), phantoms::threshold(1)).model, 1e-8);
  expect_same_union(build_model(phantoms::noise(phantoms::cubic_grid(7, 6), 256, 8), phantoms::threshold(128)).model,
                    1e-8);
}

TEST(RawUnion, IsTheSameForAnyThreadCount) {
  const SphereModel model = model_of(phantoms::torus({0, 0, 0}, 6, 3), phantoms::cubic_grid(24, 23));
  const UnionMeasures one = measure_raw_union(model, {.threads = 1, .cancel = {}, .progress = {}});
  const UnionMeasures three = measure_raw_union(model, {.threads = 3, .cancel = {}, .progress = {}});
  EXPECT_EQ(one.moments.volume, three.moments.volume);
  EXPECT_EQ(one.area_mm2, three.area_mm2);
}

TEST(RawUnion, ConvergesToTheSolid) {
  struct Errors {
    double volume, area;
  };
  const auto errors_at = [](std::int32_t n) {
    const UnionMeasures m =
        measure_raw_union(model_of(phantoms::torus({0.01, 0.02, 0.03}, 5, 2), phantoms::cubic_grid(n, 16)));
    const double volume = 2 * kPi * kPi * 5 * 2 * 2, area = 4 * kPi * kPi * 5 * 2;
    return Errors{m.moments.volume / volume - 1, m.area_mm2 / area - 1};
  };
  const Errors coarse = errors_at(20), fine = errors_at(40);
  EXPECT_LT(std::abs(fine.volume), std::abs(coarse.volume) / 2.5);
  EXPECT_LT(std::abs(fine.area), std::abs(coarse.area));
}

}  // namespace
}  // namespace spherule
