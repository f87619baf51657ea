// SPDX-License-Identifier: GPL-3.0-or-later
//
// Lines, areas and words over a picture, or as a picture of their own: painted in pixels or written as SVG.
#pragma once

#include <array>
#include <cstdint>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/render/colour.h"
#include "core/render/font.h"
#include "core/render/image.h"

namespace spherule {

/// An sRGB colour, 0 … 255 each, and its opacity, 0 … 1.
struct Ink {
  std::uint8_t red = 0, green = 0, blue = 0;
  double opacity = 1;
};
Ink ink_of(Colour colour, double opacity = 1);

enum class Anchor : std::uint8_t { start, middle, end };

/// In the order of drawing.
class Drawing {
 public:
  Drawing(int width, int height) : width_(width), height_(height) {}
  int width() const { return width_; }
  int height() const { return height_; }

  /// Polylines of one ink, with round ends; where they cross, the ink is not doubled.
  void lines(std::vector<std::vector<Point2>> polylines, double width, Ink ink);
  void line(Point2 a, Point2 b, double width, Ink ink) { lines({{a, b}}, width, ink); }
  /// The union of polygons that do not overlap, without seams between them.
  void areas(std::vector<std::vector<Point2>> polygons, Ink ink);
  void rectangle(double x, double y, double width, double height, Ink ink);
  /// Rings of one width of line, in one ink.
  struct Ring {
    Point2 centre;
    double radius = 0;
  };
  void circles(std::vector<Ring> rings, double width, Ink ink);
  void discs(std::vector<Ring> discs, Ink ink);
  /// `size` is the height of a capital in pixels; the anchor is at (x, baseline). UTF-8. `halo` stands behind it.
  void text(Point2 at, double size, Anchor anchor, std::string_view words, Ink ink);
  /// The same, turned to read from below to above.
  void text_upwards(Point2 at, double size, Anchor anchor, std::string_view words, Ink ink);
  /// Everything of `other`, moved by (x, y).
  void add(const Drawing& other, double x, double y);

  struct Shape {
    enum class Kind : std::uint8_t { lines, areas, circles, discs, text } kind = Kind::lines;
    std::vector<std::vector<Point2>> paths{};
    std::vector<Ring> rings{};
    std::string words{};
    Anchor anchor = Anchor::start;
    bool upwards = false;
    double size = 0;  // width of lines, or height of capitals
    Ink ink{};
  };
  const std::vector<Shape>& shapes() const { return shapes_; }

 private:
  int width_, height_;
  std::vector<Shape> shapes_;
};

/// Paints over the picture, antialiased; the same pixels on every machine. O(pixels that are touched), for each shape;
/// 4 bytes for each pixel of the shape's box. Throws cancelled, within tens of ms.
void paint(const Drawing& drawing, Image& image, const Context& context = {});

/// A complete SVG document with a white background. Words are words there, in the reader's sans-serif font. With a
/// picture, that picture (as embedded PNG bytes, of the drawing's size) lies under the drawing. Throws cancelled,
/// within tens of ms.
std::string to_svg(const Drawing& drawing, std::string_view png = {}, const Context& context = {});

}  // namespace spherule
