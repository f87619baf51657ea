// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls blended into each other. Ball i, of radius r, sends out the field
//   f(x) = ((R² - d²) / (R² - r²))²   for the distance d of x from its centre below R = r + b,  0 beyond,
// which is 1 on the ball; the blob is where the sum of all fields is at least 1. So the blob holds every ball, and is
// held by the balls grown by the blending distance b: as b goes to 0 it becomes their union.
//
// Rays meet the cells of blob_cells.h. Along a ray in a cell the sum is one polynomial of degree four, and the square
// of a quadratic between two places for each field of the cell's list. On a stretch of the ray the second derivative of
// each is at most what it is at the stretch's ends: so value and slope of the sum at the beginning and the sum of these
// bounds give a parabola that stays above the sum on the stretch. A ray walks to where the parabola comes to 1, or to
// the stretch's end: no root is passed. Near a root stretches are short, the parabola is nearly the sum itself, and
// steps converge faster than Newton's. What a ray finds in a cell depends on the ray and the cell alone.
//
// Sources: G. Wyvill, C. McPheeters, B. Wyvill, Data structure for soft objects (1986): fields of finite support;
// D. Kalra, A. Barr, Guaranteed ray intersections with implicit surfaces (1989): steps by bounds on derivatives.
#include <algorithm>
#include <array>
#include <bit>
#include <cmath>
#include <limits>
#include <memory>
#include <mutex>

#include "core/base/vectors.h"
#include "core/render/blob_cells.h"
#include "core/render/trace.h"
#include "core/trees/box_tree.h"

namespace spherule {
namespace {

constexpr std::size_t kLanes = Lanes::most;
constexpr double kInfinity = std::numeric_limits<double>::infinity();
// The sum is computed to fewer than 1000 · 2⁻⁵³ where it is about 1; closer to 1 than this is 1.
constexpr double kOnSurface = 1e-12;
// Two cells differ by less on what the sum is between them.
constexpr double kBetweenCells = 1e-9;
// The next stretch, of the step that the last one allowed.
constexpr double kNextStretch = 2;

// Numbers of four rays.
using Four = double __attribute__((vector_size(32), may_alias));
using Bits = std::int64_t __attribute__((vector_size(32), may_alias));
constexpr std::size_t kFours = kLanes / 4;
static_assert(kLanes % 4 == 0);

struct FourTimes {
  alignas(32) std::array<double, 4> of;
  Four& all() { return *reinterpret_cast<Four*>(of.data()); }
  const Four& all() const { return *reinterpret_cast<const Four*>(of.data()); }
};

// The ways of four rays through one field: strength · (squared_half - (t - middle)²)² where that is the square of
// something positive.
struct Crossing {
  FourTimes middle, squared_half;
  double strength = 0;
};

// Four rays in a cell. Places on a ray are mm from where it is nearest to the cell's centre, so that they are small
// numbers wherever the ray starts.
struct Walk {
  FourTimes origin;              // where the ray starts
  FourTimes at, end;             // the part of it that is in the cell, and before a ball of the cell's list
  FourTimes cell_end;            // the same with balls
  std::array<FourTimes, 5> sum;  // the cell's own sum: coefficients of 1, t, t² ...
  std::vector<Crossing> crossings;
};

#define SPHERULE_INLINE inline __attribute__((always_inline))

SPHERULE_INLINE bool any(const Bits& b) { return (b[0] | b[1] | b[2] | b[3]) != 0; }

// Where four rays are nearest to a cell's centre, from there.
struct Base {
  Four x, y, z;
};

const Four& four(const std::array<double, kLanes>& numbers, std::size_t h) {
  return reinterpret_cast<const Four*>(numbers.data())[h];
}

// Narrows the part of four rays to that between two planes.
SPHERULE_INLINE void between_planes(double half, const Four& place, const Four& direction, Four& in, Four& out) {
  const Four none{}, d = direction == 0 ? none + 1e-300 : direction;
  const Four one = (-half - place) / d, two = (half - place) / d;
  const Four least = one < two ? one : two, most = one < two ? two : one;
  in = least > in ? least : in, out = most < out ? most : out;
}

// The cell's own sum along four rays.
SPHERULE_INLINE void along_rays(const BlobSum& b, const Base& u, const Four& dx, const Four& dy, const Four& dz,
                                std::array<FourTimes, 5>& out) {
  const auto& s = b.square;
  const Four sx = s[0] * u.x + s[3] * u.y + s[4] * u.z, sy = s[3] * u.x + s[1] * u.y + s[5] * u.z,
             sz = s[4] * u.x + s[5] * u.y + s[2] * u.z;
  const Four tx = s[0] * dx + s[3] * dy + s[4] * dz, ty = s[3] * dx + s[1] * dy + s[5] * dz,
             tz = s[4] * dx + s[5] * dy + s[2] * dz;
  const Four squared = u.x * u.x + u.y * u.y + u.z * u.z;
  const Four cube_base = b.cube.x * u.x + b.cube.y * u.y + b.cube.z * u.z,
             cube_along = b.cube.x * dx + b.cube.y * dy + b.cube.z * dz;
  out[0].all() = b.constant + 4 * (b.linear.x * u.x + b.linear.y * u.y + b.linear.z * u.z) +
                 (u.x * sx + u.y * sy + u.z * sz) + squared * (b.fourth * squared - 4 * cube_base);
  out[1].all() = 4 * (b.linear.x * dx + b.linear.y * dy + b.linear.z * dz) + 2 * (dx * sx + dy * sy + dz * sz) -
                 4 * squared * cube_along;
  out[2].all() = (dx * tx + dy * ty + dz * tz) - 4 * cube_base + 2 * b.fourth * squared;
  out[3].all() = -4 * cube_along;
  out[4].all() = Four{} + b.fourth;
}

// Puts four rays into a cell: all but the fields of its list. Where the ray's part in it is empty, `end` is below
// `at`.
SPHERULE_INLINE Base into_cell(const BlobCell& cell, const Lanes& lanes, std::size_t h, Walk& walk) {
  const Four dx = four(lanes.dx, h), dy = four(lanes.dy, h), dz = four(lanes.dz, h);
  Base u{four(lanes.ox, h) - cell.centre.x, four(lanes.oy, h) - cell.centre.y, four(lanes.oz, h) - cell.centre.z};
  Four along{};
  for (int turn = 0; turn < 2; ++turn) {  // the second takes what rounding left, of rays from far away
    const Four step = -(u.x * dx + u.y * dy + u.z * dz);
    u.x += step * dx, u.y += step * dy, u.z += step * dz, along += step;
  }
  Four in = -along, out = Four{} + kInfinity;
  between_planes(cell.half, u.x, dx, in, out);
  between_planes(cell.half, u.y, dy, in, out);
  between_planes(cell.half, u.z, dz, in, out);
  walk.origin.all() = -along, walk.at.all() = in, walk.end.all() = walk.cell_end.all() = out;
  along_rays(cell.sum, u, dx, dy, dz, walk.sum);
  return u;
}

// The same with the fields of its list.
SPHERULE_VECTORS
void enter(const BlobCell& cell, std::span<const std::uint32_t> list, std::span<const BlobField> fields,
           const Lanes& lanes, std::size_t h, Walk& walk) {
  const Base u = into_cell(cell, lanes, h, walk);
  const Four dx = four(lanes.dx, h), dy = four(lanes.dy, h), dz = four(lanes.dz, h), none{};
  const Four in = walk.at.all();
  Four out = walk.end.all();
  walk.crossings.clear();
  if (!any(in <= out)) return;
  for (const std::uint32_t i : list) {
    const BlobField& f = fields[i];
    const Four x = (f.centre.x - cell.centre.x) - u.x, y = (f.centre.y - cell.centre.y) - u.y,
               z = (f.centre.z - cell.centre.z) - u.z;
    const Four along = x * dx + y * dy + z * dz, ax = x - along * dx, ay = y - along * dy, az = z - along * dz;
    const Four squared_off = ax * ax + ay * ay + az * az, squared_half = f.squared_reach - squared_off;
    const Four squared_in = (in - along) * (in - along), squared_out = (out - along) * (out - along);
    const Bits reaches = (squared_half > 0) & (in < out) &
                         (((along > in) & (along < out)) | (squared_in < squared_half) | (squared_out < squared_half));
    if (!any(reaches)) continue;
    Crossing& crossing = walk.crossings.emplace_back();
    crossing.middle.all() = along, crossing.squared_half.all() = squared_half, crossing.strength = f.strength;
    const Four squared_chord = f.squared_ball - squared_off;
    if (!any(squared_chord > 0)) continue;
    FourTimes chord;
    chord.all() = squared_chord > 0 ? squared_chord : none;
    for (double& number : chord.of) number = std::sqrt(number);
    const Four entry = along - chord.all();
    const Bits stops = (squared_chord > 0) & (entry >= in) & (entry < out);
    out = stops ? entry : out;
  }
  walk.end.all() = out;
}

// Value and slope of the sum at a place, and the bound on its second derivative from there to another.
struct Sums {
  Four value, slope, bend;
};

SPHERULE_INLINE void add_up(const Walk& walk, const Four& at, const Four& to, Sums& sums) {
  const Four none{};
  const Four k1 = walk.sum[1].all(), k2 = walk.sum[2].all(), k3 = walk.sum[3].all(), k4 = walk.sum[4].all();
  Four value = walk.sum[0].all() + at * (k1 + at * (k2 + at * (k3 + at * k4)));
  Four slope = k1 + at * (2 * k2 + at * (3 * k3 + 4 * at * k4));
  // k4 is not negative: between two places, the second derivative is largest at one of them.
  const Four here = 2 * k2 + at * (6 * k3 + 12 * at * k4), there = 2 * k2 + to * (6 * k3 + 12 * to * k4);
  Four bend = here > there ? here : there;
  for (const Crossing& c : walk.crossings) {
    const Four squared_half = c.squared_half.all(), a = at - c.middle.all(), b = to - c.middle.all();
    const Four squared_a = a * a, squared_b = b * b, q = squared_half - squared_a;
    const Four positive = q > 0 ? q : none, sq = c.strength * positive;
    value += sq * positive;
    slope -= 4 * sq * a;
    // The second derivative is strength · (12 d² - 4 squared_half) at d from the middle, 0 outside.
    const Four far = squared_a > squared_b ? squared_a : squared_b, d = far < squared_half ? far : squared_half;
    const Four most = c.strength * (12 * d - 4 * squared_half);
    const Four apart = a > 0 ? squared_a - squared_half : (b < 0 ? squared_b - squared_half : none - 1);
    bend += (apart > 0) | (squared_half <= 0) ? none : most;
  }
  sums = {value, slope, bend};
}

// Of four rays, as bits: those that come to the surface, at walk.at; and those that were not below it to begin with.
struct Outcome {
  std::uint32_t rise = 0, begin_inside = 0;
};

// Walks the rays whose bit is in `lanes` until each is on the surface or at its end. `least`: mm that every step makes,
// below what matters.
SPHERULE_VECTORS
Outcome march(Walk& walk, std::uint32_t lanes, double least) {
  const Four end = walk.end.all(), none{};
  const Bits nobody{}, lane{1, 2, 4, 8};
  Bits active = ((lanes + nobody) & lane) != 0, rise{}, begin_inside{};
  Four at = walk.at.all(), stretch = end - at;
  FourTimes root;
  for (bool first = true; any(active); first = false) {
    const Four ahead = at + stretch, to = ahead < end ? ahead : end;
    Sums sums;
    add_up(walk, at, to, sums);
    const Four missing = 1 - sums.value, squared = sums.slope * sums.slope + 2 * sums.bend * missing;
    root.all() = squared > 0 ? squared : none;
    for (double& number : root.of) number = std::sqrt(number);
    // Where the parabola comes to 1, if it does.
    const Four below = squared >= 0 ? sums.slope + root.all() : none;
    const Four rounded = 0x1p-50 * (at > 0 ? at : -at), shortest = rounded > least ? rounded : none + least;
    const Four wanted = 2 * missing / below, longer = wanted > shortest ? wanted : shortest;
    const Four next = at + (below > 0 ? longer : none + kInfinity);
    const Bits arrived = active & (missing <= kOnSurface), going = active & ~arrived, within = next < to;
    (first ? begin_inside : rise) |= arrived;
    stretch = within ? kNextStretch * (next - at) : 2 * stretch;
    at = going ? (within ? next : to) : at;
    const Bits done = going & ~(at < end);
    // At the entry into a ball: rounding may hide the surface just before it.
    rise |= done & (end < walk.cell_end.all());
    active = going & ~done;
  }
  walk.at.all() = at;
  const auto bits = [](const Bits& b) {
    return static_cast<std::uint32_t>((b[0] & 1) | (b[1] & 2) | (b[2] & 4) | (b[3] & 8));
  };
  return {bits(rise), bits(begin_inside)};
}

// Value and slope of the sum at walk.at of one ray, and how far below 0 its second derivative may be in the cell.
struct SumsOfOne {
  double value, slope, bend;
};
SumsOfOne sums_of_one(const Walk& walk, std::size_t k) {
  const double at = walk.at.of[k];
  std::array<double, 5> c;
  for (std::size_t i = 0; i < 5; ++i) c[i] = walk.sum[i].of[k];
  SumsOfOne s{c[0] + at * (c[1] + at * (c[2] + at * (c[3] + at * c[4]))),
              c[1] + at * (2 * c[2] + at * (3 * c[3] + 4 * at * c[4])), 0};
  if (c[4] > 0) s.bend = std::max(0.0, 0.75 * c[3] * c[3] / c[4] - 2 * c[2]);
  for (const Crossing& crossing : walk.crossings) {
    const double squared_half = std::max(0.0, crossing.squared_half.of[k]), d = at - crossing.middle.of[k];
    const double q = std::max(0.0, squared_half - d * d);
    s.value += crossing.strength * q * q, s.slope -= 4 * crossing.strength * q * d;
    s.bend += 4 * crossing.strength * squared_half;
  }
  return s;
}

// Rays that look for the surface.
struct Walkers : Lanes {
  // Whether a ray starts inside: found out when it matters.
  enum class Start : std::uint8_t { unknown, outside, inside };
  std::array<Start, kLanes> starts{};
  Walk walk;

  std::size_t begin(std::span<const Ray> rays) {
    starts = {};
    return load(rays);
  }
};

BlobField field_of(const Sphere& s, double blend) {
  const double reach = s.radius + blend, gap = blend * (2 * s.radius + blend);
  return {s.centre, s.radius * s.radius, reach * reach, 1 / (gap * gap)};
}

std::vector<BlobField> fields_of(std::span<const Sphere> spheres, double blend) {
  std::vector<BlobField> fields;
  for (const Sphere& s : spheres)
    if (s.radius > 0) fields.push_back(field_of(s, blend));
  return fields;
}

class Blobs final : public Tracer, private Primitives {
 public:
  Blobs(std::span<const Sphere> spheres, double blend, const Context& context)
      : context_{.threads = 1, .cancel = context.cancel, .progress = {}},
        spheres_(spheres),
        blend_(blend),
        fields_(fields_of(spheres, blend)) {
    for (const Sphere& s : spheres)
      if (s.radius > 0) bounds_.include(Sphere{s.centre, s.radius + blend});
    if (!bounds_.empty()) lift_ = 1e-6 * norm(bounds_.max - bounds_.min);
    cells_ = blob_cells(fields_, context);
    hierarchy_.emplace(static_cast<const Primitives&>(*this), context);
  }

  Box bounds() const override { return bounds_; }
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override {
    Walkers walkers;
    for (std::size_t begin = 0; begin < rays.size(); begin += kLanes) {
      context_.throw_if_cancelled();
      const std::size_t count = walkers.begin(rays.subspan(begin));
      hierarchy_->nearest(walkers, count, true);
      for (std::size_t i = 0; i < count; ++i) {
        Hit& hit = hits[begin + i] = {walkers.far[i], walkers.primitive[i], {}};
        const Ray& ray = rays[begin + i];
        if (hit)
          hit.out = -derivatives(cells_.cells[hit.primitive], ray.origin + hit.distance * ray.direction).gradient;
      }
    }
  }

  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    Walkers walkers;
    for (std::size_t begin = 0; begin < rays.size(); begin += kLanes) {
      context_.throw_if_cancelled();
      const std::size_t count = walkers.begin(rays.subspan(begin));
      hierarchy_->any(walkers, count, alike);
      for (std::size_t i = 0; i < count; ++i) blocked[begin + i] = walkers.primitive[i] != no_primitive;
    }
  }

  bool inside(Vec3 point) const override {
    const auto [inside, cell] = cells_.locate(point);
    return cell ? value_in(cells_.cells[*cell], point) >= 1 : inside;
  }

  Place place(const Ray& ray, const Hit& hit) const override {
    const Vec3 point = ray.origin + hit.distance * ray.direction;
    const double length = norm(hit.out);
    const Vec3 normal = length > 0 ? 1 / length * hit.out : -ray.direction;
    return {point, normal, point + lift_ * normal};
  }

  Colour colour(Vec3 point, const Hit&, std::span<const Colour> table) const override {
    Colour sum;
    double weight = 0;
    Box box;
    box.include(point);
    tree().for_each_overlap(box, [&](std::size_t n) {
      const std::uint32_t i = tree().order()[n];
      const BlobField f = field_of(spheres_[i], blend_);
      const double q = f.squared_reach - squared_norm(point - f.centre);
      if (!(q > 0) || !(f.squared_ball > 0)) return;
      const double field = f.strength * q * q;
      sum = sum + field * table[i], weight += field;
    });
    return weight > 0 ? 1 / weight * sum : sum;
  }

  // Of the level set of -sum, whose gradient g points out: (|g|² tr H - gᵀ H g) / (2 |g|³).
  double curvature(Vec3 point, const Hit& hit) const override {
    const auto [gradient, hessian] = derivatives(cells_.cells[hit.primitive], point);
    const double squared = squared_norm(gradient);
    const double trace = hessian.rows[0].x + hessian.rows[1].y + hessian.rows[2].z;
    const double bent = dot(gradient, hessian * gradient) - squared * trace;
    return squared > 0 ? bent / (2 * squared * std::sqrt(squared)) : 0;
  }
  std::vector<double> typical_curvatures() const override {
    std::vector<double> all;
    for (const Sphere& s : spheres_)
      if (s.radius > 0) all.push_back(1 / s.radius);
    return all;
  }

 private:
  std::size_t size() const override { return cells_.cells.size(); }
  Box box(std::size_t index) const override { return cells_.box(cells_.cells[index], fields_); }

  std::uint32_t meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t, std::size_t) const override {
    auto& walkers = static_cast<Walkers&>(lanes);
    const BlobCell& cell = cells_.cells[index];
    Walk& walk = walkers.walk;
    std::uint32_t met = 0;
    for (std::size_t h = 0; h < kFours; ++h) {
      const int* const wanted = valid + 4 * h;
      if (std::none_of(wanted, wanted + 4, [](int v) { return v != 0; })) continue;
      enter(cell, cells_.list(cell), fields_, lanes, h, walk);
      std::uint32_t on = 0;
      for (std::size_t k = 0; k < 4; ++k)
        if (wanted[k] != 0 && walk.at.of[k] <= walk.end.of[k] &&
            walk.at.of[k] - walk.origin.of[k] <= lanes.far[4 * h + k])
          on |= 1U << k;
      Outcome outcome = march(walk, on, 1e-6 * lift_);
      for (; outcome.begin_inside != 0; outcome.begin_inside &= outcome.begin_inside - 1) {
        const auto k = static_cast<std::size_t>(std::countr_zero(outcome.begin_inside));
        if (rises_later(walkers, 4 * h + k, k)) outcome.rise |= 1U << k;
      }
      for (; outcome.rise != 0; outcome.rise &= outcome.rise - 1) {
        const auto k = static_cast<std::size_t>(std::countr_zero(outcome.rise)), lane = 4 * h + k;
        const double distance = walk.at.of[k] - walk.origin.of[k];
        if (distance > lanes.far[lane] || (distance == lanes.far[lane] && index >= lanes.primitive[lane])) continue;
        lanes.far[lane] = distance, lanes.primitive[lane] = index;
        met |= 1U << lane;
      }
    }
    return met;
  }

  // Whether a ray whose part in a cell begins inside comes to the surface from outside, and where. One that starts
  // inside has not entered then, and first leaves; any other has entered at the cell's side.
  bool rises_later(Walkers& walkers, std::size_t lane, std::size_t k) const {
    using Start = Walkers::Start;
    Walk& walk = walkers.walk;
    if (walk.at.of[k] > walk.origin.of[k]) {
      Start& start = walkers.starts[lane];
      if (start == Start::unknown)
        start = inside({walkers.ox[lane], walkers.oy[lane], walkers.oz[lane]}) ? Start::inside : Start::outside;
      if (start == Start::outside) return true;
      const SumsOfOne sums = sums_of_one(walk, k);
      if (sums.value <= 1 + kBetweenCells && sums.slope > 0) return true;
    }
    walk.end.of[k] = walk.cell_end.of[k];
    if (!walk_out(walk, k)) return false;
    return march(walk, 1U << k, 1e-6 * lift_).rise != 0;
  }

  // Walks to where the ray leaves, if that is in the cell.
  bool walk_out(Walk& walk, std::size_t k) const {
    double& at = walk.at.of[k];
    while (at < walk.end.of[k]) {
      const SumsOfOne sums = sums_of_one(walk, k);
      const double over = sums.value - 1;
      if (over < -kOnSurface) return true;
      const double below = std::sqrt(sums.slope * sums.slope + 2 * sums.bend * std::max(0.0, over)) - sums.slope;
      const double step = over > 0 ? (below > 0 ? 2 * over / below : kInfinity) : 0;
      at += std::max({step, 1e-6 * lift_, 0x1p-50 * std::abs(at)});
    }
    return false;
  }

  double value_in(const BlobCell& cell, Vec3 point) const {
    double sum = cell.sum.value(point - cell.centre);
    for (const std::uint32_t i : cells_.list(cell)) {
      const double q = fields_[i].squared_reach - squared_norm(point - fields_[i].centre);
      if (q > 0) sum += fields_[i].strength * q * q;
    }
    return sum;
  }

  // Of the sum at a point of a cell.
  struct Derivatives {
    Vec3 gradient;
    Mat3 hessian;
  };
  Derivatives derivatives(const BlobCell& cell, Vec3 point) const {
    const Vec3 u = point - cell.centre;
    Derivatives d{cell.sum.gradient(u), cell.sum.hessian(u)};
    for (const std::uint32_t i : cells_.list(cell)) {
      const BlobField& f = fields_[i];
      const Vec3 v = point - f.centre;
      const double q = f.squared_reach - squared_norm(v);
      if (!(q > 0)) continue;
      d.gradient = d.gradient - 4 * f.strength * q * v;
      for (int r = 0; r < 3; ++r) {
        Vec3& row = d.hessian.rows[static_cast<std::size_t>(r)];
        row = row + 8 * f.strength * v[r] * v;
        row[r] -= 4 * f.strength * q;
      }
    }
    return d;
  }

  // Of the fields' reach; made when colours are asked for.
  const BoxTree& tree() const {
    std::call_once(tree_once_, [&] {
      std::vector<Box> boxes(spheres_.size());
      for (std::size_t i = 0; i < boxes.size(); ++i)
        boxes[i].include(Sphere{spheres_[i].centre, spheres_[i].radius + blend_});
      tree_.emplace(boxes, context_);
    });
    return *tree_;
  }

  Context context_;  // only to hear a cancel
  std::span<const Sphere> spheres_;
  double blend_;
  std::vector<BlobField> fields_;  // of the cells
  Box bounds_;
  double lift_ = 0;
  BlobCells cells_;
  std::optional<Hierarchy> hierarchy_;
  mutable std::once_flag tree_once_;
  mutable std::optional<BoxTree> tree_;
};

}  // namespace

std::unique_ptr<const Tracer> trace_blobs(std::span<const Sphere> spheres, double blend_mm, const Context& context) {
  return std::make_unique<const Blobs>(spheres, blend_mm, context);
}

}  // namespace spherule
