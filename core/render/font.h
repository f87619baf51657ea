// SPDX-License-Identifier: GPL-3.0-or-later
//
// A small font of strokes: digits, Latin letters, and what units and axes need.
#pragma once

#include <string_view>
#include <vector>

namespace spherule {

/// Pixels from the top left corner, y down; whole numbers are the corners of pixels.
struct Point2 {
  double x = 0, y = 0;
};

/// The strokes of words whose capitals are `size` pixels high, from (0, 0) along x, y down; unknown characters are
/// drawn as a small box.
std::vector<std::vector<Point2>> strokes(std::string_view words, double size);
/// Of a line of strokes, in pixels.
double stroke_width(double size);
/// Of painted words, in pixels.
double text_width(std::string_view words, double size);

}  // namespace spherule
