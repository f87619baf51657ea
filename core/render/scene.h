// SPDX-License-Identifier: GPL-3.0-or-later
//
// What light falls on, and the picture of it. Private to core/render.
#pragma once

#include <array>
#include <cstdint>
#include <memory>
#include <optional>
#include <span>
#include <string_view>
#include <vector>

#include "core/render/camera.h"
#include "core/render/image.h"
#include "core/render/trace.h"

namespace spherule {

/// What stands behind the object.
enum class Background : std::uint8_t {
  transparent,  ///< alpha 0; edges have partial alpha, colours are not premultiplied
  white,
  dark,      ///< a neutral near-black
  gradient,  ///< a soft grey, lighter below
};

/// One object of a scene: matt, of one colour or a colour for each primitive.
struct Body {
  std::unique_ptr<const Tracer> tracer;
  Colour material;
  std::vector<Colour> table;                 ///< instead of material, if not empty
  const ColourMap* curvature_map = nullptr;  ///< instead of both
  std::array<double, 2> curvature_range{};   ///< ends of that map, 1/mm
  double opacity = 1;                        ///< of its first surface; what is behind shows through it
};

struct Scene {
  static constexpr std::size_t most_bodies = 2;
  std::vector<Body> bodies;       ///< up to most_bodies
  std::optional<HalfSpace> clip;  ///< only what is in it is there; cuts are closed
  std::vector<Sphere> specks;     ///< things that may be smaller than a pixel: looked at with all samples
  bool shadows = true;            ///< of the key light
  bool ambient_occlusion = true;  ///< shadows of the sky
};

struct Exposure {
  int width = 0, height = 0;  ///< pixels
  int samples_per_axis = 3;
  Background background = Background::transparent;
};

/// The light of the scene: a soft key light over the viewer's left shoulder, and a sky that is brighter above. For one
/// surface with this normal: what the unshadowed key light sends, and what the open sky does.
Colour key_light(const Camera& camera, Vec3 normal);
Colour sky_light(const Camera& camera, Vec3 normal);
/// From light to the screen's linear light: a gentle shoulder, so that bright places keep their shape.
Colour tone(Colour light);

/// A picture of the background alone.
Image backdrop(int width, int height, Background background);

/// Takes the picture, in tiles. Each pixel gets one sight line through its middle, one ray to the lamp and a few to the
/// sky; what these find is smoothed over neighbours on one surface (openness.h). Pixels at which what is seen does not
/// change evenly (scene.cpp states the bound) then get n × n sight lines, which share that light. The same bytes for
/// every thread count. A few MiB for each thread. `stage` is reported by tiles, cancelled within tens of ms.
Image shoot(const Scene& scene, const Camera& camera, const Exposure& exposure, std::string_view stage,
            const Context& context);

}  // namespace spherule
