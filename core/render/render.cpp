// SPDX-License-Identifier: GPL-3.0-or-later
//
// Camera and shading. Every random-looking choice is a low-discrepancy sequence shifted by the pixel's coordinates
// (M. Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018), so a pixel's colour depends on nothing
// but the scene and the pixel.
#include "core/render/render.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/base/parallel.h"
#include "core/render/patches.h"
#include "core/render/trace.h"

namespace spherule {
namespace {

constexpr double kMargin = 0.04;  // of each side of the picture
constexpr int kTile = 32;         // pixels
constexpr int kMaxSamples = 64;   // camera rays a pixel
constexpr double kWellLit = 0.7;  // part of the sky rays that get through

// Linear light, red green blue.
using Colour = Vec3;

constexpr Colour operator*(Colour a, Colour b) { return {a.x * b.x, a.y * b.y, a.z * b.z}; }

// The look: bone-like material, a warm key light over the viewer's left shoulder, a cooler sky brighter above and
// behind the viewer than below.
constexpr Colour kMaterial{0.90, 0.71, 0.50};
constexpr Colour kKey{1.22, 1.16, 1.06};
constexpr double kKeyRadius = 0.10;  // tangent of the half angle under which the key light is seen
constexpr Colour kSkyAbove{0.27, 0.32, 0.40};
constexpr Colour kSkyBelow{0.20, 0.14, 0.10};
constexpr Colour kSkyBehindViewer{0.16, 0.16, 0.16};

// A point of the unit square: element `index` of the R2 sequence, shifted by the pixel.
struct Square {
  double u, v;
};
Square quasi_random(int x, int y, int index, int stream) {
  constexpr double kA = 0.75487766624669276, kB = 0.56984029099805327;  // 1/p and 1/p², p³ = p + 1
  const auto fraction = [](double t) { return t - std::floor(t); };
  const double shift = kA * x + kB * y;  // neighbours differ much, so errors look like fine grain
  const double i = index + 1;
  return {fraction(shift + i * kA + 0.31 * stream), fraction(fraction(shift * 3.7) + i * kB + 0.57 * stream)};
}

Vec3 on_unit_sphere(Square s) {
  const double z = 1 - 2 * s.u, radius = std::sqrt(std::max(0.0, 1 - z * z)), angle = 2 * std::numbers::pi * s.v;
  return {radius * std::cos(angle), radius * std::sin(angle), z};
}

// Proportional to the cosine with the normal: a point of the sphere that rests on the surface.
Vec3 sky_direction(Vec3 normal, Square s) {
  const Vec3 d = normal + on_unit_sphere(s);
  const double length = norm(d);
  return length > 1e-6 ? (1 / length) * d : normal;
}

struct Scene {
  const SphereModel& model;
  const Tracer& tracer;
  Camera camera;
  Vec3 key;           // towards the middle of the key light, of length 1
  double depth = 0;   // mm from the plane where camera rays start to the camera's centre
  double offset = 0;  // mm that secondary rays start off the surface

  // What an open sky sends to a surface: the mean of its brightness, which changes evenly from below to above and
  // towards the viewer, over the cosine lobe about the normal (whose mean direction is 2/3 of the normal).
  Colour open_sky(Vec3 normal) const {
    const double up = 0.5 + dot(normal, camera.up) / 3;
    const double front = 0.5 - dot(normal, camera.forward) / 3;
    return up * kSkyAbove + (1 - up) * kSkyBelow + front * kSkyBehindViewer;
  }

  // Where a camera ray meets the object, a hair above the surface.
  struct Place {
    Vec3 start, normal;
  };

  bool sees_sky(const Place& place, Square s) const {
    return !tracer.blocked({place.start, sky_direction(place.normal, s)});
  }

  // The key light at a place: one shadow ray to a point of the lamp.
  Colour key_light(const Place& place, Square s) const {
    const Vec3 towards = normalised(key + kKeyRadius * on_unit_sphere(s));
    const double cosine = dot(place.normal, towards);
    return cosine > 0 && !tracer.blocked({place.start, towards}) ? cosine * kKey : Colour{};
  }

  // The mean colour of the pixel's rays that meet the object, and the part of them that does.
  std::pair<Colour, double> pixel(int x, int y, const RenderOptions& options) const {
    const int n = options.samples_per_axis;
    std::array<Place, kMaxSamples> places;
    int hits = 0;
    for (int sample = 0; sample < n * n; ++sample) {
      const int column = sample % n, row = sample / n;
      const double px = x + (column + 0.5) / n - 0.5 * options.width;
      const double py = y + (row + 0.5) / n - 0.5 * options.height;
      const Ray ray{camera.centre + camera.mm_per_pixel * (px * camera.right - py * camera.up) - depth * camera.forward,
                    camera.forward};
      const auto hit = tracer.first_hit(ray);
      if (!hit) continue;
      const Vec3 point = ray.origin + hit->distance * ray.direction;
      const Vec3 normal = normalised(point - model.spheres[hit->ball].centre);
      places[static_cast<std::size_t>(hits++)] = {point + offset * normal, normal};
    }
    if (hits == 0) return {{}, 0};

    Colour key_sum, sky_sum;
    int rays = 0, open = 0;
    const auto look_up = [&] {
      for (int i = 0; i < hits; ++i)
        open += sees_sky(places[static_cast<std::size_t>(i)], quasi_random(x, y, rays++, 0));
    };
    look_up();
    // In half shade the few rays of one round would leave visible grain.
    if (open > 0 && open < kWellLit * hits) look_up(), look_up();
    for (int i = 0; i < hits; ++i) {
      const Place& place = places[static_cast<std::size_t>(i)];
      key_sum = key_sum + key_light(place, quasi_random(x, y, i, 1));
      sky_sum = sky_sum + open_sky(place.normal);
    }
    const Colour light = key_sum + (static_cast<double>(open) / rays) * sky_sum;
    return {(1.0 / hits) * (kMaterial * light), static_cast<double>(hits) / (n * n)};
  }
};

// A gentle shoulder, so that bright places keep their shape instead of burning out.
double tone(double linear) { return 1 - std::exp(-1.25 * linear); }

std::uint8_t to_srgb(double linear) {
  const double c = std::clamp(linear, 0.0, 1.0);
  const double encoded = c <= 0.0031308 ? 12.92 * c : 1.055 * std::pow(c, 1 / 2.4) - 0.055;
  return static_cast<std::uint8_t>(std::lround(255 * encoded));
}

void put_pixel(std::uint8_t* rgba, Colour colour, double coverage, Background background) {
  Colour c{tone(colour.x), tone(colour.y), tone(colour.z)};
  if (background != Background::transparent) {
    const double behind = background == Background::white ? 1.0 : 0.012;
    c = coverage * c + (1 - coverage) * Colour{behind, behind, behind};
    coverage = 1;
  }
  for (int a = 0; a < 3; ++a) rgba[a] = coverage > 0 ? to_srgb(c[a]) : std::uint8_t{0};
  rgba[3] = static_cast<std::uint8_t>(std::lround(255 * coverage));
}

void check(const RenderOptions& options) {
  std::vector<FieldError> fields;
  if (options.width < 1 || options.width > 8192) fields.push_back({"width", "must be within 1 and 8192 pixels"});
  if (options.height < 1 || options.height > 8192) fields.push_back({"height", "must be within 1 and 8192 pixels"});
  if (options.samples_per_axis < 1 || options.samples_per_axis > 8)
    fields.push_back({"samples_per_axis", "must be within 1 and 8"});
  if (!fields.empty())
    throw Error(ErrorCode::invalid_argument,
                "The picture's " + fields.front().pointer + ' ' + fields.front().detail + '.', fields);
}

}  // namespace

Camera fit_camera(const Box& box, const RenderOptions& options) {
  Camera camera;
  switch (options.view) {
    case View::anterior: camera.forward = {0, 1, 0}, camera.up = {0, 0, 1}; break;
    case View::posterior: camera.forward = {0, -1, 0}, camera.up = {0, 0, 1}; break;
    case View::right: camera.forward = {1, 0, 0}, camera.up = {0, 0, 1}; break;
    case View::left: camera.forward = {-1, 0, 0}, camera.up = {0, 0, 1}; break;
    case View::head: camera.forward = {0, 0, -1}, camera.up = {0, -1, 0}; break;
    case View::foot: camera.forward = {0, 0, 1}, camera.up = {0, -1, 0}; break;
  }
  camera.right = cross(camera.forward, camera.up);
  camera.centre = 0.5 * (box.min + box.max);
  const Vec3 extent = box.max - box.min;
  const double usable = 1 - 2 * kMargin;
  camera.mm_per_pixel = std::max(std::abs(dot(extent, camera.right)) / (usable * options.width),
                                 std::abs(dot(extent, camera.up)) / (usable * options.height));
  return camera;
}

Image render_spheres(const SphereModel& model, const RenderOptions& options, const Context& context) {
  check(options);
  Box box;
  for (const Sphere& s : model.spheres)
    if (s.radius > 0) box.include(s);
  if (box.empty())
    throw Error(ErrorCode::unusable, "The model has no sphere with a radius above 0, so there is nothing to draw.");

  const std::vector<Patch> patches = visible_patches(model, context);
  const Tracer tracer(model.spheres, patches, context);
  Scene scene{model, tracer, fit_camera(box, options), {}, 0, 0};
  scene.key = normalised(-0.60 * scene.camera.right + 0.70 * scene.camera.up - 0.62 * scene.camera.forward);
  const Vec3 extent = box.max - box.min;
  scene.depth = norm(extent);
  scene.offset = 1e-7 * norm(extent);

  Image image{options.width, options.height, {}};
  image.rgba.resize(4 * static_cast<std::size_t>(options.width) * static_cast<std::size_t>(options.height));
  const int across = (options.width + kTile - 1) / kTile, down = (options.height + kTile - 1) / kTile;
  parallel_for(context, "render", static_cast<std::size_t>(across) * static_cast<std::size_t>(down), 1,
               [&](std::size_t tile, std::size_t) {
                 const int left = static_cast<int>(tile) % across * kTile;
                 const int top = static_cast<int>(tile) / across * kTile;
                 for (int y = top; y < std::min(top + kTile, options.height); ++y) {
                   context.throw_if_cancelled();
                   for (int x = left; x < std::min(left + kTile, options.width); ++x) {
                     const auto [colour, coverage] = scene.pixel(x, y, options);
                     put_pixel(&image.rgba[4 * (static_cast<std::size_t>(y) * static_cast<std::size_t>(options.width) +
                                                static_cast<std::size_t>(x))],
                               colour, coverage, options.background);
                   }
                 }
               });
  return image;
}

}  // namespace spherule
