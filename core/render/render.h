// SPDX-License-Identifier: GPL-3.0-or-later
//
// Models -> pictures. The map of this folder:
//   render   what is drawn, from where, in which colours: the one header that others need (with image.h)
//   camera   sight lines;  trace  rays against balls, facets and blobs;  scene  light and pixels;  openness  shadows
//   patches  the visible parts of overlapping balls;  discs  where a plane cuts them
//   colour   light, sRGB and colour maps;  drawing  lines and words, in pixels or SVG
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"
#include "core/render/camera.h"
#include "core/render/image.h"
#include "core/render/patches.h"
#include "core/render/scene.h"
#include "core/spheres.h"

namespace spherule {

struct Mesh;

/// What of a model is drawn.
enum class Style : std::uint8_t {
  spheres,     ///< the union of the balls
  blobs,       ///< the balls blended into each other (blobs.cpp), but for those that others hold (blob_balls.h)
  tetrahedra,  ///< the boundary facets of the inside tetrahedra; raw models only
  surface,     ///< the marching-cubes surface of the same object; needs Subject::surface
  points,      ///< the boundary points, as small balls; raw models only
  centres,     ///< the balls' centres, as small balls
};

/// What colours tell.
enum class ColourBy : std::uint8_t {
  none,
  radius,  ///< of the ball; of facets and points nothing of the kind is known, but of tetrahedra that of their ball
  contribution,  ///< volume of the ball's own part of the union (measure_union), on a logarithmic scale
  component,     ///< which connected piece; the largest has the first colour
  cluster,       ///< which ball: of a simplified model each stands for a cluster
  curvature,     ///< mean curvature of the surface, 1/mm; of a ball the reciprocal of its radius
};

/// How two models share a picture.
enum class Layout : std::uint8_t { beside, overlaid };

struct RenderOptions {
  int width = 800, height = 800;  ///< pixels of each panel; each 1 … 8192
  int samples_per_axis = 3;       ///< antialiasing: n × n rays a pixel at edges; 1 … 8
  Background background = Background::transparent;

  Style style = Style::spheres;
  /// Of blobs: the distance over which balls blend into each other, in medians of the balls' radii; 0 … 4. Below 1e-3,
  /// and where that is less than 2^-24 of the object: spheres.
  double smoothness = 0.5;
  double point_radius_mm = 0;             ///< of points and centres; 0: one that suits the model
  double min_radius_mm = 0;               ///< balls below it are left out (of tetrahedra: cells of such balls)
  std::optional<double> max_radius_mm{};  ///< balls above it are left out
  /// Only balls in these buckets of the histogram of the model's radii, counted from 0; empty: all.
  std::vector<int> buckets{};
  int bucket_count = 40;  ///< of that histogram, equal intervals from the least to the largest radius; 1 … 1024

  /// One panel each, side by side and to one scale; 1 … 6. Not looked at when the camera has a viewpoint.
  std::vector<View> views{View::anterior};
  CameraOptions camera{};
  std::optional<Vec3> clip_normal{};       ///< cuts away what lies on the side that it points to; not zero
  std::optional<double> clip_offset_mm{};  ///< keeps normal · x <= offset, for the normal made unit; absent: the middle
  int turntable = 0;               ///< frames of one turn around the object's up axis, 2 … 360; 0: no animation
  Layout layout = Layout::beside;  ///< of two models

  bool shadows = true;            ///< of the key light
  bool ambient_occlusion = true;  ///< shadows of the sky
  double opacity = 1;             ///< above 0, up to 1: of the surface; of the first model where two are overlaid
  ColourBy colour_by = ColourBy::none;
  std::string colour_map{};                             ///< a name that colour_map() knows; empty: one that suits
  std::optional<std::array<double, 2>> colour_range{};  ///< ends of the colour map; absent: those of 98 % of the balls

  bool legend = true;  ///< where colours are numbers
  bool orientation_marker = false;
  bool scale_bar = false;

  bool operator==(const RenderOptions&) const = default;
};

/// A model, and what of it only its volume knows.
struct Subject {
  const SphereModel* model = nullptr;
  const Mesh* surface = nullptr;                ///< for Style::surface, which is refused without
  std::span<const double> contributions_mm3{};  ///< of each sphere, for ColourBy::contribution; else it is measured
  std::span<const Patch> patches{};             ///< as visible_patches gives them; else they are found
};

/// Ray-traced pictures of one model, or of two: one frame, or those of a turn. Panels of several views lie side by
/// side; two models beside each other take a row each then, else a column. The camera fits the boxes of all balls,
/// whatever is left out or drawn in their place, so that pictures of one model compare. The same bytes for every thread
/// count. Only the exposed part of each ball is traced (patches.h), so raw models of millions of balls cost little more
/// than a few. Memory beside the models and the pictures: about 160 bytes a patch (280 MiB for the 1.8 million patches
/// of a head's 3.25 million balls, by bench_render), of which models that are no tetrahedra have at most 2^19 + 16 a
/// ball; 64 bytes a ball that is drawn; 8 bytes a pixel of a panel; and a few MiB for each thread. Throws
/// invalid_argument for options outside their ranges, with field errors; unusable when there is nothing to draw, when a
/// model lacks what the style or the colours need or is too small for its distance from the origin, or when a
/// perspective camera stands inside.
/// Reports stage "render"; cancelled within tens of ms.
std::vector<Image> render(std::span<const Subject> subjects, const RenderOptions& options = {},
                          const Context& context = {});

/// Throws invalid_argument for options outside their ranges, as render does: before any work.
void check_render_options(const RenderOptions& options);

/// How many pixels such a picture has, over all panels and frames.
std::uint64_t pixels_of(const RenderOptions& options, std::size_t subjects);

}  // namespace spherule
