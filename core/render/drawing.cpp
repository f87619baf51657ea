// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/drawing.h"

#include <openssl/evp.h>

#include <algorithm>
#include <cmath>
#include <functional>

#include "core/base/elementary.h"
#include "core/base/text.h"

namespace spherule {
namespace {

// How much of each pixel of a rectangle is covered by one shape.
class Mask {
 public:
  // Of the picture's part that [left, right) × [top, bottom) touches.
  Mask(const Image& image, double left, double top, double right, double bottom)
      : x0_(clamped(std::floor(left), image.width)),
        y0_(clamped(std::floor(top), image.height)),
        x1_(clamped(std::ceil(right), image.width)),
        y1_(clamped(std::ceil(bottom), image.height)),
        cover_(static_cast<std::size_t>(std::max(0, x1_ - x0_)) * static_cast<std::size_t>(std::max(0, y1_ - y0_)),
               0.0F) {}

  // Pixels within `reach` of a segment, by their centres' distance from it. Only the span of each row that the line can
  // reach: a long one is looked at no more than it is long.
  void stroke(Point2 a, Point2 b, double width) {
    const double reach = width / 2 + 0.5, dx = b.x - a.x, dy = b.y - a.y, squared = dx * dx + dy * dy;
    const auto depth = [&](double x, double y) {
      const double t = squared > 0 ? std::clamp(((x - a.x) * dx + (y - a.y) * dy) / squared, 0.0, 1.0) : 0;
      return reach - elementary::hypot(x - a.x - t * dx, y - a.y - t * dy);
    };
    const double left = std::min(a.x, b.x) - reach, right = std::max(a.x, b.x) + reach;
    const double half = 1 + reach * std::sqrt(squared) / std::abs(dy);  // of a row's span
    const int first = clamped(std::floor(std::min(a.y, b.y) - reach), y1_),
              last = clamped(std::ceil(std::max(a.y, b.y) + reach), y1_);
    for (int y = std::max(y0_, first); y < last; ++y) {
      const double middle = a.x + (y + 0.5 - a.y) * dx / dy;
      // Along a row there is no middle: both are not finite, and all of it is looked at.
      each(std::isfinite(middle) ? std::max(left, middle - half) : left, y,
           std::isfinite(middle) ? std::min(right, middle + half) : right, y + 1, depth);
    }
  }
  // Only the two spans of each row that the ring can reach: a large one is looked at no more than its line is long.
  void ring(Point2 c, double radius, double width) {
    const double reach = width / 2 + 0.5, outer = radius + reach, inner = radius - reach;
    const auto depth = [&](double x, double y) {
      return reach - std::abs(elementary::hypot(x - c.x, y - c.y) - radius);
    };
    const auto half_chord = [](double r, double height) { return std::sqrt(std::max(0.0, r * r - height * height)); };
    const int first = clamped(std::floor(c.y - outer), y1_), last = clamped(std::ceil(c.y + outer), y1_);
    for (int y = std::max(y0_, first); y < last; ++y) {
      const double height = y + 0.5 - c.y, wide = half_chord(outer, height);
      const double narrow = inner > std::abs(height) ? half_chord(inner, height) : 0;
      each(c.x - wide, y, c.x - narrow, y + 1, depth);
      each(c.x + narrow, y, c.x + wide, y + 1, depth);
    }
  }
  void disc(Point2 c, double radius) {
    const double outer = radius + 0.5;
    each(c.x - outer, c.y - outer, c.x + outer, c.y + outer,
         [&](double x, double y) { return outer - elementary::hypot(x - c.x, y - c.y); });
  }
  // Adds the exact part of each pixel that a convex polygon covers: parts of neighbours add to whole pixels.
  void area(const std::vector<Point2>& polygon) {
    double top = polygon[0].y, bottom = polygon[0].y;
    for (const Point2 p : polygon) top = std::min(top, p.y), bottom = std::max(bottom, p.y);
    for (int y = std::max(y0_, clamped(std::floor(top), y1_)); y < std::min<double>(y1_, bottom); ++y) {
      std::vector<Point2> band = clipped(clipped(polygon, 0, 1, y, true), 0, 1, y + 1, false);
      if (band.size() < 3) continue;
      double left = band[0].x, right = band[0].x;
      for (const Point2 p : band) left = std::min(left, p.x), right = std::max(right, p.x);
      const auto [full, end] = covered(polygon, y);
      const int last = static_cast<int>(std::min<double>(x1_, std::ceil(right)));
      for (int x = std::max(x0_, clamped(std::floor(left), x1_)); x < last; ++x)
        at(x, y) += x >= full && x < end
                        ? 1
                        : static_cast<float>(size(clipped(clipped(band, 1, 0, x, true), 1, 0, x + 1, false)));
    }
  }

  void blend(Ink ink, const Context& context, Image& image) const {
    for (int y = y0_; y < y1_; ++y) {
      context.throw_if_cancelled();
      for (int x = x0_; x < x1_; ++x) {
        const double cover = std::min(1.0F, at(x, y)) * ink.opacity;
        if (cover <= 0) continue;
        std::uint8_t* rgba = image.at(x, y);
        const double behind = rgba[3] / 255.0 * (1 - cover), alpha = cover + behind;
        const std::array<std::uint8_t, 3> colour{ink.red, ink.green, ink.blue};
        for (std::size_t a = 0; a < 3; ++a)
          rgba[a] = static_cast<std::uint8_t>(std::lround((cover * colour[a] + behind * rgba[a]) / alpha));
        rgba[3] = static_cast<std::uint8_t>(std::lround(255 * alpha));
      }
    }
  }

 private:
  static int clamped(double v, int most) { return static_cast<int>(std::clamp(v, 0.0, double(most))); }
  std::size_t index(int x, int y) const {
    return static_cast<std::size_t>(y - y0_) * static_cast<std::size_t>(x1_ - x0_) + static_cast<std::size_t>(x - x0_);
  }
  float& at(int x, int y) { return cover_[index(x, y)]; }
  float at(int x, int y) const { return cover_[index(x, y)]; }

  template <typename Depth>
  void each(double left, double top, double right, double bottom, Depth depth) {
    const int xa = std::max(x0_, clamped(std::floor(left), x1_)), xb = std::min(x1_, clamped(std::ceil(right), x1_));
    const int ya = std::max(y0_, clamped(std::floor(top), y1_)), yb = std::min(y1_, clamped(std::ceil(bottom), y1_));
    for (int y = ya; y < yb; ++y)
      for (int x = xa; x < xb; ++x)
        at(x, y) = std::max(at(x, y), static_cast<float>(std::clamp(depth(x + 0.5, y + 0.5), 0.0, 1.0)));
  }

  // The pixels [first, end) of row y that a convex polygon covers: those whose four corners it holds.
  std::pair<int, int> covered(const std::vector<Point2>& polygon, int y) const {
    double left = x0_, right = x1_;
    for (const double height : {y + 0.0, y + 1.0}) {
      double least = INFINITY, most = -INFINITY;
      for (std::size_t i = 0; i < polygon.size(); ++i) {
        const Point2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
        if (std::min(a.y, b.y) > height || std::max(a.y, b.y) < height) continue;
        const double t = a.y == b.y ? 0 : (height - a.y) / (b.y - a.y);
        for (const double x : {a.x + t * (b.x - a.x), a.y == b.y ? b.x : a.x + t * (b.x - a.x)})
          least = std::min(least, x), most = std::max(most, x);
      }
      left = std::max(left, least), right = std::min(right, most);
    }
    return left < right ? std::pair(static_cast<int>(std::ceil(left)), static_cast<int>(std::floor(right)))
                        : std::pair(0, 0);
  }

  // The part of a polygon with fx·x + fy·y >= at (or <=).
  static std::vector<Point2> clipped(const std::vector<Point2>& polygon, int fx, int fy, double limit, bool above) {
    std::vector<Point2> out;
    const auto height = [&](Point2 p) { return (above ? 1 : -1) * (fx * p.x + fy * p.y - limit); };
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Point2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
      const double ha = height(a), hb = height(b);
      if (ha >= 0) out.push_back(a);
      if ((ha > 0 && hb < 0) || (ha < 0 && hb > 0)) {
        const double t = ha / (ha - hb);
        out.push_back({a.x + t * (b.x - a.x), a.y + t * (b.y - a.y)});
      }
    }
    return out;
  }
  static double size(const std::vector<Point2>& polygon) {
    double twice = 0;
    for (std::size_t i = 0; i < polygon.size(); ++i) {
      const Point2 a = polygon[i], b = polygon[(i + 1) % polygon.size()];
      twice += (a.x - polygon[0].x) * (b.y - polygon[0].y) - (b.x - polygon[0].x) * (a.y - polygon[0].y);
    }
    return std::abs(twice) / 2;
  }

  int x0_, y0_, x1_, y1_;
  std::vector<float> cover_;
};

struct Extent {
  double left = INFINITY, top = INFINITY, right = -INFINITY, bottom = -INFINITY;
  void include(Point2 p, double margin) {
    left = std::min(left, p.x - margin), right = std::max(right, p.x + margin);
    top = std::min(top, p.y - margin), bottom = std::max(bottom, p.y + margin);
  }
};

// Words as the lines that they are painted with.
Drawing::Shape as_lines(const Drawing::Shape& text) {
  Drawing::Shape lines;
  lines.ink = text.ink;
  lines.size = stroke_width(text.size);
  lines.paths = strokes(text.words, text.size);
  const double width = text_width(text.words, text.size);
  const double shift = text.anchor == Anchor::start ? 0 : text.anchor == Anchor::middle ? -width / 2 : -width;
  const Point2 at = text.paths[0][0];
  for (auto& path : lines.paths)
    for (Point2& p : path) {
      p.x += shift;
      p = text.upwards ? Point2{at.x + p.y, at.y - p.x} : Point2{at.x + p.x, at.y + p.y};
    }
  return lines;
}

void paint(const Drawing::Shape& shape, const Context& context, Image& image) {
  using Kind = Drawing::Shape::Kind;
  if (shape.kind == Kind::text) return paint(as_lines(shape), context, image);
  Extent extent;
  for (const auto& path : shape.paths)
    for (const Point2 p : path) extent.include(p, shape.size / 2 + 1);
  for (const auto& ring : shape.rings) extent.include(ring.centre, ring.radius + shape.size / 2 + 1);
  if (!(extent.left < extent.right)) return;
  Mask mask(image, extent.left, extent.top, extent.right, extent.bottom);
  for (const auto& path : shape.paths) {
    context.throw_if_cancelled();
    if (shape.kind == Kind::areas) {
      if (path.size() >= 3) mask.area(path);
    } else if (path.size() == 1) {
      mask.stroke(path[0], path[0], shape.size);
    } else {
      for (std::size_t i = 1; i < path.size(); ++i) mask.stroke(path[i - 1], path[i], shape.size);
    }
  }
  for (const auto& ring : shape.rings) {
    context.throw_if_cancelled();
    if (shape.kind == Kind::discs) {
      mask.disc(ring.centre, ring.radius);
    } else {
      mask.ring(ring.centre, ring.radius, shape.size);
    }
  }
  mask.blend(shape.ink, context, image);
}

// The shortest text with two decimals.
std::string number(double v) { return text_of(std::round(v * 100) / 100); }

std::string escaped(std::string_view words) {
  std::string out;
  for (const char c : words) {
    if (c == '&') {
      out += "&amp;";
    } else if (c == '<') {
      out += "&lt;";
    } else if (c == '>') {
      out += "&gt;";
    } else if (static_cast<unsigned char>(c) >= 0x20) {
      out += c;
    }
  }
  return out;
}

std::string base64(std::string_view bytes) {
  std::string out(4 * ((bytes.size() + 2) / 3) + 1, '\0');  // OpenSSL adds a zero byte
  EVP_EncodeBlock(reinterpret_cast<unsigned char*>(out.data()), reinterpret_cast<const unsigned char*>(bytes.data()),
                  static_cast<int>(bytes.size()));
  out.pop_back();
  return out;
}

std::string colour(Ink ink, const char* what) {
  constexpr std::string_view kHex = "0123456789abcdef";
  std::string out = std::string(" ") + what + "=\"#";
  for (const std::uint8_t c : {ink.red, ink.green, ink.blue}) out += {kHex[c >> 4], kHex[c & 15]};
  out += '"';
  if (ink.opacity < 1) out += std::string(" ") + what + "-opacity=\"" + number(ink.opacity) + '"';
  return out;
}

std::string path_data(const std::vector<std::vector<Point2>>& paths, bool closed, const Context& context) {
  std::string out;
  for (const auto& path : paths) {
    context.throw_if_cancelled();
    for (std::size_t i = 0; i < path.size(); ++i)
      out += (i == 0 ? "M" : "L") + number(path[i].x) + ' ' + number(path[i].y);
    if (closed || path.size() == 1) out += 'Z';
  }
  return out;
}

std::string svg_of(const std::vector<Drawing::Ring>& rings, const Context& context) {
  std::string out;
  for (const auto& [c, r] : rings) {
    context.throw_if_cancelled();
    out += "<circle cx=\"" + number(c.x) + "\" cy=\"" + number(c.y) + "\" r=\"" + number(r) + "\"/>\n";
  }
  return out;
}

std::string svg_of(const Drawing::Shape& shape, const Context& context) {
  using Kind = Drawing::Shape::Kind;
  switch (shape.kind) {
    case Kind::lines:
      return "<path d=\"" + path_data(shape.paths, false, context) + "\" fill=\"none\" stroke-width=\"" +
             number(shape.size) + "\" stroke-linecap=\"round\" stroke-linejoin=\"round\"" +
             colour(shape.ink, "stroke") + "/>\n";
    case Kind::areas:
      return "<path d=\"" + path_data(shape.paths, true, context) + '"' + colour(shape.ink, "fill") + "/>\n";
    case Kind::circles:
      return "<g fill=\"none\" stroke-width=\"" + number(shape.size) + '"' + colour(shape.ink, "stroke") + ">\n" +
             svg_of(shape.rings, context) + "</g>\n";
    case Kind::discs: return "<g" + colour(shape.ink, "fill") + ">\n" + svg_of(shape.rings, context) + "</g>\n";
    case Kind::text: break;
  }
  const Point2 at = shape.paths[0][0];
  const char* anchor = shape.anchor == Anchor::start ? "start" : shape.anchor == Anchor::middle ? "middle" : "end";
  // A capital is about 0.72 of the font's size high.
  std::string out = "<text x=\"" + number(at.x) + "\" y=\"" + number(at.y) + "\" font-size=\"" +
                    number(shape.size / 0.72) + "\" text-anchor=\"" + anchor + '"' + colour(shape.ink, "fill");
  if (shape.upwards) out += " transform=\"rotate(-90 " + number(at.x) + ' ' + number(at.y) + ")\"";
  return out + '>' + escaped(shape.words) + "</text>\n";
}

}  // namespace

Ink ink_of(Colour colour, double opacity) { return {to_srgb(colour.x), to_srgb(colour.y), to_srgb(colour.z), opacity}; }

void Drawing::lines(std::vector<std::vector<Point2>> polylines, double width, Ink ink) {
  shapes_.push_back({.kind = Shape::Kind::lines, .paths = std::move(polylines), .size = width, .ink = ink});
}
void Drawing::areas(std::vector<std::vector<Point2>> polygons, Ink ink) {
  shapes_.push_back({.kind = Shape::Kind::areas, .paths = std::move(polygons), .ink = ink});
}
void Drawing::rectangle(double x, double y, double width, double height, Ink ink) {
  areas({{{x, y}, {x + width, y}, {x + width, y + height}, {x, y + height}}}, ink);
}
void Drawing::circles(std::vector<Ring> rings, double width, Ink ink) {
  shapes_.push_back({.kind = Shape::Kind::circles, .rings = std::move(rings), .size = width, .ink = ink});
}
void Drawing::discs(std::vector<Ring> discs, Ink ink) {
  shapes_.push_back({.kind = Shape::Kind::discs, .rings = std::move(discs), .ink = ink});
}
void Drawing::text(Point2 at, double size, Anchor anchor, std::string_view words, Ink ink) {
  shapes_.push_back({.kind = Shape::Kind::text,
                     .paths = {{at}},
                     .words = std::string(words),
                     .anchor = anchor,
                     .size = size,
                     .ink = ink});
}
void Drawing::text_upwards(Point2 at, double size, Anchor anchor, std::string_view words, Ink ink) {
  text(at, size, anchor, words, ink);
  shapes_.back().upwards = true;
}
void Drawing::add(const Drawing& other, double x, double y) {
  for (Shape shape : other.shapes_) {
    for (auto& path : shape.paths)
      for (Point2& p : path) p = {p.x + x, p.y + y};
    for (Ring& ring : shape.rings) ring.centre = {ring.centre.x + x, ring.centre.y + y};
    shapes_.push_back(std::move(shape));
  }
}

void paint(const Drawing& drawing, Image& image, const Context& context) {
  for (const Drawing::Shape& shape : drawing.shapes()) paint(shape, context, image);
}

std::string to_svg(const Drawing& drawing, std::string_view png, const Context& context) {
  const std::string width = std::to_string(drawing.width()), height = std::to_string(drawing.height());
  std::string out = "<svg xmlns=\"http://www.w3.org/2000/svg\" width=\"" + width + "\" height=\"" + height +
                    "\" viewBox=\"0 0 " + width + ' ' + height +
                    "\" font-family=\"sans-serif\">\n<rect width=\"100%\" height=\"100%\" fill=\"#ffffff\"/>\n";
  if (!png.empty())
    out += "<image width=\"" + width + "\" height=\"" + height +
           "\" style=\"image-rendering:pixelated\" href=\"data:image/png;base64," + base64(png) + "\"/>\n";
  for (const Drawing::Shape& shape : drawing.shapes()) out += svg_of(shape, context);
  return out + "</svg>\n";
}

}  // namespace spherule
