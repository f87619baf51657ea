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
#include <utility>

#include "core/ball_cell.h"
#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/box_tree.h"
#include "core/measure.h"
#include "core/predicates.h"

namespace spherule {

namespace {

// Planes that touch a ball in less than this part of its radius are taken to miss it, or to leave nothing of it: what
// they cut off has an area below 2^-38 of the ball's, and a disk too small to be placed well (see BallCell::measure).
constexpr double kTangent = 1 - 0x1p-40;

// A ball as seen from the centre of another, which has the lower power where normal · x <= offset.
struct Rival {
  double offset;
  std::uint32_t ball;
  Vec3 normal;
  double height;  // of the plane over the pivot
};

// Adds `other` if it bounds the cell of `ball`; true if it hides the ball. Of balls with one centre the larger counts,
// of identical ones that with the lower number.
bool add_rival(const Sphere& ball, const Sphere& other, std::uint32_t number, std::uint32_t other_number,
               std::vector<Rival>& rivals) {
  const Vec3 d = other.centre - ball.centre;
  const double distance = norm(d);
  const double larger = (ball.radius - other.radius) * (ball.radius + other.radius);
  if (!(distance > 0)) return larger < 0 || (larger == 0 && other_number < number);
  const double offset = (distance + larger / distance) / 2;
  if (offset <= -kTangent * ball.radius) return true;
  if (offset < kTangent * ball.radius)
    rivals.push_back({.offset = offset, .ball = other_number, .normal = (1 / distance) * d, .height = 0});
  return false;
}

// One thread's memory.
struct Workshop {
  BallCell cell;
  std::vector<Rival> rivals;
  std::vector<std::size_t> nearby;
};

// Neighbours in the tree's order ask it together.
constexpr std::size_t kTogether = 8;

// Places in the tree's order, as `boxes` are, whose boxes overlap the box of all at [begin, end).
void find_nearby(const BoxTree& tree, std::span<const Box> boxes, std::size_t begin, std::size_t end,
                 std::vector<std::size_t>& nearby) {
  Box together;
  for (std::size_t n = begin; n < end; ++n) {
    together.include(boxes[n].min);
    together.include(boxes[n].max);
  }
  nearby.clear();
  tree.for_each_overlap(together, [&](std::size_t place) { nearby.push_back(place); });
}

// Cuts by the planes nearest to the pivot, a point of the cell, first: most others then lie beyond what is left.
bool cut_by_rivals(Workshop& shop, Vec3 pivot) {
  for (Rival& rival : shop.rivals) rival.height = rival.offset - dot(rival.normal, pivot);
  std::sort(shop.rivals.begin(), shop.rivals.end(), [](const Rival& a, const Rival& b) {
    return a.height != b.height ? a.height < b.height : a.ball < b.ball;
  });
  std::uint32_t previous = no_cell;
  for (const Rival& rival : shop.rivals) {
    if (rival.height >= shop.cell.reach()) break;
    // A ball with several caps is met at each.
    if (rival.ball != std::exchange(previous, rival.ball) && !shop.cell.cut(rival.normal, rival.offset)) return false;
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

Vec3 to_vec3(LatticePoint p) { return {double(p.x), double(p.y), double(p.z)}; }

// In lattice units.
class RawUnion {
 public:
  RawUnion(const SphereModel& model, const Context& context)
      : solid_(*model.solid),
        points_(solid_.boundary.points),
        cells_(std::span(solid_.cells).first(solid_.inside_count)),
        spheres_(model.spheres),
        context_(context) {
    Context quiet = context;
    quiet.progress = nullptr;
    across_ = neighbours(cells_, points_.size(), quiet);
  }

  UnionMeasures measure() {
    UnionMeasures result;
    result.parts.resize(cells_.size());
    measure_cells(result);
    group_cells();
    collect_caps();
    add_caps(result);
    to_patient(result);
    return result;
  }

 private:
  // Seen from the cell's fourth corner, the apex, the corners are clockwise: the normal points away from it.
  struct Facet {
    std::array<Vec3, 3> corners;
    Vec3 apex;
    Vec3 normal;  // of length 1

    double offset_from(Vec3 centre) const { return dot(normal, corners[0] - centre); }
    Vec3 middle() const { return (1.0 / 3) * (corners[0] + corners[1] + corners[2]); }
  };
  // What a group's ball has beyond one of its boundary facets.
  struct Cap {
    Sphere ball;
    std::uint32_t cell, facet, group;
  };

  // Exact but for the normal, whose cross product is exact too: differences have 25 bits.
  Facet facet(std::uint32_t cell, std::size_t opposite) const {
    // The other three in the order that keeps the cell positive with the apex last.
    static constexpr std::array<std::array<std::uint8_t, 3>, 4> kOthers{{{1, 3, 2}, {0, 2, 3}, {0, 3, 1}, {0, 1, 2}}};
    const Tetrahedron& t = cells_[cell];
    Facet f{.corners = {}, .apex = to_vec3(points_[t[opposite]]), .normal = {}};
    for (std::size_t v = 0; v < 3; ++v) f.corners[2 - v] = to_vec3(points_[t[kOthers[opposite][v]]]);
    f.normal = normalised(cross(f.corners[1] - f.corners[0], f.corners[2] - f.corners[0]));
    return f;
  }
  bool coplanar(std::uint32_t cell, std::size_t opposite, std::uint32_t other, std::size_t other_opposite) const {
    const Tetrahedron &t = cells_[cell], &u = cells_[other];
    for (std::size_t v = 1; v < 4; ++v) {
      if (exact::orientation(points_[t[(opposite + 1) % 4]], points_[t[(opposite + 2) % 4]],
                             points_[t[(opposite + 3) % 4]], points_[u[(other_opposite + v) % 4]]) != 0)
        return false;
    }
    return true;
  }
  bool on_boundary(std::uint32_t cell) const {
    return std::ranges::find(across_[cell], no_cell) != across_[cell].end();
  }

  void measure_cells(UnionMeasures& result) {
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t c = begin; c < end; ++c) {
        const auto& [i, j, k, l] = cells_[c];
        result.parts[c].volume_mm3 =
            static_cast<double>(exact::six_volumes(points_[i], points_[j], points_[k], points_[l])) / 6;
      }
    });
  }

  // Cells that share a sphere (the rule on a grid) are one ball over a polytope: between them is no plane of equal
  // power that could be computed. So are cells whose balls differ by less than 2^-27 radii, where it could not be well
  // enough; taking one for the other moves a cap by that.
  void group_cells() {
    group_.assign(cells_.size(), no_cell);
    std::vector<std::uint32_t> reached;
    for (std::uint32_t c = 0; c < cells_.size(); ++c) {
      if (group_[c] != no_cell || !on_boundary(c)) continue;
      group_[c] = c;
      reached.assign(1, c);
      for (std::size_t next = 0; next < reached.size(); ++next) {
        const Sphere& ball = spheres_[reached[next]];
        const double near = 0x1p-27 * ball.radius;
        for (const std::uint32_t other : across_[reached[next]]) {
          if (other == no_cell || group_[other] != no_cell) continue;
          if (squared_norm(spheres_[other].centre - ball.centre) > near * near) continue;
          group_[other] = c;
          reached.push_back(other);
        }
      }
      if (reached.size() == 1) continue;
      for (const std::uint32_t member : reached) members_.push_back({c, member});
    }
    std::sort(members_.begin(), members_.end());
  }

  // Calls visit(cell) for the cells of a group, ascending.
  template <typename Visit>
  void for_each_member(std::uint32_t group, Visit&& visit) const {
    auto m = std::lower_bound(members_.begin(), members_.end(), std::pair{group, 0U});
    if (m == members_.end() || m->first != group) return visit(group);
    for (; m != members_.end() && m->first == group; ++m) visit(m->second);
  }

  void collect_caps() {
    auto pieces = one_a_piece<std::pair<std::vector<Cap>, std::vector<Box>>>(cells_.size());
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      auto& [caps, boxes] = pieces[begin / kGrain];
      for (auto c = static_cast<std::uint32_t>(begin); c < end; ++c) {
        if (!on_boundary(c)) continue;
        const auto& [i, j, k, l] = cells_[group_[c]];
        const Sphere ball = circumsphere({points_[i], points_[j], points_[k], points_[l]});
        for (std::uint32_t v = 0; v < 4; ++v) {
          if (across_[c][v] != no_cell) continue;
          const Facet f = facet(c, v);
          const double offset = f.offset_from(ball.centre);
          if (offset >= kTangent * ball.radius) continue;
          caps.push_back({ball, c, v, group_[c]});
          boxes.push_back(moved(cap_box(ball.radius, f.normal, std::max(offset, -ball.radius)), ball.centre));
        }
      }
    });
    for (auto& [caps, boxes] : pieces) {
      caps_.insert(caps_.end(), caps.begin(), caps.end());
      boxes_.insert(boxes_.end(), boxes.begin(), boxes.end());
      caps = {};
      boxes = {};
    }
  }

  // The cap's ball beyond its facet, but not beyond the group's other facets: inner ones end the ball's cell, and what
  // is beyond two outer ones is the first one's. False when nothing remains.
  bool start_cell(const Cap& cap, const Box& box, const Facet& base, BallCell& cell) const {
    const Sphere& ball = cap.ball;
    const Vec3 pivot = base.middle() - ball.centre;
    if (is_alone(cap)) {
      const double height = dot(base.normal, base.corners[0] - base.apex);
      const double top = 1.001 * ball.radius - base.offset_from(ball.centre);
      // Of flatter cells the frustum's far corners are too far away for the tolerance of cuts.
      if (top < 32 * height) {
        cell.reset(base.corners, base.apex, 1 + top / height, ball.centre, pivot);
        return true;
      }
    }
    cell.reset(moved(box, -ball.centre), pivot);
    bool some = cell.cut(-base.normal, -base.offset_from(ball.centre));
    for_each_member(cap.group, [&](std::uint32_t member) {
      for (std::uint32_t i = 0; i < 4 && some; ++i) {
        const std::uint32_t other = across_[member][i];
        if (other == no_cell ? std::pair{member, i} >= std::pair{cap.cell, cap.facet} : group_[other] == cap.group)
          continue;
        const Facet f = facet(member, i);
        some = !(other == no_cell && coplanar(cap.cell, cap.facet, member, i)) &&
               cell.cut(f.normal, f.offset_from(ball.centre));
      }
    });
    return some;
  }
  // Whether the cell has no other boundary facet and its ball no other cell.
  bool is_alone(const Cap& cap) const {
    const auto& across = across_[cap.cell];
    return std::ranges::count(across, no_cell) == 1 &&
           std::ranges::none_of(across, [&](std::uint32_t o) { return o != no_cell && group_[o] == cap.group; });
  }

  void add_caps(UnionMeasures& result) {
    const BoxTree tree(boxes_);
    std::vector<Cap> caps(caps_.size());
    std::vector<Box> boxes(caps_.size());
    for (std::size_t n = 0; n < caps.size(); ++n) {
      caps[n] = caps_[tree.order()[n]];
      boxes[n] = boxes_[tree.order()[n]];
    }
    std::vector<BallPart> parts(caps.size());
    auto pieces = one_a_piece<Moments>(caps.size());
    parallel_for(context_, "union", caps.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Workshop shop;
      for (std::size_t n = begin; n < end; ++n) {
        if (n % kTogether == 0) find_nearby(tree, boxes, n, std::min(end, n + kTogether), shop.nearby);
        const Cap& cap = caps[n];
        const Sphere& ball = cap.ball;
        const Box& box = boxes[n];
        const Facet base = facet(cap.cell, cap.facet);
        if (!start_cell(cap, box, base, shop.cell)) continue;
        shop.rivals.clear();
        bool hidden = false;
        for (const std::size_t o : shop.nearby) {
          const Cap& other = caps[o];
          if (other.group == cap.group || !overlap(box, boxes[o])) continue;
          hidden |= add_rival(ball, other.ball, cap.group, other.group, shop.rivals);
        }
        if (hidden || !cut_by_rivals(shop, base.middle() - ball.centre)) continue;
        const BallPiece piece = shop.cell.measure(ball.radius);
        parts[n] = {piece.moments.volume, piece.area, piece.push};
        pieces[begin / kGrain] += translated(piece.moments, ball.centre - kMiddle);
      }
    });
    for (std::size_t n = 0; n < caps.size(); ++n) {
      BallPart& part = result.parts[caps[n].cell];
      part.volume_mm3 += parts[n].volume_mm3;
      part.area_mm2 += parts[n].area_mm2;
      part.push_mm2 = part.push_mm2 + parts[n].push_mm2;
    }
    result.moments = sum(pieces);
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
    result.moments += tetrahedra_moments(solid_, context_);
  }

  static constexpr Vec3 kMiddle{0x1p23, 0x1p23, 0x1p23};

  const Solid& solid_;
  const std::vector<LatticePoint>& points_;
  std::span<const Tetrahedron> cells_;
  std::span<const Sphere> spheres_;  // in mm
  const Context& context_;
  std::vector<std::array<std::uint32_t, 4>> across_;  // among the inside cells alone
  std::vector<std::uint32_t> group_;                  // a cell of the same ball, for cells of a ball with caps
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
  std::vector<Sphere> sorted(solid_balls.size());
  std::vector<Box> sorted_boxes(solid_balls.size());
  for (std::size_t n = 0; n < sorted.size(); ++n) {
    sorted[n] = balls[solid_balls[tree.order()[n]]];
    sorted_boxes[n] = boxes[tree.order()[n]];
  }
  auto pieces = one_a_piece<Moments>(sorted.size());
  parallel_for(context, "union", sorted.size(), kGrain, [&](std::size_t begin, std::size_t end) {
    Workshop shop;
    for (std::size_t n = begin; n < end; ++n) {
      if (n % kTogether == 0) find_nearby(tree, sorted_boxes, n, std::min(end, n + kTogether), shop.nearby);
      const Sphere& ball = sorted[n];
      const std::uint32_t i = solid_balls[tree.order()[n]];
      shop.rivals.clear();
      bool hidden = false;
      for (const std::size_t o : shop.nearby) {
        const double reach = ball.radius + sorted[o].radius;
        if (o == n || squared_norm(sorted[o].centre - ball.centre) >= reach * reach) continue;
        hidden |= add_rival(ball, sorted[o], i, solid_balls[tree.order()[o]], shop.rivals);
      }
      if (hidden) continue;
      shop.cell.reset(ball.radius);
      if (!cut_by_rivals(shop, {})) continue;
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
