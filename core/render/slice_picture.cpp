// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/slice_picture.h"

#include <algorithm>
#include <cmath>
#include <numbers>
#include <span>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/ranges.h"
#include "core/render/font.h"
#include "core/render/ticks.h"

namespace spherule {
namespace {

constexpr Ink kGround{13, 15, 18}, kPaper{255, 255, 255};
constexpr Ink kLight{232, 234, 238}, kDark{38, 42, 51};

// Dark enough for paper and light enough for a scan.
constexpr Ink kContour{255, 186, 43}, kPoints{240, 84, 60}, kTriangles{104, 170, 230, 0.8}, kInside{38, 166, 154},
    kCircles{236, 112, 60, 0.85}, kCentres{171, 71, 188};

}  // namespace

void check_slice_options(const SliceOptions& o) {
  std::vector<FieldError> fields;
  const auto need = [&](bool good, const char* field, const std::string& detail) {
    if (!good) fields.push_back({field, "must be " + detail});
  };
  need(ranges::pixels.holds(o.width), "width", ranges::pixels.words() + " pixels");
  need(ranges::pixels.holds(o.height), "height", ranges::pixels.words() + " pixels");
  need(!o.window || ranges::window.holds(o.window->width), "window", "a width " + ranges::window.words());
  need(!o.window || ranges::value.holds(o.window->level), "level", ranges::value.words());
  if (o.region) {
    const auto& [x0, y0, x1, y1] = *o.region;
    // A thousandth of a sample: less would be all rounding.
    need(x1 - x0 >= 1e-3 && y1 - y0 >= 1e-3 &&
             std::ranges::all_of(*o.region, [](double v) { return ranges::region.holds(v); }),
         "region", "x0,y0,x1,y1 in samples " + ranges::region.words() + ", with x0 below x1 and y0 below y1");
  }
  if (!fields.empty())
    throw Error(ErrorCode::invalid_argument,
                "The slice's " + fields.front().pointer + ' ' + fields.front().detail + '.', fields);
}

Window usual_window(const Volume& volume, const Context& context) {
  constexpr std::size_t kBuckets = 4096;
  const ValueRange range = value_range(volume, context);
  const double step = (range.max - range.min) / kBuckets;
  if (!(step > 0) || !std::isfinite(step)) return {.width = 1, .level = range.min};
  const auto counts = value_histogram(volume, range, kBuckets, context);
  std::uint64_t all = 0;
  for (const std::uint64_t n : counts) all += n;
  const auto end = [&](auto begin, auto stop) {
    std::uint64_t passed = 0;
    std::size_t bucket = 0;
    for (auto n = begin; n != stop && (passed += *n) * 200 <= all; ++n) ++bucket;
    return bucket;
  };
  const double lo = range.min + step * static_cast<double>(end(counts.begin(), counts.end()));
  const double hi = range.max - step * static_cast<double>(end(counts.rbegin(), counts.rend()));
  // All but a few samples are equal: then those few are what there is to see.
  if (!(hi - lo > 2 * step)) return {.width = range.max - range.min, .level = 0.5 * (range.min + range.max)};
  return {.width = hi - lo, .level = 0.5 * (lo + hi)};
}

namespace {

// Letters of a direction, the nearest first; a second one when it is more than 22.5 degrees off the first.
std::string letters_of(Vec3 direction) {
  struct Part {
    double size;
    char letter;
  };
  std::array<Part, 3> parts{{{std::abs(direction.x), direction.x > 0 ? 'L' : 'R'},
                             {std::abs(direction.y), direction.y > 0 ? 'P' : 'A'},
                             {std::abs(direction.z), direction.z > 0 ? 'H' : 'F'}}};
  std::ranges::stable_sort(parts, std::ranges::greater{}, &Part::size);
  std::string letters;
  for (const Part& part : parts)
    if (letters.empty() || part.size > 0.3827) letters += part.letter;
  return letters;
}

}  // namespace

SlicePlane plane_of(const Grid& slice) {
  constexpr std::array kNames{"sagittal", "coronal", "axial"};
  constexpr std::array kRight{Vec3{0, 1, 0}, Vec3{1, 0, 0}, Vec3{1, 0, 0}};
  constexpr std::array kDown{Vec3{0, 0, -1}, Vec3{0, 0, -1}, Vec3{0, 1, 0}};
  const Vec3 normal = slice.direction.column(2);
  std::size_t nearest = 2;
  for (const std::size_t a : {std::size_t{1}, std::size_t{0}})
    if (std::abs(normal[static_cast<int>(a)]) > std::abs(normal[static_cast<int>(nearest)]) + 1e-9) nearest = a;
  SlicePlane plane;
  plane.name = kNames[nearest];
  if (std::abs(normal[static_cast<int>(nearest)]) < elementary::cos(15 * std::numbers::pi / 180))
    plane.name = "oblique " + plane.name;
  const std::array<Vec3, 2> axes{slice.direction.column(0), slice.direction.column(1)};
  plane.across = std::abs(dot(axes[0], kRight[nearest])) >= std::abs(dot(axes[1], kRight[nearest])) ? 0 : 1;
  Vec3 right = axes[plane.across == 0 ? 0 : 1], down = axes[plane.across == 0 ? 1 : 0];
  plane.turn_across = dot(right, kRight[nearest]) < 0;
  plane.turn_down = dot(down, kDown[nearest]) < 0;
  if (plane.turn_across) right = -right;
  if (plane.turn_down) down = -down;
  plane.right = letters_of(right), plane.left = letters_of(-right);
  plane.bottom = letters_of(down), plane.top = letters_of(-down);
  return plane;
}

namespace {

// Where a slice lies in a picture.
class Frame {
 public:
  Frame(const Grid& slice, const SliceOptions& o, double margin) : plane(plane_of(slice)) {
    region_ = o.region.value_or(std::array{-0.5, -0.5, slice.dims[0] - 0.5, slice.dims[1] - 0.5});
    spacing_ = {slice.spacing.x, slice.spacing.y};
    const double wide = extent(plane.across), high = extent(1 - plane.across);
    const double room_x = std::max(1.0, o.width - 2 * margin), room_y = std::max(1.0, o.height - 2 * margin);
    mm_per_pixel = std::max(wide / room_x, high / room_y);
    right = std::round(0.5 * (o.width + wide / mm_per_pixel));
    left = std::round(0.5 * (o.width - wide / mm_per_pixel));
    top = std::round(0.5 * (o.height - high / mm_per_pixel));
    bottom = std::round(0.5 * (o.height + high / mm_per_pixel));
  }

  // Coordinates in samples along the slice's axes to the picture, and back.
  Point2 pixel(double x, double y) const {
    return {o_pixel(plane.across == 0 ? x : y, plane.across, plane.turn_across, 0.5 * (left + right)),
            o_pixel(plane.across == 0 ? y : x, 1 - plane.across, plane.turn_down, 0.5 * (top + bottom))};
  }
  std::array<double, 2> sample(Point2 p) const {
    const double a = o_sample(p.x, plane.across, plane.turn_across, 0.5 * (left + right));
    const double b = o_sample(p.y, 1 - plane.across, plane.turn_down, 0.5 * (top + bottom));
    return plane.across == 0 ? std::array{a, b} : std::array{b, a};
  }
  bool touches(Point2 p, double radius) const {
    return p.x + radius > left && p.x - radius < right && p.y + radius > top && p.y - radius < bottom;
  }
  double samples_per_pixel() const { return mm_per_pixel / std::min(spacing_[0], spacing_[1]); }

  SlicePlane plane;
  double mm_per_pixel = 1;
  double left = 0, top = 0, right = 0, bottom = 0;  // whole pixels

 private:
  static std::size_t index(int axis) { return static_cast<std::size_t>(axis); }
  double extent(int axis) const { return spacing_[index(axis)] * (region_[index(axis) + 2] - region_[index(axis)]); }
  double middle(int axis) const { return 0.5 * (region_[index(axis) + 2] + region_[index(axis)]); }
  double o_pixel(double at, int axis, bool turned, double centre) const {
    return centre + (turned ? -1 : 1) * (at - middle(axis)) * spacing_[index(axis)] / mm_per_pixel;
  }
  double o_sample(double at, int axis, bool turned, double centre) const {
    return middle(axis) + (turned ? -1 : 1) * (at - centre) * mm_per_pixel / spacing_[index(axis)];
  }

  std::array<double, 4> region_;
  std::array<double, 2> spacing_;
};

// The slice's values between its samples; NaN beyond its edge and where there are no numbers.
class Values {
 public:
  explicit Values(const Volume& slice) : nx_(slice.grid.dims[0]), ny_(slice.grid.dims[1]) {
    values_.reserve(slice.grid.sample_count());
    visit_voxels(slice, [&](auto voxels) {
      for (const auto v : voxels) values_.push_back(slice.slope * static_cast<double>(v) + slice.intercept);
    });
  }
  double nearest(double x, double y) const {
    if (!(x >= -0.5 && y >= -0.5 && x < nx_ - 0.5 && y < ny_ - 0.5)) return NAN;
    return at(static_cast<int>(std::floor(x + 0.5)), static_cast<int>(std::floor(y + 0.5)));
  }
  double smooth(double x, double y) const {
    const double here = nearest(x, y);
    if (!std::isfinite(here)) return here;
    const double cx = std::clamp(x, 0.0, nx_ - 1.0), cy = std::clamp(y, 0.0, ny_ - 1.0);
    const int x0 = std::min(static_cast<int>(cx), std::max(0, nx_ - 2)),
              y0 = std::min(static_cast<int>(cy), std::max(0, ny_ - 2));
    const int x1 = std::min(x0 + 1, nx_ - 1), y1 = std::min(y0 + 1, ny_ - 1);
    const double u = cx - x0, v = cy - y0;
    const double between =
        (1 - v) * ((1 - u) * at(x0, y0) + u * at(x1, y0)) + v * ((1 - u) * at(x0, y1) + u * at(x1, y1));
    return std::isfinite(between) ? between : here;
  }

 private:
  double at(int x, int y) const {
    return values_[static_cast<std::size_t>(y) * static_cast<std::size_t>(nx_) + static_cast<std::size_t>(x)];
  }
  int nx_, ny_;
  std::vector<double> values_;
};

void draw_values(const Volume& slice, const Frame& frame, const Window& window, bool smooth, const Context& context,
                 Image& image) {
  const Values values(slice);
  // Where samples are smaller than pixels, several are looked at in each.
  const int n = smooth ? std::clamp(static_cast<int>(std::ceil(frame.samples_per_pixel())), 1, 8) : 1;
  const int left = std::max(0, static_cast<int>(frame.left)),
            right = std::min(image.width, static_cast<int>(frame.right));
  const int top = std::max(0, static_cast<int>(frame.top)),
            bottom = std::min(image.height, static_cast<int>(frame.bottom));
  if (bottom <= top) return;
  parallel_for(context, "slice", static_cast<std::size_t>(bottom - top), 1, [&](std::size_t begin, std::size_t end) {
    for (int y = top + static_cast<int>(begin); y < top + static_cast<int>(end); ++y)
      for (int x = left; x < right; ++x) {
        double sum = 0;  // of 1/128 of each: up to 64 of the largest numbers have a sum
        int count = 0;
        for (int row = 0; row < n; ++row)
          for (int column = 0; column < n; ++column) {
            const auto [u, v] = frame.sample({x + (column + 0.5) / n, y + (row + 0.5) / n});
            const double value = smooth ? values.smooth(u, v) : values.nearest(u, v);
            if (!std::isfinite(value)) continue;
            sum += value / 128;
            ++count;
          }
        if (count == 0) continue;
        const double grey = std::clamp((128 * (sum / count) - window.level) / window.width + 0.5, 0.0, 1.0);
        std::fill_n(image.at(x, y), 3, static_cast<std::uint8_t>(std::lround(255 * grey)));
      }
  });
}

// To three digits of the width.
std::string window_words(const Window& window) {
  const double step = elementary::pow(10.0, std::floor(elementary::log10(window.width)) - 2);
  const auto words = [&](double value) { return label(std::round(value / step) * step); };
  return "window " + words(window.width) + ", level " + words(window.level);
}

// The object, in pixels of the frame.
class ObjectDrawing {
 public:
  ObjectDrawing(const PlaneModel& model, const Frame& frame, double unit) : model_(model), frame_(frame), unit_(unit) {
    points_.reserve(model.points.size());
    for (const LatticePoint p : model.points) points_.push_back(pixel({double(p.x), double(p.y), 0}));
  }

  void draw(Overlay what, Drawing& drawing) const {
    switch (what) {
      case Overlay::contour: return lines(model_.contour, 2.2 * unit_, kContour, drawing);
      case Overlay::points: return drawing.discs(discs(), kPoints);
      case Overlay::triangles: return drawing.lines(outlines(model_.triangles), 0.9 * unit_, kTriangles);
      case Overlay::inside: {
        const auto inside = std::span(model_.triangles).first(model_.inside_count);
        Ink fill = kInside;
        fill.opacity = 0.35;
        drawing.areas(polygons(inside), fill);
        return drawing.lines(outlines(inside), 1.1 * unit_, kInside);
      }
      case Overlay::circles: return drawing.circles(rings(), 1.1 * unit_, kCircles);
      case Overlay::centres: {
        auto centres = rings();
        std::erase_if(centres, [&](const auto& ring) { return !frame_.touches(ring.centre, 3); });
        for (auto& ring : centres) ring.radius = 1.7 * unit_;
        return drawing.discs(std::move(centres), kCentres);
      }
    }
  }

 private:
  Point2 pixel(Vec3 lattice) const {
    // Planes are evenly spaced but for the lattice's rounding.
    const auto along = [&](int axis, double at) {
      const double first = model_.lattice.plane(axis, 0);
      return (at - first) * model_.lattice.unit_mm / model_.lattice.grid.spacing[axis];
    };
    return frame_.pixel(along(0, lattice.x), along(1, lattice.y));
  }
  template <std::size_t n>
  bool seen(const std::array<std::uint32_t, n>& corners) const {
    double left = INFINITY, right = -INFINITY, top = INFINITY, bottom = -INFINITY;
    for (const std::uint32_t c : corners) {
      left = std::min(left, points_[c].x), right = std::max(right, points_[c].x);
      top = std::min(top, points_[c].y), bottom = std::max(bottom, points_[c].y);
    }
    return right >= frame_.left && left <= frame_.right && bottom >= frame_.top && top <= frame_.bottom;
  }
  void lines(const std::vector<std::array<std::uint32_t, 2>>& edges, double width, Ink ink, Drawing& drawing) const {
    std::vector<std::vector<Point2>> paths;
    for (const auto& edge : edges)
      if (seen(edge)) paths.push_back({points_[edge[0]], points_[edge[1]]});
    drawing.lines(std::move(paths), width, ink);
  }
  std::vector<std::vector<Point2>> polygons(std::span<const PlaneTriangle> triangles) const {
    std::vector<std::vector<Point2>> all;
    for (const PlaneTriangle& t : triangles)
      if (seen(t)) all.push_back({points_[t[0]], points_[t[1]], points_[t[2]]});
    return all;
  }
  std::vector<std::vector<Point2>> outlines(std::span<const PlaneTriangle> triangles) const {
    auto all = polygons(triangles);
    for (auto& path : all) path.push_back(path.front());
    return all;
  }
  std::vector<Drawing::Ring> discs() const {
    std::vector<Drawing::Ring> all;
    for (const Point2 p : points_)
      if (frame_.touches(p, 3)) all.push_back({p, 2.1 * unit_});
    return all;
  }
  std::vector<Drawing::Ring> rings() const {
    std::vector<Drawing::Ring> all;
    const Grid& grid = model_.lattice.grid;
    for (const Sphere& c : model_.circles) {
      const Vec3 v = c.centre - grid.origin;
      const Point2 centre = frame_.pixel(dot(v, grid.direction.column(0)) / grid.spacing.x,
                                         dot(v, grid.direction.column(1)) / grid.spacing.y);
      const double radius = c.radius / frame_.mm_per_pixel;
      if (frame_.touches(centre, radius)) all.push_back({centre, radius});
    }
    return all;
  }

  const PlaneModel& model_;
  const Frame& frame_;
  double unit_;
  std::vector<Point2> points_;
};

void draw_notes(const Frame& frame, const SliceOptions& o, double size, const std::string& caption,
                const std::string& window, Drawing& drawing) {
  const Ink ink = o.image ? kLight : kDark, ground = o.image ? kGround : kPaper;
  // What runs over the frame is covered, so that the picture ends where the region does.
  drawing.rectangle(0, 0, o.width, frame.top, ground);
  drawing.rectangle(0, frame.bottom, o.width, o.height - frame.bottom, ground);
  drawing.rectangle(0, frame.top, frame.left, frame.bottom - frame.top, ground);
  drawing.rectangle(frame.right, frame.top, o.width - frame.right, frame.bottom - frame.top, ground);
  const double x = 0.5 * (frame.left + frame.right), y = 0.5 * (frame.top + frame.bottom), gap = 0.8 * size;
  if (o.letters) {
    drawing.text({frame.left - gap, y + 0.5 * size}, size, Anchor::end, frame.plane.left, ink);
    drawing.text({frame.right + gap, y + 0.5 * size}, size, Anchor::start, frame.plane.right, ink);
    drawing.text({x, frame.top - gap}, size, Anchor::middle, frame.plane.top, ink);
    drawing.text({x, frame.bottom + gap + size}, size, Anchor::middle, frame.plane.bottom, ink);
  }
  if (o.caption) {
    drawing.text({gap, gap + size}, size, Anchor::start, caption, ink);
    drawing.text({o.width - gap, gap + size}, size, Anchor::end, window, ink);
  }
  if (o.scale_bar) {
    const double length = round_step(0.1 * o.width * frame.mm_per_pixel), pixels = length / frame.mm_per_pixel;
    const double low = o.height - gap - 0.5 * size, thick = stroke_width(size);
    drawing.lines({{{gap, low}, {gap + pixels, low}},
                   {{gap, low - 0.4 * size}, {gap, low + 0.4 * size}},
                   {{gap + pixels, low - 0.4 * size}, {gap + pixels, low + 0.4 * size}}},
                  thick, ink);
    drawing.text({gap + pixels + gap, low + 0.5 * size}, size, Anchor::start, label(length) + " mm", ink);
  }
}

}  // namespace

SlicePicture draw_slice(const Volume& slice, int axis, std::int32_t index, const PlaneModel* model,
                        const Window& window, const SliceOptions& o, const Context& context) {
  check_slice_options(o);
  const double size = std::clamp(0.0165 * std::min(o.width, o.height), 7.0, 40.0);
  const bool notes = o.letters || o.caption || o.scale_bar;
  const Frame frame(slice.grid, o, notes ? 2.6 * size : 0);
  SlicePicture picture{blank_image(o.width, o.height), Drawing(o.width, o.height)};
  const Ink ground = o.image ? kGround : kPaper;
  for (int y = 0; y < o.height; ++y) {
    context.throw_if_cancelled();
    for (int x = 0; x < o.width; ++x)
      std::ranges::copy(std::array<std::uint8_t, 4>{ground.red, ground.green, ground.blue, 255},
                        picture.image.at(x, y));
  }
  if (o.image) draw_values(slice, frame, window, o.smooth, context, picture.image);
  if (model != nullptr) {
    const ObjectDrawing object(*model, frame, std::max(0.6, size / 13.2));
    // Areas and thin lines first, so that what is small lies on top.
    for (const Overlay what :
         {Overlay::inside, Overlay::triangles, Overlay::circles, Overlay::contour, Overlay::points, Overlay::centres})
      if (std::ranges::find(o.show, what) != o.show.end()) object.draw(what, picture.drawing);
  }
  const char letter = "ijk"[axis];
  draw_notes(frame, o, size, frame.plane.name + ", " + letter + " = " + std::to_string(index),
             o.image ? window_words(window) : std::string(), picture.drawing);
  return picture;
}

}  // namespace spherule
