// SPDX-License-Identifier: GPL-3.0-or-later
//
// Light and pixels. Every random-looking choice is a low-discrepancy sequence shifted by the pixel's coordinates
// (M. Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018), so a pixel's colour depends on nothing
// but the scene and the pixel.
#include "core/render/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>

#include "core/base/parallel.h"

namespace spherule {
namespace {

constexpr int kTile = 64;    // pixels
constexpr int kReach = 3;    // pixels over which sky light is smoothed
constexpr int kSkyRays = 4;  // of a pixel
constexpr double kCosine =
    0.992;  // of the angle between neighbouring normals from which on a pixel is looked at closely

// The look: a warm key light over the viewer's left shoulder, a cooler sky brighter above and behind the viewer than
// below.
constexpr Colour kKey{1.22, 1.16, 1.06};
constexpr double kKeyRadius = 0.10;  // tangent of the half angle under which the key light is seen
constexpr Colour kSkyAbove{0.27, 0.32, 0.40};
constexpr Colour kSkyBelow{0.20, 0.14, 0.10};
constexpr Colour kSkyBehindViewer{0.16, 0.16, 0.16};

Vec3 towards_key(const Camera& camera) {
  return normalised(-0.60 * camera.right + 0.70 * camera.up - 0.62 * camera.forward);
}

// The grey of an opaque background, in a row of a picture.
double behind(Background background, int y, int height) {
  if (background == Background::white) return 1;
  if (background == Background::dark) return 0.012;
  return 0.35 + 0.45 * (y + 0.5) / height;
}

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

// Mean over the lamp of the cosine with the normal, where that is positive, from the one at the lamp's centre: the
// height of points of a sphere over a plane is uniform (Archimedes). Shaded with each ray's own cosine, smooth bodies
// would show the pattern of the rays.
double mean_cosine(double centre) {
  if (centre >= kKeyRadius) return centre;
  if (centre <= -kKeyRadius) return 0;
  return (centre + kKeyRadius) * (centre + kKeyRadius) / (4 * kKeyRadius);
}

// Proportional to the cosine with the normal: a point of the sphere that rests on the surface.
Vec3 sky_direction(Vec3 normal, Square s) {
  const Vec3 d = normal + on_unit_sphere(s);
  const double length = norm(d);
  return length > 1e-6 ? (1 / length) * d : normal;
}

// Where a sight line meets a body.
struct Sight {
  Place place;
  Colour base;        // what part of the light it reflects
  double depth = -1;  // mm along the line; negative: nothing was met
  bool cut = false;   // on the clipping plane
  bool met() const { return depth >= 0; }
};

// Of each body, of each of a list of places.
using Sights = std::vector<std::vector<Sight>>;

// What one body sends to one pixel.
struct Share {
  double weight = 0;  // part of the pixel's light that it decides
  Colour key, sky;    // light sent on; sky is still to be dimmed by what hides it
  void add(double w, const Sight& sight, Colour key_light, Colour open_sky) {
    weight += w;
    key = key + w * mixed(sight.base, key_light);
    sky = sky + w * mixed(sight.base, open_sky);
  }
};

// One tile with its surroundings, while it is drawn.
class Tile {
 public:
  Tile(const Scene& scene, const Camera& camera, const Exposure& exposure, const std::vector<std::uint8_t>& closely,
       const Context& context, int left, int top)
      : scene_(scene),
        camera_(camera),
        exposure_(exposure),
        closely_(closely),
        context_(context),
        lamp_(towards_key(camera)),
        left_(left),
        top_(top),
        right_(std::min(left + kTile, exposure.width)),
        bottom_(std::min(top + kTile, exposure.height)),
        x0_(std::max(0, left - margin())),
        y0_(std::max(0, top - margin())),
        x1_(std::min(right_ + margin(), exposure.width)),
        y1_(std::min(bottom_ + margin(), exposure.height)) {}

  void draw(Image& image) {
    look();
    if (closely_.empty() &&
        std::ranges::none_of(centre_, [](const auto& sights) { return std::ranges::any_of(sights, &Sight::met); })) {
      for (int y = top_; y < bottom_; ++y)
        for (int x = left_; x < right_; ++x) write(image.at(x, y), {}, 0, y);
      return;
    }
    light_keys();
    find_busy();
    light_sky();
    for (int y = top_; y < bottom_; ++y) {
      context_.throw_if_cancelled();
      draw_row(image, y);
    }
  }

 private:
  // Pixels around the tile whose sights matter to it.
  int margin() const { return scene_.ambient_occlusion ? kReach + 1 : 1; }
  std::size_t at(int x, int y) const {
    return static_cast<std::size_t>(y - y0_) * static_cast<std::size_t>(x1_ - x0_) + static_cast<std::size_t>(x - x0_);
  }
  std::size_t area() const { return static_cast<std::size_t>(x1_ - x0_) * static_cast<std::size_t>(y1_ - y0_); }

  // The part of a sight line that is in the clipping half-space.
  struct SightLine {
    Ray ray;
    bool whole = true;  // starts at the viewer, not on the clipping plane
  };
  SightLine sight_line(double x, double y) const {
    const auto [origin, direction] = camera_.line_of_sight(x - 0.5 * exposure_.width, y - 0.5 * exposure_.height);
    SightLine line{{origin, direction}};
    if (!scene_.clip) return line;
    const double height = dot(scene_.clip->normal, origin) - scene_.clip->offset;
    const double slope = dot(scene_.clip->normal, direction);
    if (height > 0 && slope < 0) {
      line.ray.origin = origin - height / slope * direction;
      line.whole = false;
    } else if (height > 0) {
      line.ray.far = -1;
    } else if (slope > 0) {
      line.ray.far = -height / slope;
    }
    return line;
  }

  static Colour base_colour(const Body& body, Vec3 point, const Hit& hit) {
    if (body.curvature_map != nullptr) {
      const auto [lo, hi] = body.curvature_range;
      return body.curvature_map->at((body.tracer->curvature(point, hit) - lo) / (hi - lo));
    }
    return body.table.empty() ? body.material : body.tracer->colour(point, hit, body.table);
  }

  // Where the sight lines of these places of the picture meet each body.
  Sights see(std::span<const std::array<double, 2>> places) const {
    std::vector<Ray> rays;
    std::vector<std::uint8_t> whole;
    rays.reserve(places.size());
    for (const auto& [x, y] : places) {
      const SightLine line = sight_line(x, y);
      rays.push_back(line.ray);
      whole.push_back(line.whole);
    }
    Sights sights(scene_.bodies.size(), std::vector<Sight>(places.size()));
    std::vector<Hit> hits(places.size());
    for (std::size_t b = 0; b < sights.size(); ++b) {
      const Body& body = scene_.bodies[b];
      body.tracer->first_hits(rays, hits);
      for (std::size_t i = 0; i < rays.size(); ++i) {
        Sight& sight = sights[b][i];
        if (!whole[i] && body.tracer->inside(rays[i].origin)) {
          sight = {{rays[i].origin, scene_.clip->normal, rays[i].origin}, body.material, 0, true};
        } else if (hits[i]) {
          sight.place = body.tracer->place(rays[i], hits[i]);
          sight.base = base_colour(body, sight.place.point, hits[i]);
          sight.depth = hits[i].distance;
        }
      }
    }
    return sights;
  }

  Ray from(const Place& place, Vec3 direction) const {
    Ray ray{place.start, direction};
    if (!scene_.clip) return ray;
    const double slope = dot(scene_.clip->normal, direction);
    if (slope > 0) ray.far = std::max(0.0, (scene_.clip->offset - dot(scene_.clip->normal, ray.origin)) / slope);
    return ray;
  }

  // The part of the light along each ray that gets through the bodies.
  std::vector<double> passing(std::span<const Ray> rays, bool alike) const {
    std::vector<double> open(rays.size(), 1);
    std::vector<std::uint8_t> blocked(rays.size());
    for (const Body& body : scene_.bodies) {
      body.tracer->blocked(rays, blocked, alike);
      for (std::size_t i = 0; i < rays.size(); ++i)
        if (blocked[i] != 0) open[i] *= 1 - body.opacity;
    }
    return open;
  }

  // One shadow ray to a point of the lamp for each sight, where it faces the lamp.
  struct Asked {
    int x, y, index;
    const Sight* sight;
  };
  std::vector<Colour> key_light_on(std::span<const Asked> asked) const {
    std::vector<Colour> light(asked.size());
    std::vector<Ray> rays;
    std::vector<std::size_t> of;
    for (std::size_t i = 0; i < asked.size(); ++i) {
      const auto& [x, y, index, sight] = asked[i];
      if (!scene_.shadows || sight->cut) {
        light[i] = std::max(0.0, dot(sight->place.normal, lamp_)) * kKey;
        continue;
      }
      const double cosine = mean_cosine(dot(sight->place.normal, lamp_));
      if (cosine <= 0) continue;
      light[i] = cosine * kKey;
      Vec3 towards = normalised(lamp_ + kKeyRadius * on_unit_sphere(quasi_random(x, y, index, 1)));
      // Only the part of the lamp that the place faces can be hidden by others.
      const double height = dot(sight->place.normal, towards);
      if (height < 0) towards = towards - 2 * height * sight->place.normal;
      rays.push_back(from(sight->place, towards));
      of.push_back(i);
    }
    const std::vector<double> open = passing(rays, true);
    for (std::size_t r = 0; r < rays.size(); ++r) light[of[r]] = open[r] * light[of[r]];
    return light;
  }

  void look() {
    std::vector<std::array<double, 2>> places;
    places.reserve(area());
    for (int y = y0_; y < y1_; ++y)
      for (int x = x0_; x < x1_; ++x) places.push_back({x + 0.5, y + 0.5});
    centre_ = see(places);
    context_.throw_if_cancelled();
  }

  void light_keys() {
    keys_.resize(scene_.bodies.size());
    for (std::size_t b = 0; b < centre_.size(); ++b) {
      std::vector<Asked> asked;
      for (int y = y0_; y < y1_; ++y)
        for (int x = x0_; x < x1_; ++x)
          if (const Sight& sight = centre_[b][at(x, y)]; sight.met()) asked.push_back({x, y, 0, &sight});
      const auto light = key_light_on(asked);
      keys_[b].assign(area(), {});
      for (std::size_t i = 0; i < asked.size(); ++i) keys_[b][at(asked[i].x, asked[i].y)] = light[i];
    }
    context_.throw_if_cancelled();
  }

  bool differ(std::size_t b, std::size_t p, std::size_t q) const {
    const Sight &s = centre_[b][p], &t = centre_[b][q];
    if (s.met() != t.met()) return true;
    if (!s.met()) return false;
    if (s.cut != t.cut || dot(s.place.normal, t.place.normal) < kCosine) return true;
    if (squared_norm(s.base - t.base) > 4e-4) return true;
    if ((squared_norm(keys_[b][p]) > 0) != (squared_norm(keys_[b][q]) > 0)) return true;
    return std::abs(dot(s.place.normal, t.place.point - s.place.point)) > camera_.mm_per_pixel;
  }

  // Pixels that differ from a neighbour are looked at closely.
  void find_busy() {
    busy_.assign(area(), 0);
    if (exposure_.samples_per_axis == 1) return;  // the centre is all there is to see
    for (int y = y0_; y < y1_; ++y)
      for (int x = x0_; x < x1_; ++x) {
        const std::size_t p = at(x, y);
        if (!closely_.empty() && closely_[static_cast<std::size_t>(y) * static_cast<std::size_t>(exposure_.width) +
                                          static_cast<std::size_t>(x)] != 0)
          busy_[p] = 1;
        for (const auto& [dx, dy] : {std::pair{1, 0}, {0, 1}, {1, 1}, {-1, 1}}) {
          if (x + dx < x0_ || x + dx >= x1_ || y + dy >= y1_) continue;
          const std::size_t q = at(x + dx, y + dy);
          for (std::size_t b = 0; b < centre_.size(); ++b)
            if (differ(b, p, q)) busy_[p] = busy_[q] = 1;
        }
      }
  }

  // The part of the sky that each pixel's place sees, by a few rays; smoothing comes later.
  void light_sky() {
    open_.resize(centre_.size());
    if (!scene_.ambient_occlusion) return;
    for (std::size_t b = 0; b < centre_.size(); ++b) {
      open_[b].assign(area(), 1);
      std::vector<Ray> rays;
      for (int y = y0_; y < y1_; ++y) {
        rays.clear();
        for (int x = x0_; x < x1_; ++x) {
          const Sight& sight = centre_[b][at(x, y)];
          if (!sight.met() || sight.cut) continue;
          for (int i = 0; i < kSkyRays; ++i)
            rays.push_back(from(sight.place, sky_direction(sight.place.normal, quasi_random(x, y, i, 0))));
        }
        const std::vector<double> open = passing(rays, false);
        std::size_t next = 0;
        for (int x = x0_; x < x1_; ++x) {
          const Sight& sight = centre_[b][at(x, y)];
          if (!sight.met() || sight.cut) continue;
          double sum = 0;
          for (int i = 0; i < kSkyRays; ++i) sum += open[next++];
          open_[b][at(x, y)] = sum / kSkyRays;
        }
        context_.throw_if_cancelled();
      }
    }
  }

  // The sky that a place near pixel (x, y) sees: of the neighbours on the same smooth surface.
  double open_sky(std::size_t b, int x, int y, const Sight& sight) const {
    if (!scene_.ambient_occlusion || sight.cut) return 1;
    double sum = 0, weights = 0;
    for (int v = std::max(y0_, y - kReach); v <= std::min(y1_ - 1, y + kReach); ++v)
      for (int u = std::max(x0_, x - kReach); u <= std::min(x1_ - 1, x + kReach); ++u) {
        const Sight& other = centre_[b][at(u, v)];
        if (!other.met() || other.cut) continue;
        const double alike = dot(sight.place.normal, other.place.normal);
        if (alike <= 0) continue;
        const double off = dot(sight.place.normal, other.place.point - sight.place.point) / camera_.mm_per_pixel;
        const double alike2 = alike * alike, alike4 = alike2 * alike2;
        const double near = (u - x) * (u - x) + (v - y) * (v - y);
        const double weight = alike4 * alike4 / ((1 + off * off) * (1 + off * off) * (1 + 0.12 * near)) + 1e-9;
        sum += weight * open_[b][at(u, v)];
        weights += weight;
      }
    return weights > 0 ? sum / weights : 1;
  }

  // What is seen in a row of pixels: n × n sights of each busy one, the centre's of others.
  void draw_row(Image& image, int y) const {
    const int n = exposure_.samples_per_axis;
    std::vector<std::array<double, 2>> places;
    for (int x = left_; x < right_; ++x)
      if (busy_[at(x, y)] != 0)
        for (int row = 0; row < n; ++row)
          for (int column = 0; column < n; ++column) places.push_back({x + (column + 0.5) / n, y + (row + 0.5) / n});
    const Sights closer = places.empty() ? Sights(centre_.size()) : see(places);
    std::vector<std::vector<Colour>> keys(closer.size(), std::vector<Colour>(places.size()));
    for (std::size_t b = 0; b < closer.size(); ++b) {
      std::vector<Asked> asked;
      std::vector<std::size_t> of;
      for (std::size_t i = 0; i < places.size(); ++i) {
        if (!closer[b][i].met()) continue;
        asked.push_back({static_cast<int>(places[i][0]), y, static_cast<int>(i) % (n * n), &closer[b][i]});
        of.push_back(i);
      }
      const auto light = key_light_on(asked);
      for (std::size_t i = 0; i < of.size(); ++i) keys[b][of[i]] = light[i];
    }
    std::size_t next = 0;
    for (int x = left_; x < right_; ++x) {
      const std::size_t p = at(x, y);
      if (busy_[p] != 0) {
        put(image, x, y, closer, keys, next, static_cast<std::size_t>(n * n));
        next += static_cast<std::size_t>(n * n);
      } else {
        put(image, x, y, centre_, keys_, p, 1);
      }
    }
  }

  // A pixel from sights [first, first + count).
  void put(Image& image, int x, int y, const Sights& sights, const std::vector<std::vector<Colour>>& keys,
           std::size_t first, std::size_t count) const {
    const std::size_t bodies = scene_.bodies.size();
    std::array<Share, Scene::most_bodies> shares;
    std::array<std::size_t, Scene::most_bodies> order;
    for (std::size_t s = first; s < first + count; ++s) {
      std::size_t met = 0;
      for (std::size_t b = 0; b < bodies; ++b)
        if (sights[b][s].met()) order[met++] = b;
      if (met == 2 && sights[1][s].depth < sights[0][s].depth) order = {1, 0};
      double left = 1.0 / static_cast<double>(count);
      for (std::size_t i = 0; i < met; ++i) {
        const std::size_t b = order[i];
        const double weight = left * scene_.bodies[b].opacity;
        left -= weight;
        shares[b].add(weight, sights[b][s], keys[b][s], sky_light(camera_, sights[b][s].place.normal));
      }
    }
    Colour light;
    double coverage = 0;
    for (std::size_t b = 0; b < bodies; ++b) {
      if (!(shares[b].weight > 0)) continue;
      const Sight* typical = &centre_[b][at(x, y)];
      for (std::size_t s = first; !typical->met(); ++s) typical = &sights[b][s];
      light = light + shares[b].key + open_sky(b, x, y, *typical) * shares[b].sky;
      coverage += shares[b].weight;
    }
    write(image.at(x, y), light, coverage, y);
  }

  void write(std::uint8_t* rgba, Colour light, double coverage, int y) const {
    if (exposure_.background == Background::transparent && coverage <= 0) {
      std::fill_n(rgba, 4, std::uint8_t{0});
      return;
    }
    Colour c = coverage > 0 ? tone(1 / coverage * light) : Colour{};
    if (exposure_.background != Background::transparent) {
      const double ground = behind(exposure_.background, y, exposure_.height);
      c = coverage * c + (1 - coverage) * Colour{ground, ground, ground};
      coverage = 1;
    }
    for (int a = 0; a < 3; ++a) rgba[a] = to_srgb(c[a]);
    rgba[3] = static_cast<std::uint8_t>(std::lround(255 * std::min(1.0, coverage)));
  }

  const Scene& scene_;
  const Camera& camera_;
  const Exposure& exposure_;
  const std::vector<std::uint8_t>& closely_;
  const Context& context_;
  Vec3 lamp_;
  int left_, top_, right_, bottom_;  // the tile's pixels
  int x0_, y0_, x1_, y1_;            // with its surroundings
  Sights centre_;                    // of each body, each pixel
  std::vector<std::vector<Colour>> keys_;
  std::vector<std::vector<double>> open_;
  std::vector<std::uint8_t> busy_;
};

// One flag a pixel: something small may be seen in it, or in a pixel beside it.
std::vector<std::uint8_t> pixels_with_specks(const Scene& scene, const Camera& camera, const Exposure& exposure) {
  std::vector<std::uint8_t> flags;
  for (const Sphere& s : scene.specks) {
    const Vec3 seen = camera.seen_at(s.centre);
    if (!(seen.z > 0)) continue;
    const double scale = camera.projection == Projection::orthographic ? camera.mm_per_pixel
                                                                       : camera.mm_per_pixel * seen.z / camera.distance;
    if (s.radius > 1.5 * scale) continue;
    const double x = std::floor(seen.x + 0.5 * exposure.width), y = std::floor(seen.y + 0.5 * exposure.height);
    if (!(x > -2 && y > -2 && x < exposure.width + 1 && y < exposure.height + 1)) continue;
    if (flags.empty())
      flags.resize(static_cast<std::size_t>(exposure.width) * static_cast<std::size_t>(exposure.height));
    for (int v = std::max(0, static_cast<int>(y) - 1); v <= std::min(exposure.height - 1, static_cast<int>(y) + 1); ++v)
      for (int u = std::max(0, static_cast<int>(x) - 1); u <= std::min(exposure.width - 1, static_cast<int>(x) + 1);
           ++u)
        flags[static_cast<std::size_t>(v) * static_cast<std::size_t>(exposure.width) + static_cast<std::size_t>(u)] = 1;
  }
  return flags;
}

}  // namespace

Colour key_light(const Camera& camera, Vec3 normal) { return std::max(0.0, dot(normal, towards_key(camera))) * kKey; }

// The mean of the sky's brightness, which changes evenly from below to above and towards the viewer, over the cosine
// lobe about the normal (whose mean direction is 2/3 of the normal).
Colour sky_light(const Camera& camera, Vec3 normal) {
  const double up = 0.5 + dot(normal, camera.up) / 3;
  const double front = 0.5 - dot(normal, camera.forward) / 3;
  return up * kSkyAbove + (1 - up) * kSkyBelow + front * kSkyBehindViewer;
}

Colour tone(Colour light) {
  const auto shoulder = [](double linear) { return 1 - std::exp(-1.25 * linear); };
  return {shoulder(light.x), shoulder(light.y), shoulder(light.z)};
}

Image backdrop(int width, int height, Background background) {
  Image image = blank_image(width, height);
  if (background == Background::transparent) return image;
  for (int y = 0; y < height; ++y)
    for (int x = 0; x < width; ++x) {
      std::fill_n(image.at(x, y), 3, to_srgb(behind(background, y, height)));
      image.at(x, y)[3] = 255;
    }
  return image;
}

Image shoot(const Scene& scene, const Camera& camera, const Exposure& exposure, std::string_view stage,
            const Context& context) {
  Image image = blank_image(exposure.width, exposure.height);
  const std::vector<std::uint8_t> closely = pixels_with_specks(scene, camera, exposure);
  const int across = (exposure.width + kTile - 1) / kTile, down = (exposure.height + kTile - 1) / kTile;
  parallel_for(context, stage, static_cast<std::size_t>(across) * static_cast<std::size_t>(down), 1,
               [&](std::size_t tile, std::size_t) {
                 const int left = static_cast<int>(tile) % across * kTile,
                           top = static_cast<int>(tile) / across * kTile;
                 Tile(scene, camera, exposure, closely, context, left, top).draw(image);
               });
  return image;
}

}  // namespace spherule
