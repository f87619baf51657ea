// SPDX-License-Identifier: GPL-3.0-or-later
//
// Why the caps are all of a raw union beyond its inside cells. Let x be in the ball of inside cell s, and walk straight
// from a point of s to x. Across each facet that the walk passes, the next cell's ball has the lower power from there
// on, so powers at x fall along the cells passed.
//  - x in no inside cell: the last inside cell before x holds x in its ball, and x is beyond the boundary facet through
//    which the walk left it: a cap. Where caps overlap, the ball of least power has x.
//  - x in an inside cell: x is counted there. A cap over the facet f of cell s must not count it again. If the walk
//  from
//    s to x leaves s through a facet to another inside cell, x is beyond that facet's plane, and caps end there. Else
//    it leaves the solid and enters it again through a boundary facet of some cell t, whose ball has the lower power at
//    x: caps end at the planes of equal power with all balls whose caps they meet, and the cap of t's facet holds the
//    facet.
#include "core/union.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <numeric>

#include "core/ball_cell.h"
#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/box_tree.h"
#include "core/predicates.h"

namespace spherule {

namespace {

// Planes that touch a ball in less than this part of its radius are taken to miss it, or to leave nothing of it: what
// they cut off has an area below 2^-38 of the ball's, and a disk too small to be placed well (see BallCell::measure).
constexpr double kTangent = 1 - 0x1p-40;

// A ball whose power is equal on a plane, as seen from another ball: normal · x <= offset is the other's.
struct Rival {
  double offset;
  std::uint32_t ball;
  Vec3 normal;
};

enum class Meeting : std::uint8_t { apart, divided, hidden };

// How `other` bounds the cell of `ball`. Of balls with one centre the larger counts, of identical ones that with
// `first`.
Meeting meet(const Sphere& ball, const Sphere& other, bool first, Rival& rival) {
  const Vec3 d = other.centre - ball.centre;
  const double distance = norm(d);
  const double larger = (ball.radius - other.radius) * (ball.radius + other.radius);
  if (!(distance > 0)) {
    if (larger == 0) return first ? Meeting::apart : Meeting::hidden;
    return larger > 0 ? Meeting::apart : Meeting::hidden;
  }
  rival.offset = (distance + larger / distance) / 2;
  if (rival.offset >= kTangent * ball.radius) return Meeting::apart;
  if (rival.offset <= -kTangent * ball.radius) return Meeting::hidden;
  rival.normal = (1 / distance) * d;
  return Meeting::divided;
}

// One thread's memory.
struct Workshop {
  BallCell cell;
  std::vector<Rival> rivals;
};

// Cuts by the nearest planes first: the others then mostly lie beyond what is left.
bool cut_by_rivals(Workshop& shop) {
  std::sort(shop.rivals.begin(), shop.rivals.end(), [](const Rival& a, const Rival& b) {
    return a.offset != b.offset ? a.offset < b.offset : a.ball < b.ball;
  });
  for (const Rival& rival : shop.rivals) {
    if (rival.offset >= shop.cell.reach()) break;
    if (!shop.cell.cut(rival.normal, rival.offset)) return false;
  }
  return true;
}

Box box_of(const Sphere& s) {
  Box box;
  box.include(s);
  return box;
}

Box moved(const Box& box, Vec3 by) { return {box.min + by, box.max + by}; }

Vec3 middle(const Box& box) { return 0.5 * (box.min + box.max); }

constexpr std::size_t kGrain = 1 << 11;

template <typename Part>
std::vector<Part> one_a_piece(std::size_t count) {
  return std::vector<Part>((count + kGrain - 1) / kGrain);
}

Moments sum(const std::vector<Moments>& pieces) {
  Moments total;
  for (const Moments& m : pieces) total += m;
  return total;
}

// ------------------------------------------------------------------------------------------------------- raw models

// Everything is in lattice units.
struct Facet {
  std::array<std::uint32_t, 3> corners;
  Vec3 normal;  // outward, of length 1
};

Vec3 to_vec3(LatticePoint p) { return {double(p.x), double(p.y), double(p.z)}; }

class RawUnion {
 public:
  RawUnion(const SphereModel& model, const Context& context)
      : solid_(*model.solid),
        points_(solid_.boundary.points),
        cells_(std::span(solid_.cells).first(solid_.inside_count)),
        context_(context) {
    Context quiet = context;
    quiet.progress = nullptr;
    across_ = neighbours(cells_, points_.size(), quiet);
  }

  UnionMeasures measure() {
    UnionMeasures result;
    result.parts.resize(cells_.size());
    add_cells(result);
    group_cells();
    collect_caps();
    add_caps(result);
    to_patient(result);
    return result;
  }

 private:
  struct Cap {
    std::uint32_t cell, facet, ball;
  };

  Facet facet(std::uint32_t cell, std::size_t opposite) const {
    using exact::operator-;
    const Tetrahedron& t = cells_[cell];
    Facet f{.corners = {t[(opposite + 1) % 4], t[(opposite + 2) % 4], t[(opposite + 3) % 4]}, .normal = {}};
    const LatticePoint a = points_[f.corners[0]];
    const exact::Difference n = exact::cross(points_[f.corners[1]] - a, points_[f.corners[2]] - a);
    f.normal = normalised(Vec3{double(n.x), double(n.y), double(n.z)});
    // Corner `opposite` is on the inner side.
    if (exact::dot<exact::Wide>(points_[t[opposite]] - a, n) > 0) f.normal = -f.normal;
    return f;
  }
  double offset_from(const Facet& f, Vec3 centre) const {
    return dot(f.normal, to_vec3(points_[f.corners[0]]) - centre);
  }
  bool coplanar(const Facet& f, const Facet& g) const {
    const LatticePoint a = points_[f.corners[0]], b = points_[f.corners[1]], c = points_[f.corners[2]];
    return std::ranges::all_of(g.corners,
                               [&](std::uint32_t v) { return exact::orientation(a, b, c, points_[v]) == 0; });
  }

  // About the middle of the lattice.
  void add_cells(UnionMeasures& result) {
    auto pieces = one_a_piece<Moments>(cells_.size());
    std::vector<exact::Wide> six_volumes(pieces.size(), 0);
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Moments& piece = pieces[begin / kGrain];
      for (std::size_t c = begin; c < end; ++c) {
        const auto& [i, j, k, l] = cells_[c];
        const exact::Wide six = exact::six_volumes(points_[i], points_[j], points_[k], points_[l]);
        six_volumes[begin / kGrain] += six;
        const double volume = static_cast<double>(six) / 6;
        result.parts[c].volume_mm3 = volume;
        Vec3 total;
        for (const std::uint32_t v : cells_[c]) {
          const Vec3 p = to_vec3(points_[v]) - kMiddle;
          total = total + p;
          for (std::size_t a = 0; a < 3; ++a)
            piece.second.rows[a] = piece.second.rows[a] + (volume / 20 * p[static_cast<int>(a)]) * p;
        }
        piece.first = piece.first + (volume / 4) * total;
        for (std::size_t a = 0; a < 3; ++a)
          piece.second.rows[a] = piece.second.rows[a] + (volume / 20 * total[static_cast<int>(a)]) * total;
      }
    });
    result.moments = sum(pieces);
    result.moments.volume =
        static_cast<double>(std::accumulate(six_volumes.begin(), six_volumes.end(), exact::Wide{0})) / 6;
  }

  // Cells that share a sphere (the rule on a grid) are one ball over a polytope: between them is no plane of equal
  // power that could be computed. So are cells whose balls differ by less than 2^-27 radii, where it could not be well
  // enough; taking one for the other moves a cap by that.
  void group_cells() {
    group_.resize(cells_.size());
    std::iota(group_.begin(), group_.end(), 0U);
    const auto find = [&](std::uint32_t c) {
      while (group_[c] != c) c = group_[c] = group_[group_[c]];
      return c;
    };
    balls_.resize(cells_.size());
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t c = begin; c < end; ++c) {
        const auto& [i, j, k, l] = cells_[c];
        balls_[c] = circumsphere({points_[i], points_[j], points_[k], points_[l]});
      }
    });
    for (std::uint32_t c = 0; c < cells_.size(); ++c) {
      for (const std::uint32_t other : across_[c]) {
        if (other == no_cell || other < c) continue;
        const double near = 0x1p-27 * balls_[c].radius;
        if (squared_norm(balls_[other].centre - balls_[c].centre) > near * near) continue;
        const std::uint32_t a = find(c), b = find(other);
        group_[std::max(a, b)] = std::min(a, b);
      }
    }
    for (std::uint32_t c = 0; c < cells_.size(); ++c) {
      group_[c] = find(c);
      if (group_[c] != c) members_.push_back({group_[c], c});
    }
    for (std::size_t m = 0, n = members_.size(); m < n; ++m) members_.push_back({members_[m].first, members_[m].first});
    std::sort(members_.begin(), members_.end());
    members_.erase(std::unique(members_.begin(), members_.end()), members_.end());
  }

  // Calls visit(cell) for the cells of a group, ascending.
  template <typename Visit>
  void for_each_member(std::uint32_t group, Visit&& visit) const {
    auto m = std::lower_bound(members_.begin(), members_.end(), std::pair{group, 0U});
    if (m == members_.end() || m->first != group) return visit(group);
    for (; m != members_.end() && m->first == group; ++m) visit(m->second);
  }

  void collect_caps() {
    for (std::uint32_t c = 0; c < cells_.size(); ++c) {
      for (std::uint32_t i = 0; i < 4; ++i) {
        if (across_[c][i] != no_cell) continue;
        const Sphere& ball = balls_[group_[c]];
        const Facet f = facet(c, i);
        const double offset = offset_from(f, ball.centre);
        if (offset >= kTangent * ball.radius) continue;
        caps_.push_back({c, i, group_[c]});
        boxes_.push_back(moved(cap_box(ball.radius, f.normal, std::max(offset, -ball.radius)), ball.centre));
      }
    }
  }

  // The cap's ball beyond its facet, but not beyond the group's other facets: inner ones end the ball's cell, and what
  // is beyond two outer ones is the first one's. False when nothing remains.
  bool start_cell(const Cap& cap, const Box& box, BallCell& cell) const {
    const Sphere& ball = balls_[cap.ball];
    const Facet base = facet(cap.cell, cap.facet);
    cell.reset(moved(box, -ball.centre));
    bool some = cell.cut(-base.normal, -offset_from(base, ball.centre));
    for_each_member(cap.ball, [&](std::uint32_t member) {
      for (std::uint32_t i = 0; i < 4 && some; ++i) {
        const std::uint32_t other = across_[member][i];
        if (other == no_cell ? std::pair{member, i} >= std::pair{cap.cell, cap.facet} : group_[other] == cap.ball)
          continue;
        const Facet f = facet(member, i);
        some = !(other == no_cell && coplanar(base, f)) && cell.cut(f.normal, offset_from(f, ball.centre));
      }
    });
    return some;
  }

  void add_caps(UnionMeasures& result) {
    const BoxTree tree(boxes_);
    std::vector<BallPart> parts(caps_.size());
    auto pieces = one_a_piece<Moments>(caps_.size());
    parallel_for(context_, "union", caps_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Workshop shop;
      for (std::size_t n = begin; n < end; ++n) {
        const std::uint32_t c = tree.order()[n];
        const Cap& cap = caps_[c];
        const Sphere& ball = balls_[cap.ball];
        if (!start_cell(cap, boxes_[c], shop.cell)) continue;
        shop.rivals.clear();
        bool hidden = false;
        tree.for_each_overlap(boxes_[c], [&](std::uint32_t o) {
          const std::uint32_t other = caps_[o].ball;
          if (other == cap.ball || hidden) return;
          Rival rival{.offset = 0, .ball = other, .normal = {}};
          const Meeting meeting = meet(ball, balls_[other], cap.ball < other, rival);
          hidden |= meeting == Meeting::hidden;
          if (meeting == Meeting::divided) shop.rivals.push_back(rival);
        });
        if (hidden || !cut_by_rivals(shop)) continue;
        const BallPiece piece = shop.cell.measure(ball.radius);
        parts[c] = {piece.moments.volume, piece.area, piece.push};
        pieces[begin / kGrain] += translated(piece.moments, ball.centre - kMiddle);
      }
    });
    for (std::size_t c = 0; c < caps_.size(); ++c) {
      BallPart& part = result.parts[caps_[c].cell];
      part.volume_mm3 += parts[c].volume_mm3;
      part.area_mm2 += parts[c].area_mm2;
      part.push_mm2 = part.push_mm2 + parts[c].push_mm2;
    }
    result.moments += sum(pieces);
  }

  void to_patient(UnionMeasures& result) const {
    const Lattice& lattice = solid_.boundary.lattice;
    const double u = lattice.unit_mm;
    const Mat3& axes = lattice.grid.direction;
    for (BallPart& part : result.parts) {
      part.volume_mm3 *= u * u * u;
      part.area_mm2 *= u * u;
      part.push_mm2 = (u * u) * (axes * part.push_mm2);
      result.area_mm2 += part.area_mm2;
    }
    result.moments = translated(transformed(result.moments, axes, u), lattice.to_patient(kMiddle));
  }

  static constexpr Vec3 kMiddle{0x1p23, 0x1p23, 0x1p23};

  const Solid& solid_;
  const std::vector<LatticePoint>& points_;
  std::span<const Tetrahedron> cells_;
  const Context& context_;
  std::vector<std::array<std::uint32_t, 4>> across_;              // among the inside cells alone
  std::vector<Sphere> balls_;                                     // of every cell
  std::vector<std::uint32_t> group_;                              // of every cell, by its first one
  std::vector<std::pair<std::uint32_t, std::uint32_t>> members_;  // group and cell, for groups of several
  std::vector<Cap> caps_;
  std::vector<Box> boxes_;  // of the caps
};

}  // namespace

UnionMeasures measure_union(std::span<const Sphere> balls, const Context& context) {
  UnionMeasures result;
  result.parts.resize(balls.size());
  std::vector<Box> boxes;
  std::vector<std::uint32_t> solid_balls;  // points have no part, and bound none
  Box all;
  for (std::uint32_t i = 0; i < balls.size(); ++i) {
    if (!(balls[i].radius > 0)) continue;
    solid_balls.push_back(i);
    boxes.push_back(box_of(balls[i]));
    all.include(balls[i]);
  }
  if (solid_balls.empty()) return result;
  const Vec3 origin = middle(all);
  const BoxTree tree(boxes);
  auto pieces = one_a_piece<Moments>(solid_balls.size());
  parallel_for(context, "union", solid_balls.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    Workshop shop;
    for (std::size_t n = begin; n < end; ++n) {
      const std::uint32_t entry = tree.order()[n], i = solid_balls[entry];
      const Sphere& ball = balls[i];
      shop.rivals.clear();
      bool hidden = false;
      tree.for_each_overlap(boxes[entry], [&](std::uint32_t other_entry) {
        const std::uint32_t j = solid_balls[other_entry];
        const double reach = ball.radius + balls[j].radius;
        if (j == i || hidden || squared_norm(balls[j].centre - ball.centre) >= reach * reach) return;
        Rival rival{.offset = 0, .ball = j, .normal = {}};
        const Meeting meeting = meet(ball, balls[j], i < j, rival);
        hidden |= meeting == Meeting::hidden;
        if (meeting == Meeting::divided) shop.rivals.push_back(rival);
      });
      if (hidden) continue;
      shop.cell.reset(moved(boxes[entry], -ball.centre));
      if (!cut_by_rivals(shop)) continue;
      const BallPiece piece = shop.cell.measure(ball.radius);
      result.parts[i] = {piece.moments.volume, piece.area, piece.push};
      pieces[begin / kGrain] += translated(piece.moments, ball.centre - origin);
    }
  });
  for (const BallPart& part : result.parts) result.area_mm2 += part.area_mm2;
  result.moments = translated(sum(pieces), origin);
  return result;
}

UnionMeasures measure_raw_union(const SphereModel& model, const Context& context) {
  SPHERULE_CHECK(model.solid.has_value());
  return RawUnion(model, context).measure();
}

UnionMeasures measure_union(const SphereModel& model, const Context& context) {
  return model.solid ? measure_raw_union(model, context) : measure_union(std::span(model.spheres), context);
}

}  // namespace spherule
