// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls blended into each other. Ball i, of radius r, sends out the field
//   f(x) = ((R² - d²) / (R² - r²))²   for the distance d of x from its centre below R = r + b,  0 beyond,
// which is 1 on the ball; the blob is where the sum of all fields is at least 1. So the blob holds every ball, and is
// held by the balls grown by the blending distance b: as b goes to 0 it becomes their union.
//
// Along a ray each field is the square of a quadratic between two places and 0 elsewhere. On a stretch of the ray its
// second derivative is at most what it is at the stretch's ends: so value and slope of the sum at the beginning and the
// sum of these bounds give a parabola that stays above the sum on the stretch. A ray walks to where the parabola comes
// to 1, or to the stretch's end: no root is passed. Near a root stretches are short, the parabola is nearly the sum
// itself, and steps converge faster than Newton's.
//
// Sources: G. Wyvill, C. McPheeters, B. Wyvill, Data structure for soft objects (1986): fields of finite support;
// D. Kalra, A. Barr, Guaranteed ray intersections with implicit surfaces (1989): steps by bounds on derivatives.
#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <utility>

#include "core/base/vectors.h"
#include "core/render/trace.h"

namespace spherule {
namespace {

constexpr std::size_t kLanes = Lanes::most;
constexpr double kNever = 1e150;  // mm along a ray; its square is finite
constexpr double kInfinity = std::numeric_limits<double>::infinity();
// The sum is computed to fewer than 1000 · 2⁻⁵³ where it is about 1; closer to 1 than this is 1.
constexpr double kOnSurface = 1e-12;
// The first stretch, of the way to the end; the next one, of the step that the last one allowed.
constexpr double kFirstStretch = 0.5, kNextStretch = 2;

struct Source {
  Vec3 centre;
  double squared_ball = 0, squared_reach = 0;
  double strength = 0;  // 1 / (R² - r²)²
};

// The ways of up to 16 rays through one field: strength · (squared_half - (t - middle)²)² where that is the square of
// something positive.
struct Crossing {
  alignas(64) std::array<double, kLanes> middle{};
  alignas(64) std::array<double, kLanes> squared_half{};  // negative: not on this ray's way, and middle is kNever
  double strength = 0;
  std::uint32_t source = 0;
};

// Rays, and the fields on their ways.
struct Crossings : Lanes {
  std::vector<Crossing> list;
  std::vector<std::uint32_t> order;  // indices of list, by source: sums do not depend on how the fields were found

  std::size_t begin(std::span<const Ray> rays) {
    std::ranges::fill(table_, 0);
    list.clear();
    return load(rays);
  }
  // Embree may show rays of one packet a box one after the other.
  Crossing& of(std::uint32_t source) {
    if (2 * list.size() >= table_.size()) grow();
    std::uint32_t& entry = table_[slot(source)];
    if (entry == 0) {
      entry = static_cast<std::uint32_t>(list.size()) + 1;
      Crossing& c = list.emplace_back();
      c.middle.fill(kNever), c.squared_half.fill(-1);
      c.source = source;
    }
    return list[entry - 1];
  }
  void sort() {
    order.resize(list.size());
    for (std::uint32_t i = 0; i < order.size(); ++i) order[i] = i;
    std::ranges::sort(order, {}, [&](std::uint32_t i) { return list[i].source; });
    by_entry_.clear();
    near_first_ = kInfinity, near_last_ = -kInfinity;
  }
  // Of `order`, the fields that may be anything but 0 somewhere between these places on the rays. A ray along a row of
  // n balls makes some steps in each: it must not look at all n for each step.
  std::span<const std::uint32_t> between(double first, double last) {
    if (order.size() <= kFew) return order;
    const bool within = first >= near_first_ && last <= near_last_;
    if (within && (near_.size() <= kFew || near_last_ - near_first_ <= 4 * (last - first))) return near_;
    if (by_entry_.empty()) set_ways();
    near_.clear();
    near_first_ = first, near_last_ = last;
    const auto begin = std::ranges::partition_point(by_entry_, [&](const Way& w) { return w.last_so_far < first; });
    for (auto w = begin; w != by_entry_.end() && w->first <= last; ++w)
      if (w->last >= first) near_.push_back(w->rank);
    std::ranges::sort(near_);
    for (std::uint32_t& rank : near_) rank = order[rank];
    return near_;
  }

 private:
  static constexpr std::size_t kFew = 32;
  // The part of the rays on which a field may be anything but 0.
  struct Way {
    double first, last;
    double last_so_far;  // the largest `last` of this one and those before
    std::uint32_t rank;  // in `order`
  };
  void set_ways() {
    for (std::uint32_t rank = 0; rank < order.size(); ++rank) {
      const Crossing& c = list[order[rank]];
      Way way{kInfinity, -kInfinity, 0, rank};
      for (std::size_t k = 0; k < kLanes; ++k) {
        if (!(c.squared_half[k] > 0)) continue;
        const double half = std::sqrt(c.squared_half[k]);
        way.first = std::min(way.first, c.middle[k] - half), way.last = std::max(way.last, c.middle[k] + half);
      }
      by_entry_.push_back(way);
    }
    std::ranges::sort(by_entry_, {}, &Way::first);
    double last = -kInfinity;
    for (Way& way : by_entry_) last = way.last_so_far = std::max(last, way.last);
  }
  // Where the source is in the table, or would be.
  std::size_t slot(std::uint32_t source) const {
    std::size_t at = (source * 0x9E3779B1U) & (table_.size() - 1);
    while (table_[at] != 0 && list[table_[at] - 1].source != source) at = (at + 1) & (table_.size() - 1);
    return at;
  }
  void grow() {
    table_.assign(std::max<std::size_t>(128, 2 * table_.size()), 0);
    for (std::size_t i = 0; i < list.size(); ++i) table_[slot(list[i].source)] = static_cast<std::uint32_t>(i) + 1;
  }
  std::vector<std::uint32_t> table_;  // open addressing: index in list + 1, or 0
  std::vector<Way> by_entry_;         // made when it is first needed
  std::vector<std::uint32_t> near_;   // the fields between these places
  double near_first_ = 0, near_last_ = 0;
};

// Notes the ways through a field, and the entries into its ball: what lies beyond those is beyond the surface. Returns
// as bits the lanes that enter the ball before `far`.
SPHERULE_VECTORS
std::uint32_t cross(const Source& s, std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin,
                    std::size_t end, Crossing& way, bool& any) {
  alignas(64) std::array<double, kLanes> entries;
  std::int32_t crosses = 0, enters = 0;
  for (std::size_t k = begin; k < end; ++k) {
    const double x = s.centre.x - lanes.ox[k], y = s.centre.y - lanes.oy[k], z = s.centre.z - lanes.oz[k];
    const double along = x * lanes.dx[k] + y * lanes.dy[k] + z * lanes.dz[k];
    const double ax = x - along * lanes.dx[k], ay = y - along * lanes.dy[k], az = z - along * lanes.dz[k];
    const double squared_off = ax * ax + ay * ay + az * az, squared_half = s.squared_reach - squared_off;
    const double half = std::sqrt(squared_half > 0 ? squared_half : 0), late = along - half - lanes.far[k];
    const bool on_way = (static_cast<int>(squared_half > 0) & static_cast<int>(along + half > 0) &
                         static_cast<int>(late <= 0) & static_cast<int>(valid[k] != 0)) != 0;
    way.middle[k] = on_way ? along : kNever;
    way.squared_half[k] = on_way ? squared_half : -1;
    const double squared_chord = s.squared_ball - squared_off;
    const double entry = along - std::sqrt(squared_chord > 0 ? squared_chord : 0);
    const bool in = (static_cast<int>(squared_chord > 0) & static_cast<int>(entry >= 0) &
                     static_cast<int>(entry <= lanes.far[k]) & static_cast<int>(on_way)) != 0;
    entries[k] = in ? entry : -1;
    crosses |= static_cast<std::int32_t>(on_way);
    enters |= static_cast<std::int32_t>(in);
  }
  any = crosses != 0;
  std::uint32_t met = 0;
  if (enters == 0) return met;
  for (std::size_t k = begin; k < end; ++k) {
    if (entries[k] < 0 || (entries[k] == lanes.far[k] && index >= lanes.primitive[k])) continue;
    lanes.far[k] = entries[k];
    lanes.primitive[k] = index;
    met |= 1U << k;
  }
  return met;
}

// Rays on the stretch of their way where the sum may come to 1.
struct Walk {
  alignas(64) std::array<double, kLanes> at, end;       // mm along the ray
  alignas(64) std::array<std::int32_t, kLanes> active;  // 1, or 0: at the end, or on the surface
  alignas(64) std::array<std::int32_t, kLanes> met;     // 1: stopped where the sum is 1
};

// From the first field to the last, or to the entry into a ball.
SPHERULE_VECTORS
void start(const Crossings& ways, Walk& walk) {
  alignas(64) std::array<double, kLanes> first, last, peaks{};
  first.fill(kInfinity), last.fill(0);
  for (const Crossing& c : ways.list)
    for (std::size_t k = 0; k < kLanes; ++k) {
      const double squared = c.squared_half[k] > 0 ? c.squared_half[k] : 0, half = std::sqrt(squared);
      const double in = squared > 0 ? c.middle[k] - half : kInfinity, out = squared > 0 ? c.middle[k] + half : 0;
      first[k] = in < first[k] ? in : first[k];
      last[k] = out > last[k] ? out : last[k];
      peaks[k] += c.strength * squared * squared;
    }
  for (std::size_t k = 0; k < kLanes; ++k) {
    walk.at[k] = first[k] > 0 ? first[k] : 0;
    walk.end[k] = last[k] < ways.far[k] ? last[k] : ways.far[k];
    walk.active[k] = peaks[k] >= 1 - kOnSurface && walk.at[k] < walk.end[k] ? 1 : 0;
    walk.met[k] = 0;
  }
}

// Numbers of eight rays.
using Eight = double __attribute__((vector_size(64), may_alias));
constexpr std::size_t kEights = kLanes / 8;
Eight* eights(std::array<double, kLanes>& numbers) { return reinterpret_cast<Eight*>(numbers.data()); }
const Eight* eights(const std::array<double, kLanes>& numbers) {
  return reinterpret_cast<const Eight*>(numbers.data());
}

// Value and slope of the sum at walk.at, and the bound on its second derivative from there to `to`.
struct Sums {
  alignas(64) std::array<double, kLanes> value{}, slope{}, bend{};
};

SPHERULE_VECTORS
void add_up(const std::vector<Crossing>& list, std::span<const std::uint32_t> some, const Walk& walk,
            const std::array<double, kLanes>& to, Sums& sums) {
  for (std::size_t h = 0; h < kEights; ++h) {
    const Eight at = eights(walk.at)[h], next = eights(to)[h], none{};
    Eight value{}, slope{}, bend{};
    for (const std::uint32_t i : some) {
      const Crossing& c = list[i];
      const Eight squared_half = eights(c.squared_half)[h], a = at - eights(c.middle)[h],
                  b = next - eights(c.middle)[h];
      const Eight squared_a = a * a, squared_b = b * b, q = squared_half - squared_a;
      const Eight positive = q > 0 ? q : none, sq = c.strength * positive;
      value += sq * positive;
      slope -= 4 * sq * a;
      // The second derivative is strength · (12 d² - 4 squared_half) at d from the middle, 0 outside.
      const Eight far = squared_a > squared_b ? squared_a : squared_b, d = far < squared_half ? far : squared_half;
      const Eight most = c.strength * (12 * d - 4 * squared_half);
      const Eight apart = a > 0 ? squared_a - squared_half : (b < 0 ? squared_b - squared_half : none - 1);
      bend += apart > 0 ? none : most;
    }
    eights(sums.value)[h] = value, eights(sums.slope)[h] = slope, eights(sums.bend)[h] = bend;
  }
}

// A step that is no shorter than `least` and gets somewhere, though `at` is rounded.
double step_from(double at, double step, double least) { return std::max({step, least, 0x1p-50 * at}); }

// Walks until every ray is on the surface or at its end. `least`: mm that every step makes, below what matters.
void march(Crossings& ways, double least, const Context& context, Walk& walk) {
  alignas(64) std::array<double, kLanes> stretch, to;
  Sums sums;
  for (std::size_t k = 0; k < kLanes; ++k) stretch[k] = kFirstStretch * (walk.end[k] - walk.at[k]);
  for (bool going = true; going;) {
    context.throw_if_cancelled();
    going = false;
    // Rays that are ahead wait, so that all look at the same few fields.
    double first = kInfinity, last = 0, reached = 0;
    for (std::size_t k = 0; k < kLanes; ++k) {
      to[k] = std::min(walk.at[k] + stretch[k], walk.end[k]);
      if (walk.active[k] != 0 && walk.at[k] < first) first = walk.at[k], reached = to[k];
    }
    for (std::size_t k = 0; k < kLanes; ++k)
      if (walk.active[k] != 0 && walk.at[k] <= reached) last = std::max(last, to[k]);
    add_up(ways.list, ways.between(first, last), walk, to, sums);
    for (std::size_t k = 0; k < kLanes; ++k) {
      if (walk.active[k] == 0) continue;
      if (walk.at[k] > reached) {
        going = true;
        continue;
      }
      const double missing = 1 - sums.value[k];
      if (missing <= kOnSurface) {
        walk.met[k] = 1, walk.active[k] = 0;
        continue;
      }
      // Where the parabola comes to 1, if it does.
      const double slope = sums.slope[k], squared = slope * slope + 2 * sums.bend[k] * missing;
      const double below = squared >= 0 ? slope + std::sqrt(squared) : 0;
      const double step = below > 0 ? step_from(walk.at[k], 2 * missing / below, least) : kInfinity;
      if (walk.at[k] + step < to[k]) {
        walk.at[k] += step, stretch[k] = kNextStretch * step;
      } else {
        walk.at[k] = to[k], stretch[k] *= 2;
        if (!(walk.at[k] < walk.end[k])) walk.active[k] = 0;
      }
      going = going || walk.active[k] != 0;
    }
  }
}

class Blobs final : public Tracer, private Primitives {
 public:
  Blobs(std::span<const Sphere> spheres, double blend, const Context& context)
      : context_{.threads = 1, .cancel = context.cancel, .progress = {}} {
    for (const Sphere& s : spheres) {
      const double reach = s.radius + blend, gap = blend * (2 * s.radius + blend);
      sources_.push_back({s.centre, s.radius * s.radius, reach * reach, 1 / (gap * gap)});
      if (s.radius > 0) bounds_.include(Sphere{s.centre, reach});
    }
    if (!bounds_.empty()) lift_ = 1e-6 * norm(bounds_.max - bounds_.min);
    hierarchy_.emplace(static_cast<const Primitives&>(*this), context);
  }

  Box bounds() const override { return bounds_; }
  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override {
    const auto find = [&](Crossings& ways, std::size_t count) { hierarchy_->nearest(ways, count, true); };
    for_each_ray(rays, find, [&](std::size_t ray, const Crossings& ways, const Walk& walk, std::size_t lane) {
      // Nothing, or a ball's entry: rounding may hide the surface just before it.
      Hit& hit = hits[ray] = {ways.far[lane], ways.primitive[lane], {}};
      if (walk.met[lane] != 0) hit.distance = walk.at[lane];
      if (walk.met[lane] != 0 || hit) describe(ways, lane, rays[ray].origin, hit);
    });
  }

  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    const auto find = [&](Crossings& ways, std::size_t count) { hierarchy_->any(ways, count, alike); };
    for_each_ray(rays, find, [&](std::size_t ray, const Crossings& ways, const Walk& walk, std::size_t lane) {
      blocked[ray] = ways.primitive[lane] != no_primitive || walk.met[lane] != 0;
    });
  }

  bool inside(Vec3 point) const override {
    double sum = 0;
    visit(point, [&](std::uint32_t, double field) { sum += field; });
    return sum >= 1;
  }

  Place place(const Ray& ray, const Hit& hit) const override {
    const Vec3 point = ray.origin + hit.distance * ray.direction;
    const double length = norm(hit.out);
    const Vec3 normal = length > 0 ? 1 / length * hit.out : -ray.direction;
    return {point, normal, point + lift_ * normal};
  }

  Colour colour(Vec3 point, const Hit& hit, std::span<const Colour> table) const override {
    Colour sum;
    double weights = 0;
    visit(point, [&](std::uint32_t i, double field) { sum = sum + field * table[i], weights += field; });
    return weights > 0 ? 1 / weights * sum : table[hit.primitive];
  }

  // Of the level set of -sum, whose gradient g points out: (|g|² tr H - gᵀ H g) / (2 |g|³).
  double curvature(Vec3 point, const Hit&) const override {
    Vec3 gradient;
    Mat3 hessian{{Vec3{}, Vec3{}, Vec3{}}};
    visit(point, [&](std::uint32_t i, double) {
      const Source& s = sources_[i];
      const Vec3 v = point - s.centre;
      const double q = s.squared_reach - squared_norm(v);
      gradient = gradient + 4 * s.strength * q * v;
      for (int r = 0; r < 3; ++r) {
        hessian.rows[static_cast<std::size_t>(r)] =
            hessian.rows[static_cast<std::size_t>(r)] - 8 * s.strength * v[r] * v;
        hessian.rows[static_cast<std::size_t>(r)][r] += 4 * s.strength * q;
      }
    });
    const double squared = squared_norm(gradient);
    const double trace = hessian.rows[0].x + hessian.rows[1].y + hessian.rows[2].z;
    return squared > 0 ? (squared * trace - dot(gradient, hessian * gradient)) / (2 * squared * std::sqrt(squared)) : 0;
  }
  std::vector<double> typical_curvatures() const override {
    std::vector<double> all;
    for (const Source& s : sources_)
      if (s.squared_ball > 0) all.push_back(1 / std::sqrt(s.squared_ball));
    return all;
  }

 private:
  std::size_t size() const override { return sources_.size(); }
  Box box(std::size_t index) const override {
    const Source& s = sources_[index];
    Box box;
    // A ball of radius 0 is no ball; its box is a point that no field comes from.
    box.include(Sphere{s.centre, s.squared_ball > 0 ? std::sqrt(s.squared_reach) : 0});
    return box;
  }

  std::uint32_t meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin,
                     std::size_t end) const override {
    const Source& s = sources_[index];
    if (!(s.squared_ball > 0)) return 0;
    Crossing way;
    bool any = false;
    const std::uint32_t met = cross(s, index, lanes, valid, begin, end, way, any);
    if (!any) return met;
    Crossing& noted = static_cast<Crossings&>(lanes).of(index);
    noted.strength = s.strength;
    for (std::size_t k = begin; k < end; ++k)
      if (valid[k] != 0) noted.middle[k] = way.middle[k], noted.squared_half[k] = way.squared_half[k];
    return met;
  }

  // Packet by packet: `find` has the hierarchy find the ways through fields, the rays walk, and use(ray, ways, walk,
  // lane) takes what came of each.
  template <typename Find, typename Use>
  void for_each_ray(std::span<const Ray> rays, Find&& find, Use&& use) const {
    Crossings ways;
    Walk walk;
    for (std::size_t begin = 0; begin < rays.size(); begin += kLanes) {
      context_.throw_if_cancelled();
      const std::size_t count = ways.begin(rays.subspan(begin));
      find(ways, count);
      ways.sort();
      walk_in(ways, count, walk);
      for (std::size_t i = 0; i < count; ++i) use(begin + i, ways, walk, i);
    }
  }

  // Walks the first `count` rays to where they enter.
  void walk_in(Crossings& ways, std::size_t count, Walk& walk) const {
    start(ways, walk);
    bool any = false;
    for (std::size_t k = 0; k < kLanes; ++k) {
      if (k >= count) walk.active[k] = 0;
      if (walk.active[k] != 0 && walk.at[k] == 0) walk_out(ways, k, walk);
      any = any || walk.active[k] != 0;
    }
    if (any) march(ways, 1e-6 * lift_, context_, walk);
  }

  // A ray may start inside; it has not entered then, and first leaves. The second derivative of a field is nowhere
  // below -4 strength · squared_half.
  void walk_out(const Crossings& ways, std::size_t k, Walk& walk) const {
    for (;;) {
      double value = 0, slope = 0, bend = 0;
      for (const std::uint32_t i : ways.order) {
        const Crossing& c = ways.list[i];
        const double squared_half = std::max(0.0, c.squared_half[k]), d = walk.at[k] - c.middle[k];
        const double q = std::max(0.0, squared_half - d * d);
        value += c.strength * q * q, slope -= 4 * c.strength * q * d, bend += 4 * c.strength * squared_half;
      }
      const double over = value - 1;
      if (over < -kOnSurface) return;
      const double step = over > 0 ? 2 * over / (std::sqrt(slope * slope + 2 * bend * over) - slope) : 0;
      walk.at[k] += step_from(walk.at[k], step, 1e-6 * lift_);
      if (walk.at[k] >= walk.end[k]) walk.active[k] = 0;
      if (walk.active[k] == 0) return;
    }
  }

  // Sets the strongest source and the direction to the outside.
  void describe(const Crossings& ways, std::size_t k, Vec3 origin, Hit& hit) const {
    const Vec3 point = origin + hit.distance * Vec3{ways.dx[k], ways.dy[k], ways.dz[k]};
    double most = -1;
    for (const std::uint32_t i : ways.order) {
      const Crossing& c = ways.list[i];
      const double d = hit.distance - c.middle[k], q = c.squared_half[k] - d * d;
      if (!(q > 0)) continue;
      if (c.strength * q * q > most) most = c.strength * q * q, hit.primitive = c.source;
      hit.out = hit.out + c.strength * q * (point - sources_[c.source].centre);
    }
  }

  // Calls f(source, field) for every field at a point, in the sources' order.
  template <typename F>
  void visit(Vec3 point, F f) const {
    Crossings ways;
    const Ray ray{point, {0, 0, 1}, lift_};
    hierarchy_->nearest(ways, ways.begin(std::span(&ray, 1)), false);
    ways.sort();
    for (const std::uint32_t i : ways.order) {
      const Source& s = sources_[ways.list[i].source];
      const double q = s.squared_reach - squared_norm(point - s.centre);
      if (q > 0) f(ways.list[i].source, s.strength * q * q);
    }
  }

  Context context_;  // only to hear a cancel
  std::vector<Source> sources_;
  Box bounds_;
  double lift_ = 0;
  std::optional<Hierarchy> hierarchy_;
};

}  // namespace

std::unique_ptr<const Tracer> trace_blobs(std::span<const Sphere> spheres, double blend_mm, const Context& context) {
  return std::make_unique<const Blobs>(spheres, blend_mm, context);
}

}  // namespace spherule
