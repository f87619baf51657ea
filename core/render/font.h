// SPDX-License-Identifier: GPL-3.0-or-later
//
// A small font of strokes: digits, Latin letters, and what units and axes need. Private to core/render.
#pragma once

#include <string_view>
#include <vector>

#include "core/render/drawing.h"

namespace spherule {

/// The strokes of words whose capitals are `size` pixels high, from (0, 0) along x, y down; unknown characters are
/// drawn as a small box.
std::vector<std::vector<Point2>> strokes(std::string_view words, double size);
/// Of a line of strokes, in pixels.
double stroke_width(double size);

}  // namespace spherule
