// SPDX-License-Identifier: GPL-3.0-or-later
//
// Balls blended into each other. Ball i, of radius r, sends out the field
//   f(x) = ((R² - d²) / (R² - r²))²   for the distance d of x from its centre below R = r + b,  0 beyond,
// which is 1 on the ball; the blob is where the sum of all fields is at least 1. So the blob holds every ball, and is
// held by the balls grown by the blending distance b: as b goes to 0 it becomes their union.
//
// Along a ray each field is the square of a quadratic between two places and 0 elsewhere: the sum is a quartic between
// neighbouring places. Its Bernstein coefficients on such a piece are sums of products without cancellation. No sign
// among them means no root, one change of sign means one root, and other pieces are halved: no root is missed.
//
// Sources: G. Wyvill, C. McPheeters, B. Wyvill, Data structure for soft objects (1986): fields of finite support;
// J. Lane, R. Riesenfeld, Bounds on a polynomial (1981): signs of Bernstein coefficients count roots.
#include <algorithm>
#include <array>
#include <cmath>
#include <optional>

#include "core/render/trace.h"

namespace spherule {
namespace {

struct Source {
  Vec3 centre;
  double squared_ball = 0, squared_reach = 0;
  double strength = 0;  // 1 / (R² - r²)²
};

// A ray's way through one field.
struct Passage {
  double in = 0, out = 0;
  double peak = 0;  // the field half way
  std::uint32_t source = 0;
};

// The sum's excess over 1 on a piece of a ray, by its Bernstein coefficients.
using Quartic = std::array<double, 5>;

std::pair<Quartic, Quartic> halves(const Quartic& c) {
  Quartic left, right, d = c;
  for (std::size_t level = 0; level < 5; ++level) {
    left[level] = d[0];
    right[4 - level] = d[4 - level];
    for (std::size_t i = 0; i + level < 4; ++i) d[i] = 0.5 * (d[i] + d[i + 1]);
  }
  return {left, right};
}

int changes_of_sign(const Quartic& c) {
  int changes = 0;
  for (std::size_t i = 1; i < 5; ++i) changes += (c[i - 1] < 0) != (c[i] < 0);
  return changes;
}

// The one root of a piece that begins below 0 and ends at or above it: Newton's steps where they stay between the
// bounds, else half way.
double only_root(const Quartic& c) {
  double low = 0, high = 1, u = c[0] / (c[0] - c[4]);
  for (int i = 0; i < 60 && high - low > 1e-14; ++i) {
    // By de Casteljau: the value, and the slope from the last two points.
    Quartic d = c;
    for (std::size_t level = 4; level > 1; --level)
      for (std::size_t k = 0; k < level; ++k) d[k] += u * (d[k + 1] - d[k]);
    const double step = d[1] - d[0], v = d[0] + u * step, slope = 4 * step;
    if (std::abs(v) < 1e-14) break;
    (v < 0 ? low : high) = u;
    const double next = u - v / slope;
    u = slope > 0 && next > low && next < high ? next : 0.5 * (low + high);
  }
  return u;
}

// A piece that holds one rise from below to 0 or above.
struct Rise {
  Quartic piece;
  double from = 0, width = 1;  // of the whole that it was halved from
  double place() const { return piece[0] >= 0 ? from : from + width * only_root(piece); }
};

// The first rise of a piece. `below`: whether the sum has been below so far; kept up to date.
std::optional<Rise> first_rise(const Rise& on, bool& below, int depth = 0) {
  constexpr int kMostHalvings = 40;
  const Quartic& c = on.piece;
  const auto [least, most] = std::ranges::minmax(c);
  if (!below) {
    if (least >= 0) return std::nullopt;
    if (c[0] < 0) below = true;
  }
  if (below) {
    if (most < 0) return std::nullopt;
    if (c[0] >= 0 || (c[4] >= 0 && changes_of_sign(c) == 1)) return on;
  }
  if (depth == kMostHalvings) {
    below = c[4] < 0;
    return std::nullopt;
  }
  const auto [left, right] = halves(c);
  const double width = 0.5 * on.width;
  if (const auto rise = first_rise({left, on.from, width}, below, depth + 1)) return rise;
  return first_rise({right, on.from + width, width}, below, depth + 1);
}

struct Passages : Lanes {
  std::array<std::vector<Passage>, most> of;
  std::vector<Passage> active;  // at one place of one ray
  std::size_t begin(std::span<const Ray> rays) {
    for (auto& list : of) list.clear();
    return load(rays);
  }
};

class Blobs final : public Tracer, private Primitives {
 public:
  Blobs(std::span<const Sphere> spheres, double blend, const Context& context) {
    Box all;
    for (const Sphere& s : spheres) {
      const double reach = s.radius + blend, gap = blend * (2 * s.radius + blend);
      sources_.push_back({s.centre, s.radius * s.radius, reach * reach, 1 / (gap * gap)});
      if (s.radius > 0) all.include(Sphere{s.centre, reach});
    }
    if (!all.empty()) lift_ = 1e-6 * norm(all.max - all.min);
    hierarchy_.emplace(static_cast<const Primitives&>(*this), context);
  }

  void first_hits(std::span<const Ray> rays, std::span<Hit> hits) const override {
    Passages passages;
    for (std::size_t begin = 0; begin < rays.size(); begin += Lanes::most) {
      const std::size_t count = passages.begin(rays.subspan(begin));
      hierarchy_->nearest(passages, count, true);
      for (std::size_t i = 0; i < count; ++i) {
        if (const auto entry = first_entry(i, passages)) {
          const double distance = entry->from + entry->rise.place() * entry->length;
          hits[begin + i] = {distance, strongest(passages.active, distance)};
        } else {
          // Nothing, or a ball's entry: rounding may hide the rise just before it.
          hits[begin + i] = {passages.far[i], passages.primitive[i]};
        }
      }
    }
  }

  // Whether there is a rise is seen from signs; where it is does not matter.
  void blocked(std::span<const Ray> rays, std::span<std::uint8_t> blocked, bool alike) const override {
    Passages passages;
    for (std::size_t begin = 0; begin < rays.size(); begin += Lanes::most) {
      const std::size_t count = passages.begin(rays.subspan(begin));
      hierarchy_->any(passages, count, alike);
      for (std::size_t i = 0; i < count; ++i)
        blocked[begin + i] = passages.primitive[i] != no_primitive || first_entry(i, passages).has_value();
    }
  }

  bool inside(Vec3 point) const override {
    double sum = 0;
    visit(point, [&](std::uint32_t, double field) { sum += field; });
    return sum >= 1;
  }

  Place place(const Ray& ray, const Hit& hit) const override {
    const Vec3 point = ray.origin + hit.distance * ray.direction;
    Vec3 out;
    visit(point, [&](std::uint32_t i, double) { out = out + outwards(i, point); });
    const double length = norm(out);
    const Vec3 normal = length > 0 ? 1 / length * out : -ray.direction;
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

  // Notes the way through the field. What lies beyond the entry into a ball is beyond the blob's surface.
  void meet(std::uint32_t index, Lanes& lanes, const int* valid, std::size_t begin, std::size_t end) const override {
    const Source& s = sources_[index];
    if (!(s.squared_ball > 0)) return;
    auto& passages = static_cast<Passages&>(lanes);
    for (std::size_t k = begin; k < end; ++k) {
      if (valid[k] == 0) continue;
      const Vec3 direction{lanes.dx[k], lanes.dy[k], lanes.dz[k]};
      const Vec3 v = s.centre - Vec3{lanes.ox[k], lanes.oy[k], lanes.oz[k]};
      const double along = dot(v, direction), off = squared_norm(v - along * direction);
      if (!(s.squared_reach > off)) continue;
      const double squared_half = s.squared_reach - off, half = std::sqrt(squared_half);
      if (along + half <= 0 || along - half > lanes.far[k]) continue;
      passages.of[k].push_back({along - half, along + half, s.strength * squared_half * squared_half, index});
      if (!(s.squared_ball > off)) continue;
      const double entry = along - std::sqrt(s.squared_ball - off);
      if (entry < 0 || entry > lanes.far[k] || (entry == lanes.far[k] && index >= lanes.primitive[k])) continue;
      lanes.far[k] = entry;
      lanes.primitive[k] = index;
    }
  }

  // Calls f(source, field) for every field at a point, in the sources' order.
  template <typename F>
  void visit(Vec3 point, F f) const {
    Passages passages;
    const Ray ray{point, {0, 0, 1}, lift_};
    hierarchy_->nearest(passages, passages.begin(std::span(&ray, 1)), false);
    auto& list = passages.of[0];
    std::ranges::sort(list, {}, &Passage::source);
    list.erase(std::ranges::unique(list, {}, &Passage::source).begin(), list.end());
    for (const Passage& p : list) {
      const Source& s = sources_[p.source];
      const double q = s.squared_reach - squared_norm(point - s.centre);
      if (q > 0) f(p.source, s.strength * q * q);
    }
  }

  Vec3 outwards(std::uint32_t i, Vec3 point) const {
    const Source& s = sources_[i];
    const Vec3 v = point - s.centre;
    return s.strength * (s.squared_reach - squared_norm(v)) * v;
  }

  // The excess of the active fields over 1 between two places of a ray.
  Quartic excess(std::span<const Passage> active, double from, double to) const {
    Quartic sum{-1, -1, -1, -1, -1};
    for (const Passage& p : active) {
      const Source& s = sources_[p.source];
      // The quadratic (t - in)(out - t), in Bernstein form on the piece, then squared.
      const double b0 = std::max(0.0, (from - p.in) * (p.out - from)), b2 = std::max(0.0, (to - p.in) * (p.out - to));
      const double b1 = 0.5 * ((from - p.in) * (p.out - to) + (to - p.in) * (p.out - from));
      sum[0] += s.strength * b0 * b0;
      sum[1] += s.strength * b0 * b1;
      sum[2] += s.strength * (b0 * b2 + 2 * b1 * b1) / 3;
      sum[3] += s.strength * b1 * b2;
      sum[4] += s.strength * b2 * b2;
    }
    return sum;
  }

  // Where a ray first comes from outside to inside, and the part of the ray that it is in.
  struct Entry {
    Rise rise;
    double from = 0, length = 0;
  };

  // Of one lane, up to its `far`; leaves the fields that act there in passages.active.
  std::optional<Entry> first_entry(std::size_t lane, Passages& passages) const {
    auto& list = passages.of[lane];
    const double end = passages.far[lane];
    std::erase_if(list, [&](const Passage& p) { return p.in > end; });
    if (peaks(list) < 1) return std::nullopt;
    std::ranges::sort(
        list, [](const Passage& a, const Passage& b) { return a.in != b.in ? a.in < b.in : a.source < b.source; });
    // Embree may show a packet a box twice.
    const auto same = [](const Passage& a, const Passage& b) { return a.source == b.source; };
    list.erase(std::unique(list.begin(), list.end(), same), list.end());
    auto& active = passages.active;
    active.clear();
    bool below = true, started = false;
    double from = 0;
    for (std::size_t next = 0; next < list.size() || !active.empty();) {
      if (active.empty()) from = std::max(from, list[next].in);
      while (next < list.size() && list[next].in <= from) active.push_back(list[next++]);
      double to = next < list.size() ? list[next].in : std::numeric_limits<double>::infinity();
      for (const Passage& p : active) to = std::min(to, p.out);
      to = std::min(to, end);
      if (to > from) {
        if (peaks(active) < 1) {
          below = true;
        } else {
          const Rise whole{excess(active, from, to)};
          // A ray may start inside; it has not entered then.
          if (!started) below = whole.piece[0] < 0;
          if (const auto rise = first_rise(whole, below)) return Entry{*rise, from, to - from};
        }
        started = true;
      }
      if (!(to < end)) break;
      from = to;
      std::erase_if(active, [&](const Passage& p) { return p.out <= from; });
    }
    return std::nullopt;
  }

  // No less than the sum of these fields anywhere on the ray.
  static double peaks(std::span<const Passage> passages) {
    double sum = 0;
    for (const Passage& p : passages) sum += p.peak;
    return sum;
  }

  std::uint32_t strongest(std::span<const Passage> active, double distance) const {
    std::uint32_t best = active.front().source;
    double most = -1;
    for (const Passage& p : active) {
      const double q = (distance - p.in) * (p.out - distance);
      const double field = sources_[p.source].strength * q * q;
      if (field > most) most = field, best = p.source;
    }
    return best;
  }

  std::vector<Source> sources_;
  double lift_ = 0;
  std::optional<Hierarchy> hierarchy_;
};

}  // namespace

std::unique_ptr<const Tracer> trace_blobs(std::span<const Sphere> spheres, double blend_mm, const Context& context) {
  return std::make_unique<const Blobs>(spheres, blend_mm, context);
}

}  // namespace spherule
