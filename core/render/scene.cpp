// SPDX-License-Identifier: GPL-3.0-or-later
//
// Light and pixels. Every random-looking choice is a point of a low-discrepancy sequence that the pixel's coordinates
// choose (M. Roberts, The Unreasonable Effectiveness of Quasirandom Sequences, 2018), so a pixel's colour depends on
// nothing but the scene and the pixel.
#include "core/render/scene.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <cstring>
#include <limits>
#include <memory>
#include <mutex>
#include <numbers>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/render/openness.h"

namespace spherule {
namespace {

constexpr int kTile = 64;    // pixels
constexpr int kBlock = 4;    // pixels; sight lines of a block are traced together
constexpr int kSkyRays = 4;  // of a pixel
// Pixels that differ by more from the mean of their two neighbours along a row, a column or a diagonal (twice the
// difference, in bytes, summed over the channels) are looked at closely: at an edge of 0.1 of a channel's range, the
// threshold that POV-Ray uses for differences, but not where shades change evenly.
constexpr int kVisible = 25;
constexpr double kAlike = 0.97;  // cosine between normals of places that see as much of the lamp and the sky

// The look: a warm key light over the viewer's left shoulder, a cooler sky brighter above and behind the viewer than
// below.
constexpr Colour kKey{1.22, 1.16, 1.06};
constexpr double kKeyRadius = 0.10;  // tangent of the half angle under which the key light is seen
constexpr Colour kSkyAbove{0.27, 0.32, 0.40};
constexpr Colour kSkyBelow{0.20, 0.14, 0.10};
constexpr Colour kSkyBehindViewer{0.16, 0.16, 0.16};

constexpr double kExposure = 1.25;

Vec3 towards_key(const Camera& camera) {
  return normalised(-0.60 * camera.right + 0.70 * camera.up - 0.62 * camera.forward);
}

// The grey of an opaque background, in a row of a picture.
double behind(Background background, int y, int height) {
  if (background == Background::white) return 1;
  if (background == Background::dark) return 0.012;
  return 0.35 + 0.45 * (y + 0.5) / height;
}

// The R2 sequence: element n is (n/p, n/p²) without the whole parts, p³ = p + 1.
constexpr double kA = 0.75487766624669276, kB = 0.56984029099805327;

// Where in a sequence a pixel begins; neighbours are far from each other, so errors look like fine grain.
constexpr std::uint32_t kGrains = 256;
std::uint32_t grain(int x, int y) {
  return (static_cast<std::uint32_t>(x) * 0xC13FA9A9U + static_cast<std::uint32_t>(y) * 0x91E10DA5U) >> 24;  // kA, kB
}

// Points evenly spread over the unit sphere: `each` for every grain.
std::vector<Vec3> sphere_points(std::uint32_t each) {
  std::vector<Vec3> points;
  points.reserve(kGrains * each);
  for (std::uint32_t i = 0; i < kGrains * each; ++i) {
    const double u = kA * (i + 0.5), v = kB * (i + 0.5);
    const double z = 1 - 2 * (u - std::floor(u)), radius = std::sqrt(std::max(0.0, 1 - z * z));
    const double angle = 2 * std::numbers::pi * v;
    points.push_back({radius * elementary::cos(angle), radius * elementary::sin(angle), z});
  }
  return points;
}

// Mean over the lamp of the cosine with the normal, where that is positive, from the one at the lamp's centre: the
// height of points of a sphere over a plane is uniform (Archimedes). Shaded with each ray's own cosine, smooth bodies
// would show the pattern of the rays.
double mean_cosine(double centre) {
  if (centre >= kKeyRadius) return centre;
  if (centre <= -kKeyRadius) return 0;
  return (centre + kKeyRadius) * (centre + kKeyRadius) / (4 * kKeyRadius);
}

// Proportional to the cosine with the normal, for an even point of the unit sphere: that of the sphere that rests on
// the surface.
Vec3 sky_direction(Vec3 normal, Vec3 point) {
  const Vec3 d = normal + point;
  const double length = norm(d);
  return length > 1e-6 ? (1 / length) * d : normal;
}

// From light to what is shown of it.
const ByteCurve& exposure_curve() {
  static const ByteCurve curve([](double shown) { return -elementary::log(1 - shown) / kExposure; });
  return curve;
}

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

// What all tiles of a picture share.
struct Studio {
  const Scene& scene;
  const Camera& camera;
  const Exposure& exposure;
  const Context& context;
  Vec3 lamp = towards_key(camera);  // its middle
  std::uint32_t samples =           // of a pixel that is looked at closely
      static_cast<std::uint32_t>(exposure.samples_per_axis * exposure.samples_per_axis);
  std::vector<Vec3> to_lamp{};                      // directions to points of the lamp, one for every grain
  std::vector<Vec3> sky = sphere_points(kSkyRays);  // kSkyRays for every grain
  std::vector<std::uint8_t> closely = pixels_with_specks(scene, camera, exposure);  // or empty: none
  const ByteCurve& exposed = exposure_curve();
  double box_left = 0, box_top = 0, box_right = 0, box_bottom = 0;  // pixels beyond show nothing
  Vec3 middle{};                                                    // of a ball that holds all bodies, LPS mm
  double reach = 0;                                                 // its radius
};

// A place of the picture, in pixels from its upper left corner.
struct Spot {
  double x, y;
};

// Where a sight line meets a body.
struct Sight {
  Place place;
  Colour base;             // what part of the light it reflects
  double depth = 0;        // mm along the line, from where its ray starts
  std::uint32_t spot = 0;  // whose line it is
  bool cut = false;        // on the clipping plane
};

// What a list of sight lines meets of one body.
struct Sights {
  std::vector<Sight> met;
  std::vector<std::int32_t> of_spot;  // index into met; negative: nothing is met
  const Sight* at(std::size_t spot) const {
    return of_spot[spot] < 0 ? nullptr : &met[static_cast<std::size_t>(of_spot[spot])];
  }
};
using Views = std::array<Sights, Scene::most_bodies>;

// What a pixel sends.
struct Sum {
  Colour light;
  double coverage = 0;
};

// Draws tiles, one at a time; keeps its memory from tile to tile.
class Tile {
 public:
  explicit Tile(const Studio& studio)
      : studio_(studio), scene_(studio.scene), camera_(studio.camera), exposure_(studio.exposure) {}

  void draw(int left, int top, Image& image) {
    left_ = left, top_ = top;
    right_ = std::min(left + kTile, exposure_.width), bottom_ = std::min(top + kTile, exposure_.height);
    x0_ = std::max(0, left - margin()), y0_ = std::max(0, top - margin());
    x1_ = std::min(right_ + margin(), exposure_.width), y1_ = std::min(bottom_ + margin(), exposure_.height);
    if (!may_show()) return leave(image);
    look();
    if (studio_.closely.empty() && std::ranges::all_of(centre_, [](const Sights& s) { return s.met.empty(); }))
      return leave(image);
    find_openness();
    develop();
    find_busy();
    for (int y = top_; y < bottom_; ++y) std::copy_n(shown(left_, y), 4 * (right_ - left_), image.at(left_, y));
    look_closely(image);
  }

 private:
  // Pixels around the tile that matter to it.
  int margin() const {
    return (scene_.shadows || scene_.ambient_occlusion ? OpennessMap::reach : 0) + (studio_.samples > 1 ? 1 : 0);
  }
  std::size_t at(int x, int y) const {
    return static_cast<std::size_t>(y - y0_) * static_cast<std::size_t>(x1_ - x0_) + static_cast<std::size_t>(x - x0_);
  }
  std::size_t area() const { return static_cast<std::size_t>(x1_ - x0_) * static_cast<std::size_t>(y1_ - y0_); }
  std::uint8_t* shown(int x, int y) { return &shown_[4 * at(x, y)]; }
  const std::uint8_t* shown(int x, int y) const { return &shown_[4 * at(x, y)]; }

  bool may_show() const {
    return right_ > studio_.box_left && left_ < studio_.box_right && bottom_ > studio_.box_top &&
           top_ < studio_.box_bottom;
  }
  void leave(Image& image) const {
    for (int y = top_; y < bottom_; ++y)
      for (int x = left_; x < right_; ++x) std::ranges::copy(ground(y), image.at(x, y));
  }

  // The part of a sight line that is near the bodies and in the clipping half-space.
  struct SightLine {
    Ray ray;
    bool whole = true;  // does not start on the clipping plane
  };
  // Rays start at the edge of a ball around the bodies, however far the viewer is: whoever walks along them has numbers
  // of the bodies' own size, in which small steps are not lost.
  SightLine sight_line(const Spot& spot) const {
    const auto [origin, direction] =
        camera_.line_of_sight(spot.x - 0.5 * exposure_.width, spot.y - 0.5 * exposure_.height);
    const Vec3 v = origin - studio_.middle;
    const double nearest = -dot(v, direction);
    const double squared = studio_.reach * studio_.reach - squared_norm(v + nearest * direction);
    const double half = std::sqrt(std::max(0.0, squared));
    double begin = std::max(0.0, nearest - half), end = squared >= 0 ? nearest + half : -1;
    SightLine line;
    if (scene_.clip) {
      const double height = dot(scene_.clip->normal, origin) - scene_.clip->offset;
      const double slope = dot(scene_.clip->normal, direction);
      const double plane = -height / slope;
      if (slope < 0 && plane > begin) begin = plane, line.whole = false;
      if (slope > 0) end = std::min(end, plane);
      if (slope == 0 && height > 0) end = -1;
    }
    line.ray = {origin + begin * direction, direction, begin <= end ? end - begin : -1};
    return line;
  }

  static Colour base_colour(const Body& body, Vec3 point, const Hit& hit) {
    if (body.curvature_map != nullptr) {
      const auto [lo, hi] = body.curvature_range;
      return body.curvature_map->at((body.tracer->curvature(point, hit) - lo) / (hi - lo));
    }
    return body.table.empty() ? body.material : body.tracer->colour(point, hit, body.table);
  }

  // Where the sight lines of these places meet each body.
  void see(std::span<const Spot> spots, Views& views) const {
    constexpr std::size_t kRays = kBlock * kBlock;
    std::array<Ray, kRays> rays;
    std::array<SightLine, kRays> lines;
    std::array<Hit, kRays> hits;
    for (Sights& sights : views) sights.met.clear(), sights.of_spot.assign(spots.size(), -1);
    for (std::size_t begin = 0; begin < spots.size(); begin += kRays) {
      const std::size_t count = std::min(kRays, spots.size() - begin);
      for (std::size_t i = 0; i < count; ++i) {
        lines[i] = sight_line(spots[begin + i]);
        rays[i] = lines[i].ray;
      }
      studio_.context.throw_if_cancelled();
      for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
        const Body& body = scene_.bodies[b];
        body.tracer->first_hits({rays.data(), count}, {hits.data(), count});
        for (std::size_t i = 0; i < count; ++i) {
          const bool cut = !lines[i].whole && rays[i].far >= 0 && body.tracer->inside(rays[i].origin);
          if (!cut && !hits[i]) continue;
          views[b].of_spot[begin + i] = static_cast<std::int32_t>(views[b].met.size());
          Sight& sight = views[b].met.emplace_back();
          sight.spot = static_cast<std::uint32_t>(begin + i);
          sight.cut = cut;
          if (cut) {
            sight.place = {rays[i].origin, scene_.clip->normal, rays[i].origin};
            sight.base = body.material;
          } else {
            sight.place = body.tracer->place(rays[i], hits[i]);
            sight.base = base_colour(body, sight.place.point, hits[i]);
            sight.depth = hits[i].distance;
          }
        }
      }
    }
  }

  Ray from(const Place& place, Vec3 direction) const {
    Ray ray{place.start, direction};
    if (!scene_.clip) return ray;
    const double slope = dot(scene_.clip->normal, direction);
    if (slope > 0) ray.far = std::max(0.0, (scene_.clip->offset - dot(scene_.clip->normal, ray.origin)) / slope);
    return ray;
  }

  // The part of the light along each of rays_ that gets through the bodies, into open_.
  void let_through(bool alike) {
    open_.assign(rays_.size(), 1);
    blocked_.resize(rays_.size());
    constexpr std::size_t kRays = 256;  // between looks at whether to go on
    for (const Body& body : scene_.bodies)
      for (std::size_t begin = 0; begin < rays_.size(); begin += kRays) {
        const std::size_t count = std::min(kRays, rays_.size() - begin);
        studio_.context.throw_if_cancelled();
        body.tracer->blocked(std::span(rays_).subspan(begin, count), std::span(blocked_).subspan(begin, count), alike);
        for (std::size_t i = begin; i < begin + count; ++i)
          if (blocked_[i] != 0) open_[i] *= 1 - body.opacity;
      }
  }

  // The middles of the tile's pixels, in blocks.
  void look() {
    spots_.clear();
    for (int top = y0_; top < y1_; top += kBlock)
      for (int left = x0_; left < x1_; left += kBlock)
        for (int y = top; y < std::min(top + kBlock, y1_); ++y)
          for (int x = left; x < std::min(left + kBlock, x1_); ++x) spots_.push_back({x + 0.5, y + 0.5});
    see(spots_, centre_);
    of_pixel_.resize(area());
    for (std::size_t s = 0; s < spots_.size(); ++s)
      of_pixel_[at(static_cast<int>(spots_[s].x), static_cast<int>(spots_[s].y))] = static_cast<std::uint32_t>(s);
    studio_.context.throw_if_cancelled();
  }
  Vec3 in_pixels(Vec3 point) const { return 1 / camera_.mm_per_pixel * (point - camera_.centre); }

  // Asks for the light that comes to the places at the pixels' middles.
  void find_openness() {
    for (std::size_t b = 0; b < scene_.bodies.size(); ++b) {
      OpennessMap& map = openness_[b];
      map.reset(x1_ - x0_, y1_ - y0_);
      for (const Sight& sight : centre_[b].met)
        map.place(pixel_x(sight), pixel_y(sight), in_pixels(sight.place.point), sight.place.normal);
      if (scene_.shadows) ask_lamp(centre_[b].met, map);
      if (scene_.ambient_occlusion) ask_sky(centre_[b].met, map);
    }
  }
  int pixel_x(const Sight& sight) const { return static_cast<int>(spots_[sight.spot].x) - x0_; }
  int pixel_y(const Sight& sight) const { return static_cast<int>(spots_[sight.spot].y) - y0_; }
  std::uint32_t grain_of(const Sight& sight) const { return grain(x0_ + pixel_x(sight), y0_ + pixel_y(sight)); }

  // One ray to a point of the lamp from each place that faces it.
  void ask_lamp(std::span<const Sight> sights, OpennessMap& map) {
    rays_.clear(), asking_.clear();
    for (std::size_t i = 0; i < sights.size(); ++i) {
      const Vec3 normal = sights[i].place.normal;
      if (sights[i].cut || mean_cosine(dot(normal, studio_.lamp)) <= 0) continue;
      Vec3 towards = studio_.to_lamp[grain_of(sights[i])];
      // Only the part of the lamp that the place faces can be hidden by others.
      const double height = dot(normal, towards);
      if (height < 0) towards = towards - 2 * height * normal;
      rays_.push_back(from(sights[i].place, towards));
      asking_.push_back(static_cast<std::uint32_t>(i));
    }
    let_through(true);
    for (std::size_t r = 0; r < rays_.size(); ++r) {
      const Sight& sight = sights[asking_[r]];
      map.set_lamp(pixel_x(sight), pixel_y(sight), open_[r]);
    }
    studio_.context.throw_if_cancelled();
  }

  // A few rays to the sky from each place.
  void ask_sky(std::span<const Sight> sights, OpennessMap& map) {
    rays_.clear();
    for (const Sight& sight : sights) {
      if (sight.cut) continue;
      const Vec3* points = &studio_.sky[grain_of(sight) * kSkyRays];
      for (int i = 0; i < kSkyRays; ++i)
        rays_.push_back(from(sight.place, sky_direction(sight.place.normal, points[i])));
    }
    let_through(false);
    std::size_t next = 0;
    for (const Sight& sight : sights) {
      if (sight.cut) continue;
      double sum = 0;
      for (int i = 0; i < kSkyRays; ++i) sum += open_[next++];
      map.set_sky(pixel_x(sight), pixel_y(sight), sum / kSkyRays);
    }
    studio_.context.throw_if_cancelled();
  }

  // The light that a place in pixel (x, y) sends on. `last`: the place of this body that was asked for before in this
  // pixel; one that is next to it on the same smooth surface sees as much.
  struct Known {
    const Sight* sight = nullptr;
    Openness openness;
  };
  Colour light_of(std::size_t b, int x, int y, const Sight& sight, Known& last) const {
    const Vec3 normal = sight.place.normal;
    const double facing = dot(normal, studio_.lamp);
    Colour light = sky_light(camera_, normal);
    if (sight.cut || !(scene_.shadows || scene_.ambient_occlusion))
      return mixed(sight.base, light + std::max(0.0, facing) * kKey);
    if (last.sight == nullptr || dot(normal, last.sight->place.normal) < kAlike ||
        std::abs(dot(normal, sight.place.point - last.sight->place.point)) > 0.5 * camera_.mm_per_pixel)
      last = {&sight, openness_[b].at(x - x0_, y - y0_, in_pixels(sight.place.point), normal)};
    const double cosine = scene_.shadows ? mean_cosine(facing) : std::max(0.0, facing);
    return mixed(sight.base, last.openness.sky * light + last.openness.lamp * cosine * kKey);
  }
  using Lasts = std::array<Known, Scene::most_bodies>;

  // Adds what one sight line sends to a pixel of which it is `part`.
  void add(const Views& views, std::size_t spot, int x, int y, double part, Lasts& lasts, Sum& sum) const {
    std::array<const Sight*, Scene::most_bodies> met{};
    std::array<std::size_t, Scene::most_bodies> order{0, 1};
    for (std::size_t b = 0; b < scene_.bodies.size(); ++b) met[b] = views[b].at(spot);
    if (met[0] != nullptr && met[1] != nullptr && met[1]->depth < met[0]->depth) order = {1, 0};
    for (const std::size_t b : order) {
      if (met[b] == nullptr) continue;
      const double weight = part * scene_.bodies[b].opacity;
      part -= weight;
      sum.light = sum.light + weight * light_of(b, x, y, *met[b], lasts[b]);
      sum.coverage += weight;
    }
  }

  // Every pixel by its middle alone.
  void develop() {
    shown_.resize(4 * area());
    const int rim = studio_.samples > 1 ? 1 : 0;
    for (int y = std::max(y0_, top_ - rim); y < std::min(y1_, bottom_ + rim); ++y)
      for (int x = std::max(x0_, left_ - rim); x < std::min(x1_, right_ + rim); ++x) {
        const std::size_t spot = of_pixel_[at(x, y)];
        Lasts lasts;
        Sum sum;
        add(centre_, spot, x, y, 1, lasts, sum);
        write(shown(x, y), sum, y);
      }
    studio_.context.throw_if_cancelled();
  }

  // Whether the one in the middle shows what no even change from one side to the other would.
  static bool breaks(const std::uint8_t* side, const std::uint8_t* middle, const std::uint8_t* other) {
    int sum = 0;
    for (int a = 0; a < 4; ++a) sum += std::abs(side[a] + other[a] - 2 * middle[a]);
    return sum > kVisible;
  }

  // Pixels at which what is seen does not change evenly are looked at closely.
  void find_busy() {
    busy_.clear();
    if (studio_.samples == 1) return;  // the middle is all there is to see
    for (int y = top_; y < bottom_; ++y)
      for (int x = left_; x < right_; ++x)
        if (must_look_closely(x, y) || is_edge(x, y)) busy_.push_back({x, y});
  }
  bool must_look_closely(int x, int y) const {
    return !studio_.closely.empty() &&
           studio_.closely[static_cast<std::size_t>(y) * static_cast<std::size_t>(exposure_.width) +
                           static_cast<std::size_t>(x)] != 0;
  }
  bool is_edge(int x, int y) const {
    const std::uint8_t* middle = shown(x, y);
    for (const auto& [dx, dy] : {std::pair{1, 0}, {0, 1}, {1, 1}, {-1, 1}}) {
      // Beyond the picture all is as in its last pixel.
      const auto at_side = [&](int sign) {
        const int u = x + sign * dx, v = y + sign * dy;
        return u < x0_ || u >= x1_ || v < y0_ || v >= y1_ ? middle : shown(u, v);
      };
      if (breaks(at_side(-1), middle, at_side(1))) return true;
    }
    return false;
  }

  // n × n sights of each busy pixel.
  void look_closely(Image& image) {
    constexpr std::size_t kPixels = 128;  // at a time
    const int n = exposure_.samples_per_axis;
    for (std::size_t begin = 0; begin < busy_.size(); begin += kPixels) {
      const auto pixels = std::span(busy_).subspan(begin, std::min(kPixels, busy_.size() - begin));
      spots_close_.clear();
      for (const auto& [x, y] : pixels)
        for (int row = 0; row < n; ++row)
          for (int column = 0; column < n; ++column)
            spots_close_.push_back({x + (column + 0.5) / n, y + (row + 0.5) / n});
      see(spots_close_, close_);
      for (std::size_t p = 0; p < pixels.size(); ++p) {
        const auto [x, y] = pixels[p];
        Lasts lasts;
        Sum sum;
        for (std::size_t s = p * studio_.samples; s < (p + 1) * studio_.samples; ++s)
          add(close_, s, x, y, 1.0 / studio_.samples, lasts, sum);
        write(image.at(x, y), sum, y);
      }
      studio_.context.throw_if_cancelled();
    }
  }

  // The background in a row.
  std::array<std::uint8_t, 4> ground(int y) const {
    if (exposure_.background == Background::transparent) return {};
    const std::uint8_t grey = to_srgb(behind(exposure_.background, y, exposure_.height));
    return {grey, grey, grey, 255};
  }

  void write(std::uint8_t* rgba, const Sum& sum, int y) const {
    if (!(sum.coverage > 0)) {
      std::ranges::copy(ground(y), rgba);
      return;
    }
    const double coverage = sum.coverage;
    const Colour whole = 1 / coverage * sum.light;
    if (exposure_.background == Background::transparent || coverage >= 1) {
      for (int a = 0; a < 3; ++a) rgba[a] = studio_.exposed(whole[a]);
      rgba[3] = static_cast<std::uint8_t>(std::min(255.0, 255 * coverage + 0.5));
      return;
    }
    const double grey = behind(exposure_.background, y, exposure_.height);
    const Colour c = coverage * tone(whole) + (1 - coverage) * Colour{grey, grey, grey};
    for (int a = 0; a < 3; ++a) rgba[a] = to_srgb(c[a]);
    rgba[3] = 255;
  }

  const Studio& studio_;
  const Scene& scene_;
  const Camera& camera_;
  const Exposure& exposure_;
  int left_ = 0, top_ = 0, right_ = 0, bottom_ = 0;  // the tile's pixels
  int x0_ = 0, y0_ = 0, x1_ = 0, y1_ = 0;            // with its surroundings
  std::vector<Spot> spots_;                          // the middles of these pixels
  std::vector<std::uint32_t> of_pixel_;              // where in spots_ each of them is
  Views centre_;
  std::array<OpennessMap, Scene::most_bodies> openness_;
  std::vector<std::uint8_t> shown_;
  std::vector<std::array<int, 2>> busy_;  // pixels that are looked at closely
  std::vector<Spot> spots_close_;
  Views close_;
  std::vector<Ray> rays_;  // that are asked for, and whose, and what becomes of their light
  std::vector<std::uint32_t> asking_;
  std::vector<double> open_;
  std::vector<std::uint8_t> blocked_;
};

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
  const auto shoulder = [](double linear) { return 1 - elementary::exp(-kExposure * linear); };
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

namespace {

// Sets the part of the picture in which bodies may be seen, and where they are.
void frame_bodies(Studio& studio) {
  const double infinity = std::numeric_limits<double>::infinity();
  studio.box_left = studio.box_top = infinity, studio.box_right = studio.box_bottom = -infinity;
  Box all;
  for (const Body& body : studio.scene.bodies) {
    const Box box = body.tracer->bounds();
    if (!box.empty()) all.include(box.min), all.include(box.max);
  }
  if (all.empty()) return;
  studio.middle = 0.5 * (all.min + all.max);
  studio.reach = 0.51 * norm(all.max - all.min);
  for (const Body& body : studio.scene.bodies) {
    const Box box = body.tracer->bounds();
    for (int corner = 0; corner < 8 && !box.empty(); ++corner) {
      const Vec3 seen = studio.camera.seen_at(
          {(corner & 1 ? box.max : box.min).x, (corner & 2 ? box.max : box.min).y, (corner & 4 ? box.max : box.min).z});
      if (!(seen.z > 0) && studio.camera.projection == Projection::perspective) {  // behind the eye
        studio.box_left = studio.box_top = -infinity, studio.box_right = studio.box_bottom = infinity;
        return;
      }
      const double x = seen.x + 0.5 * studio.exposure.width, y = seen.y + 0.5 * studio.exposure.height;
      studio.box_left = std::min(studio.box_left, x - 1), studio.box_right = std::max(studio.box_right, x + 1);
      studio.box_top = std::min(studio.box_top, y - 1), studio.box_bottom = std::max(studio.box_bottom, y + 1);
    }
  }
}

}  // namespace

Image shoot(const Scene& scene, const Camera& camera, const Exposure& exposure, std::string_view stage,
            const Context& context) {
  Image image = blank_image(exposure.width, exposure.height);
  Studio studio{scene, camera, exposure, context};
  frame_bodies(studio);
  for (const Vec3 point : sphere_points(1)) studio.to_lamp.push_back(normalised(studio.lamp + kKeyRadius * point));
  // One for each thread.
  std::vector<std::unique_ptr<Tile>> idle;
  std::mutex idle_mutex;
  const int across = (exposure.width + kTile - 1) / kTile, down = (exposure.height + kTile - 1) / kTile;
  parallel_for(context, stage, static_cast<std::size_t>(across) * static_cast<std::size_t>(down), 1,
               [&](std::size_t i, std::size_t) {
                 std::unique_ptr<Tile> tile;
                 {
                   const std::lock_guard lock(idle_mutex);
                   if (!idle.empty()) tile = std::move(idle.back()), idle.pop_back();
                 }
                 if (!tile) tile = std::make_unique<Tile>(studio);
                 tile->draw(static_cast<int>(i) % across * kTile, static_cast<int>(i) / across * kTile, image);
                 const std::lock_guard lock(idle_mutex);
                 idle.push_back(std::move(tile));
               });
  return image;
}

}  // namespace spherule
