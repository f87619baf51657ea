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

/// The side of the patient that the viewer stands on and looks from. Pictures are never mirrored, so left and right
/// follow: from the front the patient's right is on the picture's left, as a radiologist reads a film.
///   letter     viewer looks to   picture's up   picture's right
///   a front    posterior         head           patient's left
///   p back     anterior          head           patient's right
///   r right    left              head           anterior
///   l left     right             head           posterior
///   h above    foot              anterior       patient's right
///   f below    head              anterior       patient's left (as axial slices are read)
enum class View : char { anterior = 'a', posterior = 'p', right = 'r', left = 'l', head = 'h', foot = 'f' };

/// What stands behind the object.
enum class Background : std::uint8_t {
  transparent,  ///< alpha 0; edges have partial alpha, colours are not premultiplied
  white,
  dark,  ///< a neutral near-black
};

struct RenderOptions {
  int width = 800, height = 800;  ///< pixels; each 1 … 8192
  View view = View::anterior;     ///< orthographic, the object fitted into the picture with a margin
  int samples_per_axis = 3;       ///< antialiasing: n x n rays a pixel; 1 … 8. Also the quality of soft shadows
  Background background = Background::transparent;
};

/// 8-bit sRGB with alpha, row-major from the top left, 4 bytes a pixel.
struct Image {
  int width = 0, height = 0;
  std::vector<std::uint8_t> rgba;
};

/// An orthographic camera in the patient's frame. The axes are unit vectors, right × up = -forward.
struct Camera {
  Vec3 right, up, forward;
  Vec3 centre;              ///< LPS mm; shown in the middle of the picture
  double mm_per_pixel = 1;  ///< the same along both axes
};

/// The camera that render_spheres uses: `box` (mm, not empty) centred, with a margin of at least 4 % of each side.
Camera fit_camera(const Box& box, const RenderOptions& options);

/// Ray-traces the union of the model's balls: one matt material, a soft key light from the upper left and a bright
/// sky, both with true shadows. The camera fits the box of all balls. The same bytes for every thread count.
/// Throws invalid_argument for options outside their ranges (one field error each), unusable when no ball has a radius
/// above 0. Reports stage "render" by tiles; cancelled within tens of ms. Only the exposed part of each ball is traced
/// (patches.h), so raw models of millions of balls cost little more than a few.
Image render_spheres(const SphereModel& model, const RenderOptions& options = {}, const Context& context = {});

/// PNG bytes, 8 bits a channel, sRGB, no metadata that changes from run to run.
std::string encode_png(const Image& image);

}  // namespace spherule
