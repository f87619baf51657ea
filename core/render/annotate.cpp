// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/annotate.h"

#include <algorithm>
#include <array>
#include <cmath>

#include "core/base/elementary.h"
#include "core/render/font.h"
#include "core/render/ticks.h"

namespace spherule {
namespace {

constexpr Ink kDark{38, 42, 51}, kLight{232, 234, 238}, kHalo{255, 255, 255, 0.75};

}  // namespace

Notes::Notes(int width, int height, Background background)
    : drawing_(width, height),
      size_(std::clamp(0.0165 * std::min(width, height), 7.0, 40.0)),
      margin_(1.6 * size_),
      ink_(background == Background::dark ? kLight : kDark),
      halo_(background == Background::transparent) {}

void Notes::stroke(Point2 a, Point2 b, double width, Ink ink) {
  if (halo_) drawing_.line(a, b, width + 3, kHalo);
  drawing_.line(a, b, width, ink);
}

// A transparent picture may be laid on anything, so its words bring a light ground with them.
void Notes::words(Point2 at, Anchor anchor, std::string_view words, Ink ink) {
  if (halo_) {
    const double width = text_width(words, size_);
    const double left = anchor == Anchor::start ? at.x : anchor == Anchor::middle ? at.x - width / 2 : at.x - width;
    const double pad = 0.45 * size_;
    drawing_.rectangle(left - pad, at.y - size_ - pad, width + 2 * pad, size_ + 2 * pad, kHalo);
  }
  drawing_.text(at, size_, anchor, words, ink);
}

void Notes::legend(const Legend& legend) {
  const auto values = legend.logarithmic ? log_ticks(legend.lo, legend.hi) : ticks(legend.lo, legend.hi, 6);
  const double height = std::round(0.42 * drawing_.height()), width = std::round(1.3 * size_);
  const double x = drawing_.width() - legend_width(legend) + size_,
               top = std::round(0.5 * (drawing_.height() - height));
  if (halo_) drawing_.rectangle(x - 2, top - 2, width + 4, height + 4, kHalo);
  const int steps = static_cast<int>(height);
  for (int i = 0; i < steps; ++i)
    drawing_.rectangle(x, top + i, width, 1, ink_of(legend.map->at(1 - (i + 0.5) / steps)));
  for (const double value : values) {
    const double t = legend.logarithmic ? elementary::log(value / legend.lo) / elementary::log(legend.hi / legend.lo)
                                        : (value - legend.lo) / (legend.hi - legend.lo);
    const double y = top + (1 - t) * height;
    drawing_.line({x + width, y}, {x + width + 0.35 * size_, y}, stroke_width(size_), ink_);
    words({x + width + 0.8 * size_, y + 0.5 * size_}, Anchor::start, label(value), ink_);
  }
  words({x, top - 3 * size_}, Anchor::start, legend.title, ink_);
  words({x, top - 1.2 * size_}, Anchor::start, legend.unit, ink_);
}

int Notes::legend_width(const Legend& legend) const {
  const auto values = legend.logarithmic ? log_ticks(legend.lo, legend.hi) : ticks(legend.lo, legend.hi, 6);
  double widest = std::max(text_width(legend.title, size_), text_width(legend.unit, size_));
  for (const double value : values) widest = std::max(widest, 2.1 * size_ + text_width(label(value), size_));
  return static_cast<int>(std::ceil(size_ + widest + margin_));
}

void Notes::scale_bar(const Camera& camera) {
  // A round length that takes between a tenth and a quarter of the width.
  const double length = round_step(0.1 * drawing_.width() * camera.mm_per_pixel);
  const double pixels = length / camera.mm_per_pixel, y = drawing_.height() - margin_, thick = 0.22 * size_;
  const double x = margin_;
  stroke({x, y}, {x + pixels, y}, thick, ink_);
  for (const double end : {x, x + pixels}) drawing_.line({end, y - 0.4 * size_}, {end, y + 0.4 * size_}, thick, ink_);
  const std::string text = label(length) + (camera.projection == Projection::perspective ? " mm at the middle" : " mm");
  words({x + 0.5 * std::max(pixels, text_width(text, size_)), y - 0.8 * size_}, Anchor::middle, text, ink_);
}

void Notes::orientation(const Camera& camera) {
  struct Axis {
    Vec3 direction;
    const char* letter;
    Ink ink;
  };
  std::array<Axis, 3> axes{
      {{{1, 0, 0}, "L", {196, 62, 54}}, {{0, 1, 0}, "P", {62, 146, 70}}, {{0, 0, 1}, "H", {52, 104, 200}}}};
  // The axis that points away from the viewer first.
  std::ranges::stable_sort(axes, std::ranges::greater{},
                           [&](const Axis& a) { return dot(a.direction, camera.forward); });
  const double reach = 3.4 * size_;
  const Point2 root{drawing_.width() - margin_ - reach - size_, drawing_.height() - margin_ - reach - size_};
  if (halo_) drawing_.discs({{root, reach + 1.8 * size_}}, {255, 255, 255, 0.5});
  for (const Axis& axis : axes) {
    const double x = dot(axis.direction, camera.right), y = -dot(axis.direction, camera.up);
    const double length = elementary::hypot(x, y);
    const Point2 tip{root.x + reach * x, root.y + reach * y};
    if (length < 0.2) {
      // Seen end on: a dot towards the viewer, a ring away from them.
      const bool near = dot(axis.direction, camera.forward) < 0;
      if (near) {
        drawing_.discs({{root, 0.55 * size_}}, axis.ink);
      } else {
        drawing_.circles({{root, 0.5 * size_}}, 0.2 * size_, axis.ink);
      }
      drawing_.text({root.x - 1.1 * size_, root.y + 1.5 * size_}, size_, Anchor::middle, axis.letter, axis.ink);
      continue;
    }
    drawing_.line(root, tip, 0.28 * size_, axis.ink);
    const Point2 u{x / length, y / length};
    drawing_.areas(
        {{{tip.x + 0.55 * size_ * u.x, tip.y + 0.55 * size_ * u.y},
          {tip.x - 0.35 * size_ * u.x - 0.42 * size_ * u.y, tip.y - 0.35 * size_ * u.y + 0.42 * size_ * u.x},
          {tip.x - 0.35 * size_ * u.x + 0.42 * size_ * u.y, tip.y - 0.35 * size_ * u.y - 0.42 * size_ * u.x}}},
        axis.ink);
    drawing_.text({tip.x + 1.35 * size_ * u.x, tip.y + 1.35 * size_ * u.y + 0.5 * size_}, size_, Anchor::middle,
                  axis.letter, axis.ink);
  }
}

void Notes::caption(std::string_view text) { words({margin_, margin_ + size_}, Anchor::start, text, ink_); }

}  // namespace spherule
