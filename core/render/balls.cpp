// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls in double precision: raw models have balls a thousand times as large as their visible patch, for which single
// precision gives ragged edges.
#include <algorithm>
#include <cmath>

#include "core/base/vectors.h"
#include "core/render/discs.h"
#include "core/render/trace.h"

namespace spherule {
namespace {

// A patch as rays need it: the ball itself, so that one look into memory answers.
struct Patched {
  double x, y, z, squared_radius;
  std::uint32_t ball;
};

// Meets lanes [begin, end) as Primitives::meet does. The distance of the centre from a ray is taken by subtraction: no
// loss when the ball is large and far.
SPHERULE_VECTORS
std::uint32_t enter(const Patched& p, Lanes& lanes, const int* valid, std::size_t begin, std::size_t end) {
  alignas(64) std::array<double, Lanes::most> distances;
  alignas(64) std::array<std::int32_t, Lanes::most> enters;
  std::int32_t any = 0;
  for (std::size_t k = begin; k < end; ++k) {
    const double x = p.x - lanes.ox[k], y = p.y - lanes.oy[k], z = p.z - lanes.oz[k];
    const double along = x * lanes.dx[k] + y * lanes.dy[k] + z * lanes.dz[k];
    const double ax = x - along * lanes.dx[k], ay = y - along * lanes.dy[k], az = z - along * lanes.dz[k];
    const double half_chord = p.squared_radius - (ax * ax + ay * ay + az * az);
    distances[k] = along - std::sqrt(half_chord > 0 ? half_chord : 0);
    enters[k] = static_cast<std::int32_t>(half_chord > 0) & static_cast<std::int32_t>(distances[k] >= 0) &
                static_cast<std::int32_t>(distances[k] <= lanes.far[k]) & static_cast<std::int32_t>(valid[k] != 0);
    any |= enters[k];
  }
  std::uint32_t met = 0;
  if (any == 0) return met;
  for (std::size_t k = begin; k < end; ++k) {
    if (enters[k] == 0 || (distances[k] == lanes.far[k] && p.ball >= lanes.primitive[k])) continue;
    lanes.far[k] = distances[k];
    lanes.primitive[k] = p.ball;
    met |= 1U << k;
  }
  return met;
}

class Balls final : public Tracer, private Primitives {
 public:
  Balls(std::span<const Sphere> spheres, std::span<const Patch> patches, const std::optional<HalfSpace>& cut,
        const Context& context)
      : spheres_(spheres), patches_(patches) {
    patched_.reserve(patches.size());
    for (const Patch& patch : patches) {
      const Sphere& s = spheres[patch.ball];
      patched_.push_back({s.centre.x, s.centre.y, s.centre.z, s.radius * s.radius, patch.ball});
      bounds_.include(patch.box.min), bounds_.include(patch.box.max);
    }
    if (!patches.empty()) lift_ = 1e-7 * norm(bounds_.max - bounds_.min);
    hierarchy_.emplace(static_cast<const Primitives&>(*this), context);
    patches_ = {};
    if (cut) cut_plane(*cut, context);
  }

  Box bounds() const override { return bounds_; }
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override { hierarchy_->first_hits(rays, hits); }
  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    hierarchy_->blocked(rays, blocked, alike);
  }

  bool inside(Vec3 point) const override {
    if (discs_ && std::abs(dot(cut_.normal, point) - cut_.offset) <= lift_)
      return discs_->hold(dot(across_, point), dot(along_, point));
    return std::ranges::any_of(spheres_,
                               [&](const Sphere& s) { return squared_norm(point - s.centre) < s.radius * s.radius; });
  }

  Place place(const Ray& ray, const Hit& hit) const override {
    const Vec3 point = ray.origin + hit.distance * ray.direction;
    const Vec3 normal = normalised(point - spheres_[hit.primitive].centre);
    return {point, normal, point + lift_ * normal};
  }

  Colour colour(Vec3, const Hit& hit, std::span<const Colour> table) const override { return table[hit.primitive]; }
  double curvature(Vec3, const Hit& hit) const override { return 1 / spheres_[hit.primitive].radius; }
  std::vector<double> typical_curvatures() const override {
    std::vector<double> all;
    for (const Patched& p : patched_) all.push_back(1 / std::sqrt(p.squared_radius));
    return all;
  }

 private:
  std::size_t size() const override { return patched_.size(); }
  Box box(std::size_t index) const override { return patches_[index].box; }

  std::uint32_t meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin,
                     std::size_t end) const override {
    return enter(patched_[index], lanes, valid, begin, end);
  }

  void cut_plane(const HalfSpace& cut, const Context& context) {
    cut_ = cut;
    across_ =
        normalised(std::abs(cut.normal.x) < 0.7 ? cross(cut.normal, Vec3{1, 0, 0}) : cross(cut.normal, Vec3{0, 1, 0}));
    along_ = cross(cut.normal, across_);
    std::vector<Disc> discs;
    for (const Sphere& s : spheres_) {
      const double height = dot(cut.normal, s.centre) - cut.offset;
      const double squared = (s.radius - height) * (s.radius + height);
      if (squared > 0) discs.push_back({dot(across_, s.centre), dot(along_, s.centre), std::sqrt(squared)});
    }
    discs_.emplace(std::move(discs), context);
  }

  std::span<const Sphere> spheres_;
  std::span<const Patch> patches_;  // only while the hierarchy is built
  std::vector<Patched> patched_;
  Box bounds_;
  double lift_ = 0;
  std::optional<Hierarchy> hierarchy_;
  HalfSpace cut_;
  Vec3 across_, along_;
  std::optional<Discs> discs_;
};

}  // namespace

std::unique_ptr<const Tracer> trace_balls(std::span<const Sphere> spheres, std::span<const Patch> patches,
                                          const std::optional<HalfSpace>& cut, const Context& context) {
  return std::make_unique<const Balls>(spheres, patches, cut, context);
}

}  // namespace spherule
