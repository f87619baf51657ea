// SPDX-License-Identifier: GPL-3.0-or-later
//
// What is written over a picture of a scene. Private to core/render.
#pragma once

#include <string>
#include <string_view>

#include "core/render/camera.h"
#include "core/render/colour.h"
#include "core/render/drawing.h"
#include "core/render/scene.h"

namespace spherule {

/// What the colours of a colour map stand for.
struct Legend {
  std::string title, unit;
  const ColourMap* map = nullptr;
  double lo = 0, hi = 1;
  bool logarithmic = false;
};

/// Notes at the edges of a picture of this size, all of it readable on its background.
class Notes {
 public:
  Notes(int width, int height, Background background);

  /// A bar of colours at the right edge, and how many pixels it needs there.
  void legend(const Legend& legend);
  int legend_width(const Legend& legend) const;
  /// A round number of mm at the lower left; of a perspective picture, in the plane of its middle.
  void scale_bar(const Camera& camera);
  /// The patient's axes at the lower right, towards left, posterior and head.
  void orientation(const Camera& camera);
  /// Words at the upper left.
  void caption(std::string_view words);

  const Drawing& drawing() const { return drawing_; }

 private:
  void stroke(Point2 a, Point2 b, double width, Ink ink);
  void words(Point2 at, Anchor anchor, std::string_view words, Ink ink);

  Drawing drawing_;
  double size_, margin_;
  Ink ink_;
  bool halo_;
};

}  // namespace spherule
