// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/camera.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numbers>
#include <string>

#include "core/base/elementary.h"
#include "core/base/error.h"
#include "core/base/ranges.h"

namespace spherule {
namespace {

constexpr double kMargin = 0.04;  // of each side of the picture

[[noreturn]] void refuse(const std::vector<FieldError>& faults) {
  throw Error(ErrorCode::invalid_argument, "The camera's " + faults.front().pointer + ' ' + faults.front().detail + '.',
              faults);
}
[[noreturn]] void refuse(const char* field, const std::string& detail) { refuse({{field, detail}}); }

void look(View view, Camera& camera) {
  switch (view) {
    case View::anterior: camera.forward = {0, 1, 0}, camera.up = {0, 0, 1}; break;
    case View::posterior: camera.forward = {0, -1, 0}, camera.up = {0, 0, 1}; break;
    case View::right: camera.forward = {1, 0, 0}, camera.up = {0, 0, 1}; break;
    case View::left: camera.forward = {-1, 0, 0}, camera.up = {0, 0, 1}; break;
    case View::head: camera.forward = {0, 0, -1}, camera.up = {0, -1, 0}; break;
    case View::foot: camera.forward = {0, 0, 1}, camera.up = {0, -1, 0}; break;
  }
}

// Up is made perpendicular to the sight line.
void look(const Viewpoint& viewpoint, Vec3 middle, Camera& camera) {
  camera.centre = viewpoint.look_at.value_or(middle);
  const Vec3 sight = camera.centre - viewpoint.position;
  const double length = norm(sight);
  if (!(length > 1e-9 * (1 + norm(camera.centre)))) refuse("position", "must differ from the point that it looks at");
  camera.forward = (1 / length) * sight;
  camera.distance = length;
  const Vec3 up =
      normalised(viewpoint.up.value_or(std::abs(camera.forward.z) < 0.999 ? Vec3{0, 0, 1} : Vec3{0, -1, 0}));
  const Vec3 across = up - dot(up, camera.forward) * camera.forward;
  if (norm(across) < 1e-6) refuse("up", "must not be along the line of sight");
  camera.up = normalised(across);
}

std::array<Vec3, 8> corners(const Box& box) {
  std::array<Vec3, 8> all;
  for (unsigned c = 0; c < 8; ++c)
    all[c] = {c & 1 ? box.max.x : box.min.x, c & 2 ? box.max.y : box.min.y, c & 4 ? box.max.z : box.min.z};
  return all;
}

// Scale and distance at which the box fills the picture but for the margin.
void fit(const Box& box, int width, int height, double tangent, Camera& camera) {
  camera.centre = 0.5 * (box.min + box.max);
  const double usable = 1 - 2 * kMargin, shorter = std::min(width, height);
  double scale = 0, distance = 0;
  for (const Vec3 corner : corners(box)) {
    const Vec3 v = corner - camera.centre;
    const double x = std::abs(dot(v, camera.right)), y = std::abs(dot(v, camera.up)), z = dot(v, camera.forward);
    scale = std::max({scale, 2 * x / (usable * width), 2 * y / (usable * height)});
    distance = std::max({distance, x * shorter / (usable * width * tangent) - z,
                         y * shorter / (usable * height * tangent) - z, -1.01 * z});
  }
  camera.mm_per_pixel = scale;
  if (camera.projection == Projection::orthographic) return;
  camera.distance = distance;
  camera.mm_per_pixel = 2 * distance * tangent / shorter;
}

// Whether the box may have a part in the picture: false only when all of it is beyond one edge, or behind.
bool sees(const Camera& camera, const Box& box, int width, int height) {
  std::array<bool, 5> all_out{true, true, true, true, true};
  for (const Vec3 corner : corners(box)) {
    const Vec3 v = corner - camera.centre;
    const double depth = dot(v, camera.forward) + camera.distance;
    const double scale = camera.projection == Projection::perspective ? camera.mm_per_pixel * depth / camera.distance
                                                                      : camera.mm_per_pixel;
    const double x = dot(v, camera.right), y = dot(v, camera.up);
    const double half_width = 0.5 * width * scale, half_height = 0.5 * height * scale;
    all_out[0] &= x > half_width, all_out[1] &= x < -half_width;
    all_out[2] &= y > half_height, all_out[3] &= y < -half_height;
    all_out[4] &= camera.projection == Projection::perspective && depth <= 0;
  }
  return std::ranges::none_of(all_out, [](bool out) { return out; });
}

}  // namespace

bool is_direction(Vec3 v) { return all_in(ranges::direction, v) && norm(v) >= 1e-9; }

Camera::Line Camera::line_of_sight(double x, double y) const {
  const Vec3 across = mm_per_pixel * (x * right - y * up);
  if (projection == Projection::orthographic) return {centre + across - distance * forward, forward};
  return {centre - distance * forward, normalised(distance * forward + across)};
}

Vec3 Camera::seen_at(Vec3 point) const {
  const Vec3 v = point - centre;
  const double depth = dot(v, forward) + distance;
  const double scale = projection == Projection::orthographic ? mm_per_pixel : mm_per_pixel * depth / distance;
  return {dot(v, right) / scale, -dot(v, up) / scale, depth};
}

std::vector<FieldError> camera_faults(const CameraOptions& options) {
  std::vector<FieldError> faults;
  const auto need = [&](bool good, const char* field, const std::string& detail) {
    if (!good) faults.push_back({field, detail});
  };
  need(ranges::field_of_view.holds(options.field_of_view), "field_of_view",
       "must be " + ranges::field_of_view.words() + " degrees");
  if (!options.viewpoint) return faults;
  const auto& [position, look_at, up] = *options.viewpoint;
  const std::string place = "must be three numbers " + ranges::place_mm.words() + " mm";
  need(all_in(ranges::place_mm, position), "position", place);
  need(!look_at || all_in(ranges::place_mm, *look_at), "look_at", place);
  need(!up || is_direction(*up), "up", "must be three numbers " + ranges::direction.words() + ", not all near zero");
  return faults;
}

Camera make_camera(const CameraOptions& options, View view, double turn, const Box& box, int width, int height) {
  if (const auto faults = camera_faults(options); !faults.empty()) refuse(faults);
  Camera camera;
  camera.projection = options.projection;
  const Vec3 middle = 0.5 * (box.min + box.max);
  camera.centre = middle;
  if (options.viewpoint) {
    look(*options.viewpoint, middle, camera);
  } else {
    look(view, camera);
  }
  camera.right = cross(camera.forward, camera.up);
  if (turn != 0) {
    const double angle = turn * std::numbers::pi / 180, c = elementary::cos(angle), s = elementary::sin(angle);
    const Vec3 forward = camera.forward;
    camera.forward = c * forward - s * camera.right;
    camera.right = c * camera.right + s * forward;
  }
  const double tangent = elementary::tan(options.field_of_view * std::numbers::pi / 360);
  if (!options.viewpoint || options.fit) {
    fit(box, width, height, tangent, camera);
  } else {
    camera.mm_per_pixel = 2 * camera.distance * tangent / std::min(width, height);
  }
  // Parallel rays start before the whole box, wherever the viewpoint is.
  if (camera.projection == Projection::orthographic)
    camera.distance = norm(box.max - box.min) + norm(middle - camera.centre);
  if (!sees(camera, box, width, height)) refuse("look_at", "must be such that the object is in the picture");
  return camera;
}

}  // namespace spherule
