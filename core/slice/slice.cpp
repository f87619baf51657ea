// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/slice/slice.h"

#include <algorithm>
#include <cmath>
#include <cstring>
#include <string>

#include "core/base/check.h"
#include "core/base/poll.h"
#include "core/boundary.h"
#include "core/interpolated_object.h"
#include "core/predicates.h"

namespace spherule {

Volume slice_of(const Volume& volume, int axis, std::int32_t index) {
  SPHERULE_CHECK(axis >= 0 && axis < 3);
  const std::array<std::size_t, 3> axes{axis == 0 ? 1U : 0U, axis == 2 ? 1U : 2U, static_cast<std::size_t>(axis)};
  const Grid& whole = volume.grid;
  if (index < 0 || index >= whole.dims[axes[2]]) {
    throw Error(ErrorCode::not_found, "There is no such slice; along this axis the volume has slices 0 to " +
                                          std::to_string(whole.dims[axes[2]] - 1) + ".");
  }
  Volume slice;
  slice.type = volume.type;
  slice.slope = volume.slope;
  slice.intercept = volume.intercept;
  slice.natural_side = volume.natural_side;
  slice.format = volume.format;
  Vec3 corner;
  corner[axis] = index * whole.spacing[axis];
  slice.grid.origin = whole.to_patient(corner);
  slice.grid.dims = {whole.dims[axes[0]], whole.dims[axes[1]], 1};
  // How thick a slice is does not matter to what is in it, and must not coarsen its lattice.
  slice.grid.spacing = {whole.spacing[static_cast<int>(axes[0])], whole.spacing[static_cast<int>(axes[1])],
                        whole.spacing[static_cast<int>(axes[0])]};
  slice.grid.direction = whole.direction;
  for (Vec3& row : slice.grid.direction.rows) {
    const Vec3 old = row;
    row = {old[static_cast<int>(axes[0])], old[static_cast<int>(axes[1])], old[axis]};
  }
  const std::size_t size = bytes_per_voxel(volume.type);
  const std::array<std::size_t, 3> stride{
      size, size * static_cast<std::size_t>(whole.dims[0]),
      size * static_cast<std::size_t>(whole.dims[0]) * static_cast<std::size_t>(whole.dims[1])};
  slice.voxels.resize(slice.grid.sample_count() * size);
  std::byte* to = slice.voxels.data();
  for (std::int32_t y = 0; y < slice.grid.dims[1]; ++y)
    for (std::int32_t x = 0; x < slice.grid.dims[0]; ++x, to += size) {
      const std::size_t from = static_cast<std::size_t>(x) * stride[axes[0]] +
                               static_cast<std::size_t>(y) * stride[axes[1]] +
                               static_cast<std::size_t>(index) * stride[axes[2]];
      std::memcpy(to, volume.voxels.data() + from, size);
    }
  return slice;
}

namespace {

// Which point, if any, lies on each grid edge of a slice, the edges beyond its border included.
class EdgePoints {
 public:
  struct Points {
    std::uint32_t first = 0;
    std::uint32_t count = 0;  // 2 where a range is jumped over: `first` and the next, ascending along the edge
  };

  EdgePoints(const Lattice& lattice, std::span<const LatticePoint> points)
      : width_(static_cast<std::size_t>(lattice.grid.dims[0]) + 2) {
    for (auto& axis : edges_) axis.resize(width_ * (static_cast<std::size_t>(lattice.grid.dims[1]) + 2));
    for (std::uint32_t p = 0; p < points.size(); ++p) {
      const auto [x, x_on_plane] = plane_below(lattice.planes[0], points[p].x);
      const auto [y, y_on_plane] = plane_below(lattice.planes[1], points[p].y);
      SPHERULE_CHECK(x_on_plane != y_on_plane);
      Points& edge = edges_[x_on_plane ? 1 : 0][y * width_ + x];
      if (edge.count++ == 0) edge.first = p;
    }
  }
  // Of the edge from sample (x, y) to the next one along `axis`.
  Points along(std::size_t axis, std::int32_t x, std::int32_t y) const {
    return edges_[axis][static_cast<std::size_t>(y + 1) * width_ + static_cast<std::size_t>(x + 1)];
  }

 private:
  static std::pair<std::size_t, bool> plane_below(const std::vector<std::int32_t>& planes, std::int32_t at) {
    const auto above = std::ranges::upper_bound(planes, at);
    return {static_cast<std::size_t>(above - planes.begin()) - 1, above[-1] == at};
  }

  std::size_t width_;
  std::array<std::vector<Points>, 2> edges_;
};

// Marching squares on the bits of a slice, through its boundary points.
class Outline {
 public:
  Outline(const Volume& slice, const ObjectRule& rule, const SampleBits& inside, const Lattice& lattice,
          std::span<const LatticePoint> points)
      : slice_(slice), rule_(rule), inside_(inside), edges_(lattice, points) {}

  std::vector<std::array<std::uint32_t, 2>> edges(const Context& context) {
    Poll poll(context);
    for (std::int32_t y = -1; y < slice_.grid.dims[1]; ++y) {
      for (std::int32_t x = -1; x < slice_.grid.dims[0]; ++x) poll(4), march(x, y);
    }
    return std::move(contour_);
  }

 private:
  struct Crossing {
    std::uint32_t point;
    bool leaves;  // the object, on the way round the cell
  };

  // The cell with its lowest corner at sample (x, y), walked around from x to y.
  void march(std::int32_t x, std::int32_t y) {
    const std::array<std::array<std::int32_t, 2>, 4> corners{{{x, y}, {x + 1, y}, {x + 1, y + 1}, {x, y + 1}}};
    crossings_.clear();
    bool jumped = false;
    for (std::size_t e = 0; e < 4; ++e) {
      const bool along_y = e == 1 || e == 3, back = e >= 2;
      const auto [first, count] = edges_.along(along_y ? 1 : 0, e == 1 ? x + 1 : x, e == 2 ? y + 1 : y);
      bool in = inside_.test_or_outside(corners[e][0], corners[e][1], 0);
      for (std::uint32_t c = 0; c < count; ++c, in = !in)
        crossings_.push_back({back ? first + count - 1 - c : first + c, in});
      jumped |= count > 1;
    }
    if (crossings_.empty()) return;
    // Two crossings are joined either way.
    const bool together = crossings_.size() > 2 && object_is_joined(corners, jumped);
    for (std::size_t c = 0; c < crossings_.size(); ++c) {
      const Crossing here = crossings_[c], next = crossings_[(c + 1) % crossings_.size()];
      if (together && here.leaves) contour_.push_back({here.point, next.point});
      if (!together && !here.leaves) contour_.push_back({next.point, here.point});
    }
  }

  // Whether the object's parts on the rim of a cell with four crossings or more are one part inside it.
  bool object_is_joined(const std::array<std::array<std::int32_t, 2>, 4>& corners, bool jumped) const {
    if (rule_.kind == ObjectRule::Kind::labels) return true;
    // Where a value is not finite nothing says that the object goes on between.
    for (const auto& [x, y] : corners) {
      const bool known = x >= 0 && y >= 0 && x < slice_.grid.dims[0] && y < slice_.grid.dims[1];
      if (known && !std::isfinite(value_at(slice_, x, y, 0))) return false;
    }
    const bool range_is_joined = jumped || range_holds_saddle(corners);
    return range_is_joined == (rule_.side == Side::above);
  }
  // Of the values within [lo, hi], without jumps.
  bool range_holds_saddle(const std::array<std::array<std::int32_t, 2>, 4>& corners) const {
    const double hi = rule_.kind == ObjectRule::Kind::range ? rule_.hi : INFINITY;
    std::array<double, 4> v;
    for (std::size_t c = 0; c < 4; ++c) v[c] = value_at(slice_, corners[c][0], corners[c][1], 0);
    const auto within = [&](double value) { return value >= rule_.lo && value <= hi; };
    if (!within(v[0])) v = {v[1], v[2], v[3], v[0]};
    // The two that are outside the range; between one below and one above it the range runs through.
    if ((v[1] > hi) != (v[3] > hi)) return true;
    const double iso = v[1] > hi ? hi : rule_.lo;
    return (v[0] - iso) * (v[2] - iso) >= (v[1] - iso) * (v[3] - iso);
  }

  const Volume& slice_;
  const ObjectRule& rule_;
  const SampleBits& inside_;
  EdgePoints edges_;
  std::vector<Crossing> crossings_;
  std::vector<std::array<std::uint32_t, 2>> contour_;
};

// Circumcentre minus the first corner, in lattice units. Numerators and denominator are exact integers below 2^76, each
// rounded once and divided: a relative error below 3 · 2^-53, whatever the shape of the triangle.
Vec3 centre_offset(exact::Difference b, exact::Difference c) {
  const exact::Wide bb = b.x * b.x + b.y * b.y, cc = c.x * c.x + c.y * c.y;
  const double twice = 2 * static_cast<double>(b.x * c.y - b.y * c.x);
  return {static_cast<double>(bb * c.y - cc * b.y) / twice, static_cast<double>(cc * b.x - bb * c.x) / twice, 0};
}

Vec3 to_vec3(exact::Difference d) {
  return {static_cast<double>(d.x), static_cast<double>(d.y), static_cast<double>(d.z)};
}

// In lattice units; the radius is the least distance to a corner.
Sphere circumcircle(LatticePoint a, LatticePoint b, LatticePoint c) {
  using exact::operator-;
  const Vec3 offset = centre_offset(b - a, c - a);
  const double least = std::min({norm(offset), norm(offset - to_vec3(b - a)), norm(offset - to_vec3(c - a))});
  return {Vec3{double(a.x), double(a.y), double(a.z)} + offset, least};
}

// How far off, in lattice units, a centre within the lattice is at most.
constexpr double kCentreError = 0x1p-20;

}  // namespace

PlaneModel build_plane_model(const Volume& slice, const ObjectRule& rule, std::size_t max_points,
                             const Context& context) {
  SPHERULE_CHECK(slice.grid.dims[2] == 1);
  const InsideSamples samples = classify_samples(slice, rule, context);
  BoundaryPoints boundary = extract_boundary(slice, rule, samples, max_points, context);
  PlaneModel model;
  model.lattice = std::move(boundary.lattice);
  model.points = std::move(boundary.points);
  // A closed border also cuts the slice off from what is beside it.
  std::erase_if(model.points, [&](LatticePoint p) { return p.z != model.lattice.plane(2, 0); });
  model.inside_samples = samples.inside.count();
  model.contour = Outline(slice, rule, samples.inside, model.lattice, model.points).edges(context);
  model.triangles = triangulate(model.points, context);

  const InterpolatedObject object(slice, rule, samples.inside, model.lattice);
  const auto& points = model.points;
  Poll poll(context);
  const auto inside = [&](const PlaneTriangle& t) {
    poll(32);
    const LatticePoint a = points[t[0]], b = points[t[1]], c = points[t[2]];
    return object.has_ball(circumcircle(a, b, c).centre, kCentreError,
                           [&](LatticePoint sample) { return exact::in_circle(a, b, c, sample) > 0; });
  };
  model.inside_count = static_cast<std::size_t>(std::ranges::stable_partition(model.triangles, inside).begin() -
                                                model.triangles.begin());
  context.throw_if_cancelled();
  exact::Wide area = 0;
  for (const auto& [p, q, r] : std::span(model.triangles).first(model.inside_count)) {
    poll(8);
    const Sphere circle = circumcircle(points[p], points[q], points[r]);
    model.circles.push_back({model.lattice.to_patient(circle.centre), model.lattice.unit_mm * circle.radius});
    area += exact::two_areas(points[p], points[q], points[r]);
  }
  model.area_mm2 = 0.5 * static_cast<double>(area) * model.lattice.unit_mm * model.lattice.unit_mm;
  return model;
}

}  // namespace spherule
