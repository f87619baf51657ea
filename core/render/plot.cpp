// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/plot.h"

#include <algorithm>
#include <cmath>
#include <numeric>

#include "core/base/check.h"
#include "core/base/elementary.h"
#include "core/render/font.h"
#include "core/render/ticks.h"

namespace spherule {
namespace {

constexpr Ink kInk{38, 42, 51}, kGrid{222, 225, 230}, kFill{58, 110, 165}, kMark{214, 93, 24};

std::string words_of(const PlotAxis& axis) {
  return axis.unit.empty() ? axis.title : axis.title + " (" + axis.unit + ")";
}

// One axis in pixels.
class Scale {
 public:
  Scale(double lo, double hi, bool logarithmic, double from, double to)
      : lo_(lo), hi_(hi), logarithmic_(logarithmic), from_(from), to_(to) {}
  double pixel(double value) const {
    const double part =
        logarithmic_ ? elementary::log(value / lo_) / elementary::log(hi_ / lo_) : (value - lo_) / (hi_ - lo_);
    return from_ + part * (to_ - from_);
  }
  double lo() const { return lo_; }

 private:
  double lo_, hi_;
  bool logarithmic_;
  double from_, to_;
};

// Round numbers, no more than fit beside each other.
std::vector<double> ticks_of(const PlotAxis& axis, double lo, double hi, int most) {
  if (!axis.logarithmic) return ticks(lo, hi, most);
  std::vector<double> all = log_ticks(lo, hi);
  const std::size_t step = (all.size() + static_cast<std::size_t>(most) - 1) / static_cast<std::size_t>(most);
  std::vector<double> some;
  for (std::size_t i = 0; i < all.size(); i += step) some.push_back(all[i]);
  return some;
}

std::string tick_words(double value) {
  return value >= 1000 && value < 1e9 && value == std::floor(value) ? with_commas(value) : label(value);
}

// Where a plot has what, in pixels; `size` is that of its letters.
struct Places {
  double size, left, right, top, bottom;
  Scale x, y;
  std::vector<double> y_ticks;

  double gap() const { return 0.8 * size; }
  double thick() const { return std::max(1.0, 0.1 * size); }
};

Places places_of(const Plot& plot, int width, int height) {
  const double size = std::clamp(0.02 * std::min(width, height), 7.0, 40.0), gap = 0.8 * size;
  double most = 0;
  for (const double h : plot.heights) most = std::max(most, h);
  if (!(most > 0)) most = 1;
  // A bar of one is to be seen on a logarithmic axis; numbers below one need their own start.
  double least = 0;
  if (plot.y.logarithmic) {
    least = most;
    for (const double h : plot.heights)
      if (h > 0) least = std::min(least, h);
    least *= 0.5;
  }
  const double top_value = plot.y.logarithmic ? most * elementary::pow(most / least, 0.05) : most * 1.05;
  std::vector<double> y_ticks = ticks_of(plot.y, least, top_value, std::max(2, static_cast<int>(height / (5 * size))));
  double widest = 0;
  for (const double tick : y_ticks) widest = std::max(widest, text_width(tick_words(tick), size));
  const double left = std::ceil(3.2 * size + widest + gap), right = width - std::ceil(2.2 * size);
  const double top = std::ceil(4.2 * size), bottom = height - std::ceil(5.2 * size);
  return {size,
          left,
          right,
          top,
          bottom,
          Scale(plot.lo, plot.hi, plot.x.logarithmic, left, right),
          Scale(least, top_value, plot.y.logarithmic, bottom, top),
          std::move(y_ticks)};
}

void draw_grid(const Places& at, Drawing& drawing) {
  std::vector<std::vector<Point2>> grid;
  for (const double tick : at.y_ticks) {
    const double y = at.y.pixel(tick);
    grid.push_back({{at.left, y}, {at.right, y}});
    drawing.text({at.left - at.gap(), y + 0.5 * at.size}, at.size, Anchor::end, tick_words(tick), kInk);
  }
  drawing.lines(std::move(grid), 1, kGrid);
}

void draw_heights(const Plot& plot, const Places& at, Drawing& drawing) {
  const std::size_t n = plot.heights.size();
  const auto edge = [&](std::size_t i) {  // pixels: steps are equal there on either kind of axis
    return at.left + (at.right - at.left) * static_cast<double>(i) / static_cast<double>(n);
  };
  std::vector<std::vector<Point2>> bars;
  std::vector<Point2> line;
  for (std::size_t i = 0; i < n; ++i) {
    if (!(plot.heights[i] > at.y.lo())) continue;
    const double a = edge(i), b = edge(i + 1), h = at.y.pixel(plot.heights[i]);
    if (plot.line) line.push_back({0.5 * (a + b), h});
    // A hair between bars that are wide enough to be told apart.
    const double hair = b - a >= 6 ? 0.5 : 0;
    bars.push_back({{a + hair, at.bottom}, {a + hair, h}, {b - hair, h}, {b - hair, at.bottom}});
  }
  if (plot.line) {
    drawing.lines({std::move(line)}, std::max(1.5, 0.16 * at.size), kFill);
  } else {
    drawing.areas(std::move(bars), kFill);
  }
}

void draw_axes(const Plot& plot, const Places& at, Drawing& drawing) {
  const double size = at.size, left = at.left, right = at.right, bottom = at.bottom;
  drawing.lines({{{left, at.top}, {left, bottom}}, {{left, bottom}, {right, bottom}}}, at.thick(), kInk);
  const double room = std::max(text_width(tick_words(plot.lo), size), text_width(tick_words(plot.hi), size)) + 3 * size;
  for (const double tick : ticks_of(plot.x, plot.lo, plot.hi, std::max(2, static_cast<int>((right - left) / room)))) {
    const double x = at.x.pixel(tick);
    drawing.line({x, bottom}, {x, bottom + 0.4 * size}, at.thick(), kInk);
    drawing.text({x, bottom + 2 * size}, size, Anchor::middle, tick_words(tick), kInk);
  }
}

void draw_marks(const Plot& plot, const Places& at, Drawing& drawing) {
  const double size = at.size, high = at.top - 0.5 * size, low = at.top + 1.5 * size;
  double last = -INFINITY;
  double row = high;
  for (const Plot::Mark& mark : plot.marks) {
    if (!(mark.at >= plot.lo && mark.at <= plot.hi)) continue;
    const std::string word = mark.word.empty() ? tick_words(mark.at) : mark.word;
    const double x = at.x.pixel(mark.at), half = 0.5 * text_width(word, size);
    drawing.line({x, at.top}, {x, at.bottom}, std::max(1.2, 0.14 * size), kMark);
    // Words that would meet take turns above and below.
    row = x - half < last && row < at.top ? low : high;
    drawing.text({std::clamp(x, at.left + half, std::max(at.left + half, at.right - half)), row}, size, Anchor::middle,
                 word, kMark);
    last = x + half + size;
  }
}

}  // namespace

Drawing draw_plot(const Plot& plot, int width, int height) {
  SPHERULE_CHECK(width > 0 && height > 0 && plot.hi > plot.lo && !(plot.x.logarithmic && !(plot.lo > 0)));
  Drawing drawing(width, height);
  const Places at = places_of(plot, width, height);
  drawing.rectangle(0, 0, width, height, {255, 255, 255});
  draw_grid(at, drawing);
  draw_heights(plot, at, drawing);
  draw_axes(plot, at, drawing);
  draw_marks(plot, at, drawing);
  const double size = at.size;
  drawing.text({0.5 * (at.left + at.right), height - 1.1 * size}, size, Anchor::middle, words_of(plot.x), kInk);
  drawing.text_upwards({2 * size, 0.5 * (at.top + at.bottom)}, size, Anchor::middle, words_of(plot.y), kInk);
  drawing.text({at.left, 2.2 * size}, 1.15 * size, Anchor::start, plot.title, kInk);
  return drawing;
}

std::string plot_to_png(const Plot& plot, int width, int height) {
  Image image = blank_image(width, height);
  paint(draw_plot(plot, width, height), image);
  return encode_png(image);
}

namespace {

// A range that can be drawn: a volume or model may have one value alone.
void set_range(double lo, double hi, Plot& plot) {
  const double pad = hi > lo ? 0 : std::max(0.5, 1e-6 * std::abs(lo));
  plot.lo = lo - pad, plot.hi = hi + pad;
}

}  // namespace

Plot plot_of_values(ValueRange range, const std::vector<std::uint64_t>& counts) {
  Plot plot{.title = "Values of the volume", .x = {"value"}, .y = {"voxels", {}, true}, .heights = {}};
  set_range(range.min, range.max, plot);
  plot.heights.assign(counts.begin(), counts.end());
  return plot;
}

Plot plot_of_thresholds(ValueRange range, const std::vector<std::uint64_t>& counts, double voxel_mm3) {
  Plot plot{.title = "Size of the object by threshold",
            .x = {"threshold"},
            .y = {"volume with values no less", "mm³", true},
            .heights = std::vector<double>(counts.size()),
            .line = true};
  set_range(range.min, range.max, plot);
  std::uint64_t above = 0;
  for (std::size_t i = counts.size(); i-- > 0;) {
    // The values of a step are on both sides of its middle.
    plot.heights[i] = voxel_mm3 * (static_cast<double>(above) + 0.5 * static_cast<double>(counts[i]));
    above += counts[i];
  }
  return plot;
}

Plot plot_of_radii(const RadiusHistogram& histogram) {
  Plot plot{.title = "Radii of the spheres", .x = {"radius", "mm"}, .y = {"spheres"}, .heights = {}};
  // Equal radii of 0 have no logarithm.
  plot.x.logarithmic =
      histogram.scale == RadiusScale::logarithmic && histogram.min_mm > 0 && histogram.max_mm > histogram.min_mm;
  set_range(histogram.min_mm, histogram.max_mm, plot);
  plot.heights.assign(histogram.counts.begin(), histogram.counts.end());
  return plot;
}

}  // namespace spherule
