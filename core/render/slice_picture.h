// SPDX-License-Identifier: GPL-3.0-or-later
//
// A slice of a volume as a picture, the way a radiologist reads it, with an object drawn over it in two dimensions.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/render/drawing.h"
#include "core/slice/slice.h"
#include "core/volume.h"

namespace spherule {

/// Parts of an object that are drawn over its slice.
enum class Overlay : std::uint8_t {
  contour,    ///< its outline
  points,     ///< boundary points
  triangles,  ///< all Delaunay triangles
  inside,     ///< the inside triangles
  circles,    ///< their circumcircles
  centres,    ///< the circles' centres
};

/// Of radiology: values from level - width/2 (black) to level + width/2 (white).
struct Window {
  double width = 1;  ///< within ranges::window (base/ranges.h)
  double level = 0;  ///< within ranges::value
  bool operator==(const Window&) const = default;
};

struct SliceOptions {
  int width = 800, height = 800;   ///< pixels; each 1 … 8192
  std::optional<Window> window{};  ///< absent: usual_window of the whole volume, so that its slices compare
  bool smooth = true;              ///< values change evenly between samples; else each sample is a rectangle
  bool image = true;               ///< else the object is drawn on white paper
  /// Only this part of the slice: x0, y0, x1, y1 in samples along its first and second axis; absent: all of it, with
  /// half a sample around.
  std::optional<std::array<double, 4>> region{};
  std::vector<Overlay> show{
      Overlay::contour};  ///< of an object, if there is one; drawn in the order of the enumeration
  bool letters = true;    ///< of the patient's directions, at the edges
  bool scale_bar = true;
  bool caption = true;  ///< plane, axis, index, window
  bool operator==(const SliceOptions&) const = default;
};

/// Throws invalid_argument, with field errors, for options outside their ranges.
void check_slice_options(const SliceOptions& options);

/// The window between whose ends 99 % of the volume's values lie, and which holds some values in any case. O(n).
Window usual_window(const Volume& volume, const Context& context = {});

/// How a slice lies in the patient, and in a picture: turned and flipped in right angles so that a slice across the
/// body is seen from its feet and the others from the front and from the left: the patient's left (of a slice along
/// the median plane: posterior) is right, and posterior or foot is down. Nothing is mirrored to get there.
struct SlicePlane {
  std::string name;  ///< axial, coronal or sagittal; with "oblique " when more than 15 degrees off
  int across = 0;    ///< axis of the slice that runs along the picture's rows; the other runs along its columns
  bool turn_across = false, turn_down = false;  ///< whether its samples run from right to left, from below to above
  std::string left, right, top,
      bottom;  ///< patient directions at the picture's edges: of L R P A H F, the nearest first
};
SlicePlane plane_of(const Grid& slice);

struct SlicePicture {
  Image image;      ///< the slice on its ground
  Drawing drawing;  ///< what lies over it
};

/// The slice in its true proportions, as large as the picture allows. `slice` is from slice_of(volume, axis, index);
/// `model`, if any, of that slice. Samples that are not numbers are left out. Throws invalid_argument for options
/// outside their ranges; cancelled within tens of ms of drawing the slice.
SlicePicture draw_slice(const Volume& slice, int axis, std::int32_t index, const PlaneModel* model,
                        const Window& window, const SliceOptions& options, const Context& context = {});

}  // namespace spherule
