// SPDX-License-Identifier: GPL-3.0-or-later
//
// Figures of numbers: a title, two axes with units, and what lies between.
#pragma once

#include <string>
#include <vector>

#include "core/measure/solid.h"
#include "core/render/drawing.h"

namespace spherule {

struct PlotAxis {
  std::string title;
  std::string unit{};  ///< empty: a plain number
  bool logarithmic = false;
};

/// Heights over steps of a number: step i is the i-th of heights.size() equal parts of [lo, hi] (equal ratios where x
/// is logarithmic; lo is above 0 then).
struct Plot {
  std::string title;
  PlotAxis x, y;
  double lo = 0, hi = 1;
  std::vector<double> heights;  ///< 0 or more; where y is logarithmic nothing is drawn for 0
  bool line = false;            ///< joins the middles of the steps' tops instead of drawing bars
  /// Numbers of x worth a line across and a word; those beyond [lo, hi] are left out.
  struct Mark {
    double at = 0;
    std::string word{};  ///< empty: the number
  };
  std::vector<Mark> marks{};
};

/// In dark ink, for white paper. Both sizes 1 … 8192 pixels; what does not fit overlaps.
Drawing draw_plot(const Plot& plot, int width, int height);

/// As PNG bytes, on white.
std::string plot_to_png(const Plot& plot, int width, int height);

/// Values of a volume, on a logarithmic axis of counts: the background's would hide all others.
Plot plot_of_values(ValueRange range, const std::vector<std::uint64_t>& counts);
/// The size of the object that each threshold defines: how much of the volume has values no less than it.
Plot plot_of_thresholds(ValueRange range, const std::vector<std::uint64_t>& counts, double voxel_mm3);
/// The paper's histogram of radii.
Plot plot_of_radii(const RadiusHistogram& histogram);

}  // namespace spherule
