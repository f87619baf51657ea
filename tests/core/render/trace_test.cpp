// SPDX-License-Identifier: GPL-3.0-or-later
//
// Rays against closed forms, and against slow obvious models of what they should meet.
#include "core/render/trace.h"

#include <gtest/gtest.h>

#include <ctime>
#include <map>

#include "tests/core/render/scenes.h"

namespace spherule {
namespace {

std::unique_ptr<const Tracer> tracer_of(std::span<const Sphere> balls, const std::optional<HalfSpace>& cut = {}) {
  SphereModel model;
  model.spheres.assign(balls.begin(), balls.end());
  return trace_balls(balls, visible_patches(model), cut, {});
}

// Random rays from outside a ball of this radius about the origin, aimed into it.
std::vector<Ray> rays_at(double radius, std::size_t n) {
  std::mt19937_64 random(5);
  std::normal_distribution<double> normal;
  std::vector<Ray> rays;
  while (rays.size() < n) {
    const Vec3 from = 3 * radius * normalised(Vec3{normal(random), normal(random), normal(random)});
    const Vec3 to = 0.5 * radius * Vec3{normal(random), normal(random), normal(random)};
    rays.push_back({from, normalised(to - from)});
  }
  return rays;
}

void expect_packets_as_single_rays(const Tracer& tracer) {
  const auto rays = rays_at(15, 1000);
  std::vector<Hit> hits(rays.size());
  tracer.first_hits(rays, hits);
  std::vector<std::uint8_t> alike(rays.size()), apart(rays.size());
  tracer.blocked(rays, alike, true);
  tracer.blocked(rays, apart, false);
  std::size_t met = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const auto alone = tracer.first_hit(rays[i]);
    ASSERT_EQ(alone.has_value(), bool(hits[i]));
    ASSERT_EQ(alike[i] != 0, bool(hits[i]));
    ASSERT_EQ(apart[i] != 0, bool(hits[i]));
    if (!alone) continue;
    ++met;
    ASSERT_EQ(alone->distance, hits[i].distance);
    ASSERT_EQ(alone->primitive, hits[i].primitive);
    ASSERT_EQ(tracer.place(rays[i], *alone).normal, tracer.place(rays[i], hits[i]).normal);
  }
  EXPECT_GT(met, 500U);
}

TEST(Trace, PacketsAndSingleRaysMeetTheSame) {
  const SphereModel model = random_balls(400, 3);
  expect_packets_as_single_rays(*tracer_of(model.spheres));
  for (const double blend : {0.1, 3.0}) expect_packets_as_single_rays(*trace_blobs(model.spheres, blend, {}));
}

TEST(Trace, WhatIsBeyondARaysEndDoesNotCount) {
  const std::vector<Sphere> ball{{{0, 0, 0}, 2}};
  const auto tracer = tracer_of(ball);
  EXPECT_TRUE(tracer->blocked(Ray{{-10, 0, 0}, {1, 0, 0}, 8.001}));
  EXPECT_FALSE(tracer->blocked(Ray{{-10, 0, 0}, {1, 0, 0}, 7.999}));
  EXPECT_TRUE(tracer->first_hit({{-10, 0, 0}, {1, 0, 0}, 8.001}));
  EXPECT_FALSE(tracer->first_hit({{-10, 0, 0}, {1, 0, 0}, 7.999}));
}

TEST(Trace, RaysFromFarAwayHitToTheMicrometre) {
  const std::vector<Sphere> balls{{{0, 0, 0}, 1}, {{0.5, 0.2, 0}, 1}};
  const auto tracer = tracer_of(balls);
  const auto hit = tracer->first_hit({{-1e6, 0.25, 0.5}, {1, 0, 0}});
  ASSERT_TRUE(hit);
  EXPECT_NEAR(hit->distance, 1e6 - std::sqrt(1 - 0.0625 - 0.25), 1e-6);
}

// Embree's own numbers are of single precision, and it ends the process that shows it others.
TEST(Trace, OddRaysMeetNothingOrWhatIsThere) {
  for (const double size : {1e-18, 1e-9, 1.0, 1e9}) {
    const std::vector<Sphere> balls{{{0, 0, 0}, size}, {{size, 0, 0}, size}};
    const auto tracer = tracer_of(balls), blobs = trace_blobs(balls, 0.5 * size, {});
    const double infinity = std::numeric_limits<double>::infinity(), nan = std::nan("");
    for (const Tracer* t : {tracer.get(), blobs.get()}) {
      for (const double far : {1e12, 1e30, 1e200, 1e308, infinity, nan})
        for (const Vec3 from : {Vec3{-far, 0, 0}, Vec3{0, far, 0}, Vec3{far, far, far}})
          for (const Vec3 to : {Vec3{1, 0, 0}, Vec3{0, -1, 0}, Vec3{nan, 0, 0}, Vec3{0, 0, 0}})
            for (const double end : {infinity, 0.0, -1.0, 1e300, nan}) {
              const Ray ray{from, to, end};
              std::array<Ray, 3> rays{ray, ray, ray};
              std::array<Hit, 3> hits;
              std::array<std::uint8_t, 3> blocked;
              t->first_hits(rays, hits);
              t->blocked(rays, blocked, true);
              t->blocked(rays, blocked, false);
            }
      const auto hit = t->first_hit({{-10 * size, 0.25 * size, 0}, {1, 0, 0}});
      ASSERT_TRUE(hit);
      EXPECT_NEAR(hit->distance / size, t == tracer.get() ? 10 - std::sqrt(0.9375) : 9.0317541634, 1e-9);
    }
  }
}

TEST(Trace, InsideOfBallsOnACutAndOffIt) {
  const SphereModel model = random_balls(300, 4);
  const HalfSpace cut{normalised({1, 2, -0.5}), 1.5};
  const auto tracer = tracer_of(model.spheres, cut);
  std::mt19937_64 random(8);
  std::uniform_real_distribution<double> part(-14, 14);
  std::size_t in = 0;
  for (int i = 0; i < 4000; ++i) {
    Vec3 p{part(random), part(random), part(random)};
    if (i % 2 == 0) p = p - (dot(cut.normal, p) - cut.offset) * cut.normal;
    bool expected = false;
    for (const Sphere& s : model.spheres) expected = expected || squared_norm(p - s.centre) <= s.radius * s.radius;
    ASSERT_EQ(tracer->inside(p), expected);
    in += expected;
  }
  EXPECT_GT(in, 500U);
  EXPECT_LT(in, 3500U);
}

// --- facets ---

struct Shell {
  std::vector<Vec3> vertices;
  std::vector<Triangle> triangles;
};

// A ball's surface as an octahedron divided again and again.
Shell round_shell(Vec3 centre, double radius, int levels) {
  Shell shell;
  shell.vertices = {{1, 0, 0}, {-1, 0, 0}, {0, 1, 0}, {0, -1, 0}, {0, 0, 1}, {0, 0, -1}};
  shell.triangles = {{0, 2, 4}, {2, 1, 4}, {1, 3, 4}, {3, 0, 4}, {2, 0, 5}, {1, 2, 5}, {3, 1, 5}, {0, 3, 5}};
  for (int level = 0; level < levels; ++level) {
    std::map<std::pair<std::uint32_t, std::uint32_t>, std::uint32_t> middles;
    const auto middle = [&](std::uint32_t a, std::uint32_t b) {
      const auto [found, added] =
          middles.try_emplace(std::minmax(a, b), static_cast<std::uint32_t>(shell.vertices.size()));
      if (added) shell.vertices.push_back(normalised(shell.vertices[a] + shell.vertices[b]));
      return found->second;
    };
    std::vector<Triangle> finer;
    for (const auto& [a, b, c] : shell.triangles) {
      const auto ab = middle(a, b), bc = middle(b, c), ca = middle(c, a);
      finer.insert(finer.end(), {{a, ab, ca}, {b, bc, ab}, {c, ca, bc}, {ab, bc, ca}});
    }
    shell.triangles = finer;
  }
  for (Vec3& v : shell.vertices) v = centre + radius * v;
  return shell;
}

TEST(Facets, NoRaySlipsThroughBetweenThem) {
  // Rays along the axes through vertices and along edges of the octahedron, and many others.
  const Shell shell = round_shell({0, 0, 0}, 1, 4);
  const auto tracer = trace_facets(shell.vertices, shell.triangles, false, {});
  std::vector<Ray> rays;
  for (const Vec3 v : shell.vertices) {
    rays.push_back({3 * v, -v});
    rays.push_back({{v.x * 0.999, v.y * 0.999, 5}, {0, 0, -1}});
  }
  for (const auto& t : shell.triangles) {
    const Vec3 m = 0.5 * (shell.vertices[t[0]] + shell.vertices[t[1]]);
    rays.push_back({3 * m, normalised(-m)});
  }
  for (const Ray& ray : rays) {
    const auto hit = tracer->first_hit(ray);
    ASSERT_TRUE(hit);
    const Place place = tracer->place(ray, *hit);
    ASSERT_NEAR(norm(place.point), 1, 0.005);
    ASSERT_LT(dot(place.normal, ray.direction), 1e-9);
  }
}

TEST(Facets, SmoothNormalsAndCurvatureOfABall) {
  const double radius = 4;
  const Shell shell = round_shell({10, -20, 30}, radius, 5);
  const auto tracer = trace_facets(shell.vertices, shell.triangles, true, {});
  for (Ray ray : rays_at(radius, 300)) {
    ray.origin = ray.origin + Vec3{10, -20, 30};
    const auto hit = tracer->first_hit(ray);
    if (!hit) continue;
    const Place place = tracer->place(ray, *hit);
    const Vec3 out = normalised(place.point - Vec3{10, -20, 30});
    EXPECT_GT(dot(place.normal, out), 0.9999);
    EXPECT_GT(norm(place.start - Vec3{10, -20, 30}), norm(place.point - Vec3{10, -20, 30}));
    EXPECT_NEAR(tracer->curvature(place.point, *hit), 1 / radius, 0.05 / radius);
  }
}

TEST(Facets, Inside) {
  const Shell shell = round_shell({0, 0, 0}, 2, 4);
  const auto tracer = trace_facets(shell.vertices, shell.triangles, true, {});
  EXPECT_TRUE(tracer->inside({0, 0, 0}));
  EXPECT_TRUE(tracer->inside({0, 1.9, 0}));
  EXPECT_FALSE(tracer->inside({0, 2.1, 0}));
  EXPECT_FALSE(tracer->inside({-5, 0, 0}));
}

// --- blobs ---

// The field as blobs.cpp states it.
double field(std::span<const Sphere> balls, double blend, Vec3 x) {
  double sum = 0;
  for (const Sphere& s : balls) {
    const double reach = s.radius + blend, squared = squared_norm(x - s.centre);
    if (s.radius <= 0 || squared >= reach * reach) continue;
    const double f = (reach * reach - squared) / (reach * reach - s.radius * s.radius);
    sum += f * f;
  }
  return sum;
}

// The first of very many steps along the ray at which the field has come to 1.
double slow_rise(std::span<const Sphere> balls, double blend, const Ray& ray, double length, int steps) {
  for (int i = 1; i <= steps; ++i) {
    const double t = length * i / steps;
    if (field(balls, blend, ray.origin + t * ray.direction) >= 1) return t;
  }
  return std::numeric_limits<double>::infinity();
}

void expect_rises(std::span<const Sphere> balls, double blend, std::span<const Ray> rays, double length) {
  constexpr int kSteps = 6000;
  const auto tracer = trace_blobs(balls, blend, {});
  std::vector<Hit> hits(rays.size());
  tracer->first_hits(rays, hits);
  std::size_t met = 0;
  for (std::size_t i = 0; i < rays.size(); ++i) {
    const double slow = slow_rise(balls, blend, rays[i], length, kSteps);
    const bool seen = bool(hits[i]);
    ASSERT_EQ(tracer->blocked(rays[i]), seen);
    if (!seen) {
      ASSERT_EQ(slow, std::numeric_limits<double>::infinity()) << "a root was missed";
      continue;
    }
    ++met;
    const Vec3 point = rays[i].origin + hits[i].distance * rays[i].direction;
    ASSERT_NEAR(field(balls, blend, point), 1, 1e-9);
    // Steps may pass over a graze, but never see the surface before the exact root.
    ASSERT_GT(slow, hits[i].distance - 1e-9);
  }
  EXPECT_GT(met, rays.size() / 10);
}

TEST(Blobs, OfTwoBallsAgainstTheFieldItself) {
  for (const double blend : {0.05, 0.5, 2.0}) {
    const std::vector<Sphere> balls{{{-1.2, 0, 0}, 1}, {{1.2, 0.3, 0}, 0.8}};
    expect_rises(balls, blend, rays_at(3, 500), 20);
  }
}

TEST(Blobs, OfManyBallsAgainstTheFieldItself) {
  const SphereModel model = random_balls(60, 2.5);
  for (const double blend : {0.2, 1.5}) expect_rises(model.spheres, blend, rays_at(14, 300), 90);
}

// So many lie in each other that all are summed up in polynomials, cell by cell.
TEST(Blobs, OfBallsInEachOtherAgainstTheFieldItself) {
  std::mt19937_64 random(7);
  std::uniform_real_distribution<double> unit;
  std::vector<Sphere> balls;
  for (int i = 0; i < 80; ++i) balls.push_back({{3 * unit(random), unit(random), unit(random)}, 0.2 + unit(random)});
  for (int i = 0; i < 30; ++i) balls.push_back({{5, 0, 0}, 1});
  for (const double blend : {0.05, 0.4, 3.0}) {
    expect_rises(balls, blend, rays_at(3.2, 40), 30);
    const auto tracer = trace_blobs(balls, blend, {});
    for (int i = 0; i < 3000; ++i) {
      const Vec3 point{-4 + 14 * unit(random), -4 + 9 * unit(random), -4 + 9 * unit(random)};
      const double sum = field(balls, blend, point);
      if (std::abs(sum - 1) > 1e-9) {
        ASSERT_EQ(tracer->inside(point), sum > 1) << sum;
      }
    }
  }
}

// A ray that starts inside has not entered, and first leaves, through however many cells.
TEST(Blobs, AreEnteredAgainByRaysThatStartInside) {
  std::mt19937_64 random(9);
  std::uniform_real_distribution<double> unit;
  std::vector<Sphere> balls;
  for (int i = 0; i < 60; ++i)
    for (const double x : {0., 6.})
      balls.push_back({{x + unit(random), unit(random), unit(random)}, 0.3 + unit(random)});
  const auto tracer = trace_blobs(balls, 0.4, {});
  int again = 0;
  for (const Ray& aimed : rays_at(3, 200)) {
    const Ray ray{{0.5, 0.5, 0.5}, aimed.direction};
    double slow = std::numeric_limits<double>::infinity();
    bool left = false;
    for (int i = 1; i <= 4000 && slow > 20; ++i) {
      const double t = 0.004 * i, sum = field(balls, 0.4, ray.origin + t * ray.direction);
      left = left || sum < 1;
      if (left && sum >= 1) slow = t;
    }
    const auto hit = tracer->first_hit(ray);
    ASSERT_EQ(hit.has_value(), slow < 20);
    ASSERT_EQ(tracer->blocked(ray), slow < 20);
    if (!hit) continue;
    ASSERT_LT(hit->distance, slow + 1e-9);
    ASSERT_GT(hit->distance, slow - 0.004 - 1e-9);
    ++again;
  }
  EXPECT_GT(again, 5);
}

TEST(Blobs, FirstRiseIsTheFirst) {
  // A row of blobs that barely do or do not reach 1 between their balls, met end on and across.
  std::vector<Sphere> row;
  for (int i = 0; i < 20; ++i) row.push_back({{3.0 * i, 0.3 * (i % 3), 0}, 0.5 + 0.02 * i});
  std::vector<Ray> rays;
  for (int i = 0; i < 400; ++i) rays.push_back({{-10, -2 + 0.01 * i, 0.01}, {1, 0, 0}});
  expect_rises(row, 1.2, rays, 90);
}

TEST(Blobs, OfOneBallIsTheBall) {
  const std::vector<Sphere> ball{{{3, 1, -2}, 5}};
  const auto tracer = trace_blobs(ball, 0.7, {});
  for (const double offset : {0.0, 1.0, 4.0, 4.99}) {
    const Ray ray{{-50, 1 + offset, -2}, {1, 0, 0}};
    const auto hit = tracer->first_hit(ray);
    ASSERT_TRUE(hit);
    EXPECT_NEAR(hit->distance, 53 - std::sqrt(25 - offset * offset), 1e-9);
    const Place place = tracer->place(ray, *hit);
    EXPECT_NEAR(norm(place.normal - 0.2 * (place.point - ball[0].centre)), 0, 1e-9);
    EXPECT_NEAR(tracer->curvature(place.point, *hit), 0.2, 1e-9);
  }
  EXPECT_FALSE(tracer->first_hit({{-50, 6.01, -2}, {1, 0, 0}}));
  EXPECT_TRUE(tracer->inside({3, 1, -2}));
  EXPECT_TRUE(tracer->inside({3, 5.99, -2}));
  EXPECT_FALSE(tracer->inside({3, 6.01, -2}));
}

TEST(Blobs, LieBetweenTheBallsAndTheGrownBalls) {
  const SphereModel model = random_balls(80, 2);
  const auto balls = tracer_of(model.spheres);
  for (const double blend : {1.0, 0.1, 1e-3, 1e-6}) {
    std::vector<Sphere> grown = model.spheres;
    for (Sphere& s : grown) s.radius = s.radius > 0 ? s.radius + blend : 0;
    const auto outer = tracer_of(grown), blobs = trace_blobs(model.spheres, blend, {});
    std::size_t met = 0;
    for (const Ray& ray : rays_at(14, 500)) {
      const auto hit = blobs->first_hit(ray), first = outer->first_hit(ray), last = balls->first_hit(ray);
      ASSERT_TRUE(hit || !last);
      if (!hit) continue;
      ++met;
      ASSERT_TRUE(first);
      ASSERT_GE(hit->distance, first->distance - 1e-9);
      ASSERT_TRUE(!last || hit->distance <= last->distance + 1e-9);
    }
    EXPECT_GT(met, 200U);
  }
}

// Steps that are lost in the distance already walked would never end.
TEST(Blobs, FromFarAwayAreTheSame) {
  const SphereModel model = random_balls(30, 2);
  const auto tracer = trace_blobs(model.spheres, 0.5, {});
  std::size_t met = 0;
  for (const Ray& ray : rays_at(12, 200))
    for (const double back : {3e5, 1e9, 1e12}) {
      const auto near = tracer->first_hit(ray);
      const auto far = tracer->first_hit({ray.origin - back * ray.direction, ray.direction});
      if (back > 1e6) continue;  // such a ray is a millimetre off
      ASSERT_EQ(near.has_value(), far.has_value());
      if (!near) continue;
      EXPECT_NEAR(far->distance - back, near->distance, 1e-6);
      ++met;
    }
  EXPECT_GT(met, 30U);
}

// Each step looks only at the fields that it passes: else the time would grow with the square of their number.
TEST(Blobs, InARowAreWalkedAlongInTheirNumber) {
  std::vector<Sphere> row;
  for (int i = 0; i < 20'000; ++i) row.push_back({{0.9 * i, 0, 0}, 1});
  const auto tracer = trace_blobs(row, 0.5, {});
  std::vector<Ray> rays;
  for (int i = 0; i < 16; ++i) rays.push_back({{-10, 1.28 + 0.005 * i, 0}, {1, 0, 0}});
  std::vector<Hit> hits(rays.size());
  const auto begin = std::clock();
  tracer->first_hits(rays, hits);
  EXPECT_LT(static_cast<double>(std::clock() - begin) / CLOCKS_PER_SEC, 2);
}

TEST(Blobs, BlendColours) {
  const std::vector<Sphere> balls{{{-1, 0, 0}, 1}, {{1, 0, 0}, 1}};
  const std::vector<Colour> table{{1, 0, 0}, {0, 0, 1}};
  const auto tracer = trace_blobs(balls, 0.8, {});
  const Ray middle{{0, -10, 0}, {0, 1, 0}}, left{{-1.5, -10, 0}, {0, 1, 0}};
  const auto at = [&](const Ray& ray) {
    const auto hit = tracer->first_hit(ray);
    return tracer->colour(tracer->place(ray, *hit).point, *hit, table);
  };
  EXPECT_NEAR(at(middle).x, 0.5, 1e-9);
  EXPECT_NEAR(at(middle).z, 0.5, 1e-9);
  EXPECT_GT(at(left).x, 0.9);
}

}  // namespace
}  // namespace spherule
