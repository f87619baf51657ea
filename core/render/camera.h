// SPDX-License-Identifier: GPL-3.0-or-later
//
// From where an object is seen.
#pragma once

#include <cstdint>
#include <optional>
#include <vector>

#include "core/base/error.h"
#include "core/base/geometry.h"

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

enum class Projection : std::uint8_t { orthographic, perspective };

/// Whether a vector that a user gave can be made a unit vector: components within ranges::direction (base/ranges.h),
/// of length at least 1e-9.
bool is_direction(Vec3 v);

/// A place to look from, in LPS mm: coordinates within ranges::place_mm, `up` a direction.
struct Viewpoint {
  Vec3 position;
  std::optional<Vec3> look_at;  ///< shown in the middle of the picture; absent: the middle of the object
  std::optional<Vec3> up;       ///< absent: head, or anterior where the sight line is along the body
  bool operator==(const Viewpoint&) const = default;
};

struct CameraOptions {
  std::optional<Viewpoint> viewpoint;  ///< instead of a view
  /// With a viewpoint: keep its direction alone, and fit the object into the picture. A view is always fitted.
  bool fit = false;
  Projection projection = Projection::orthographic;
  /// Degrees across the shorter side of the picture, 1 … 120. An orthographic camera at a viewpoint shows what a
  /// perspective one shows of the plane through look_at.
  double field_of_view = 25;
  bool operator==(const CameraOptions&) const = default;
};

/// A camera in the patient's frame. The axes are unit vectors, right × up = -forward.
struct Camera {
  Vec3 right, up, forward;
  Vec3 centre;              ///< LPS mm; shown in the middle of the picture
  double mm_per_pixel = 1;  ///< the same along both axes, at the centre
  double distance = 0;      ///< mm from where rays start (perspective: from the eye) to the centre
  Projection projection = Projection::orthographic;

  struct Line {
    Vec3 origin, direction;
  };
  /// What is seen at a place of the picture, given in pixels from its middle, x right and y down.
  Line line_of_sight(double x, double y) const;
  /// The inverse: where in the picture a point is seen, in pixels from its middle; z is its depth in mm, negative
  /// behind the eye.
  Vec3 seen_at(Vec3 point) const;
};

/// What of the options is out of its range (base/ranges.h); empty: nothing.
std::vector<FieldError> camera_faults(const CameraOptions& options);

/// The camera for a picture of width × height pixels of what is in `box` (mm, not empty): of the view, or of the
/// viewpoint if there is one, after the viewer has walked `turn` degrees around the picture's middle to the picture's
/// right. A fitted object has a margin of at least 4 % of each side. Throws invalid_argument for camera_faults(), a
/// viewpoint that looks nowhere (position and look_at are one point, up is along the sight line or zero), and
/// one that has nothing of the box in its picture.
Camera make_camera(const CameraOptions& options, View view, double turn, const Box& box, int width, int height);

}  // namespace spherule
