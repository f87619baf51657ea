// SPDX-License-Identifier: GPL-3.0-or-later
//
// SphereModel -> picture. trace.cpp is the only user of Embree, png.cpp the only user of OpenImageIO.
#pragma once

#include <cstdint>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/spheres.h"

namespace spherule {

/// The side of the patient that the viewer stands on: anterior, posterior, right, left, head, foot.
enum class View : char { anterior = 'a', posterior = 'p', right = 'r', left = 'l', head = 'h', foot = 'f' };

struct RenderOptions {
  int width = 800, height = 800;  ///< pixels; each 1 … 8192
  View view = View::anterior;     ///< orthographic, the object fitted into the picture with a margin
  int samples_per_axis = 3;       ///< antialiasing: n x n rays a pixel; 1 … 8
};

/// 8-bit sRGB with alpha, row-major from the top left, 4 bytes a pixel.
struct Image {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

/// Ray-traces the union of the model's balls, shaded, with ambient occlusion. Throws invalid_argument for sizes outside
/// their ranges, unusable for an empty model. The same bytes for every thread count. Of a raw model only balls of cells
/// with a facet on the boundary are traced: no other can be seen (algorithms §5).
Image render_spheres(const SphereModel& model, const RenderOptions& options = {}, const Context& context = {});

/// PNG bytes, 8 bits a channel, sRGB, no metadata that changes from run to run.
std::string encode_png(const Image& image);

}  // namespace spherule
