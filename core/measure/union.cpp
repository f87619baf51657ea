// SPDX-License-Identifier: GPL-3.0-or-later
//
// Why a raw union is its inside cells and caps: the parts of their balls beyond their boundary facets. Let x be in the
// ball of inside cell s, and walk straight from a point of s to x. Across each facet that the walk passes, the next
// cell's ball has the lower power from there on, so powers at x fall along the cells passed.
//  - x in no inside cell: the last inside cell before x holds x in its ball, and x is beyond the boundary facet through
//    which the walk left it: a cap. Where caps overlap, the ball of least power has x.
//  - x in an inside cell: x is counted there. A cap over the facet f of cell s must not count it again. If the walk
//  from s
//    to x leaves s through a facet to another inside cell, x is beyond that facet's plane, and caps end there. Else it
//    leaves the solid and enters it again through a boundary facet of some cell t, whose ball has the lower power at x:
//    caps end at the planes of equal power with all balls whose caps they meet, and the cap of t's facet holds the
//    facet.
// So a ball's part is its own within the planes of its cell's inner facets and those of equal power with all balls
// whose caps meet one of its own.
#include "core/measure/union.h"

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <functional>
#include <limits>
#include <numeric>
#include <optional>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/measure/ball_cell.h"
#include "core/measure/power.h"
#include "core/measure/solid.h"
#include "core/predicates.h"
#include "core/trees/box_tree.h"

namespace spherule {

namespace {

// Planes that touch a ball in less than this part of its radius are taken to miss it, or to leave nothing of it: what
// they cut off has an area below 2^-38 of the ball's, and a disk too small to be placed well (see BallCell::measure).
constexpr double kTangent = 1 - 0x1p-40;

// A ball as seen from the centre of another, which has the lower power where normal · x <= offset.
struct Rival {
  Vec3 normal;
  double offset;
};

// Rivals in the order in which their planes cut.
class Rivals {
 public:
  void clear() {
    rivals_.clear();
    order_.clear();
  }
  // The height is that of the plane over the pivot; among equal ones the number decides.
  void add(const Rival& rival, double height, std::uint32_t number) {
    order_.push_back({height, number, static_cast<std::uint32_t>(rivals_.size())});
    rivals_.push_back(rival);
  }
  void sort(Poll& poll) { std::sort(order_.begin(), order_.end(), Polled(poll, std::less<>())); }

  // False when nothing remains.
  bool cut(BallCell& cell, Poll& poll) const {
    for (const Turn& turn : order_) {
      poll(16);
      if (turn.height >= cell.reach()) break;
      if (!cell.cut(rivals_[turn.place].normal, rivals_[turn.place].offset)) return false;
    }
    return true;
  }

 private:
  struct Turn {
    double height;
    std::uint32_t number, place;

    auto operator<=>(const Turn&) const = default;
  };
  std::vector<Rival> rivals_;
  std::vector<Turn> order_;
};

// What a ball about the origin has beyond a plane: |x| <= radius, normal · x >= offset.
struct Cap {
  Vec3 normal;
  double offset;
  double disk_squared;  // of the plane's disk, by its radius

  Cap(double radius, Vec3 outwards, double where)
      : normal(outwards), offset(where), disk_squared(std::max(0.0, (radius - where) * (radius + where))) {}

  // Whether any of it lies where d · x > half, as some of the ball does. Yes when in doubt.
  bool meets(double radius, Vec3 d, double length, double half) const {
    const double along = dot(d, normal);
    if (along * radius >= offset * length) return true;  // the ball's farthest point along d is in the cap
    // Less far more than rounding.
    const double beyond = half - along * offset - 0x1p-40 * radius * length;
    return beyond <= 0 || beyond * beyond <= (length - along) * (length + along) * disk_squared;
  }
};

struct Member {
  Sphere ball;
  std::uint32_t number;
};

// Adds what a ball takes off another one's cell. False if it hides that one: of balls with one centre the larger
// counts, of identical ones that with the lower number.
template <typename Matters>
bool add_rival(const Member& own, const Member& rival, Vec3 pivot, Rivals& rivals, Matters&& matters) {
  const auto& [ball, number] = own;
  const Sphere& other = rival.ball;
  const Vec3 d = other.centre - ball.centre;
  const double squared = squared_norm(d), reach = ball.radius + other.radius;
  if (squared >= reach * reach) return true;
  const double larger = (ball.radius - other.radius) * reach;
  if (!(squared > 0)) return !(larger < 0 || (larger == 0 && rival.number < number));
  const double distance = std::sqrt(squared), half = (squared + larger) / 2;
  if (!matters(d, distance, half)) return true;
  const double inverse = 1 / distance, offset = half * inverse;
  const Vec3 normal = inverse * d;
  if (offset <= -kTangent * ball.radius) return false;
  if (offset < kTangent * ball.radius) rivals.add({normal, offset}, offset - dot(normal, pivot), rival.number);
  return true;
}

// Many balls, each with a box around the part of it that may count and a number.
class Crowd {
 public:
  Crowd(std::span<const Member> members, std::span<const Box> boxes, const Context& context) : tree_(boxes, context) {
    members_.reserve(members.size());
    for (const std::uint32_t m : tree_.order()) members_.push_back(members[m]);
  }

  // Neighbours in space follow each other.
  const Member& operator[](std::size_t n) const { return members_[n]; }
  std::size_t place_of(std::size_t n) const { return tree_.order()[n]; }

  // Where the rivals of balls that follow each other are looked for.
  struct Vicinity {
    std::size_t leaf = std::numeric_limits<std::size_t>::max();
    std::vector<std::uint32_t> leaves;
  };

  // The balls that bound the cell of ball n, the planes nearest to the pivot first: when the cell is cut by these, most
  // others lie beyond what is left. False if one hides it.
  template <typename Matters>
  bool find_rivals(std::size_t n, const Box& box, Vec3 pivot, Vicinity& vicinity, Rivals& rivals, Poll& poll,
                   Matters&& matters) const {
    look_around(n, vicinity);
    rivals.clear();
    bool visible = true;
    tree_.for_each_overlap(vicinity.leaves, box, [&](std::size_t o) {
      poll();
      visible &= o == n || add_rival(members_[n], members_[o], pivot, rivals, matters);
    });
    if (visible) rivals.sort(poll);
    return visible;
  }

  // At most `most`: how many boxes overlap this one.
  std::size_t count_overlapping(std::size_t n, const Box& box, Vicinity& vicinity, std::size_t most, Poll& poll) const {
    look_around(n, vicinity);
    std::size_t count = 0;
    std::span<const std::uint32_t> leaves = vicinity.leaves;
    while (!leaves.empty() && count < most) {
      const auto some = leaves.first(std::min<std::size_t>(64, leaves.size()));
      tree_.for_each_overlap(some, box, [&](std::size_t) { ++count; });
      poll(8 * some.size());
      leaves = leaves.subspan(some.size());
    }
    return std::min(count, most);
  }

 private:
  void look_around(std::size_t n, Vicinity& vicinity) const {
    if (vicinity.leaf == n / BoxTree::kFan) return;
    vicinity.leaf = n / BoxTree::kFan;
    tree_.find_leaves(tree_.bounds(vicinity.leaf), vicinity.leaves);
  }

  BoxTree tree_;
  std::vector<Member> members_;
};

// One thread's memory.
struct Workshop {
  explicit Workshop(const Context& context) : poll(context, 1 << 13) {}

  Poll poll;
  BallCell cell;
  Crowd::Vicinity vicinity;
  Rivals rivals;
  std::vector<Cap> caps;
};

Box moved(const Box& box, Vec3 by) { return {box.min + by, box.max + by}; }

constexpr std::size_t kGrain = 1 << 11;

template <typename Part>
std::vector<Part> one_a_piece(std::size_t count) {
  return std::vector<Part>((count + kGrain - 1) / kGrain);
}

Moments total(const std::vector<Moments>& pieces) {
  Moments sum;
  for (const Moments& m : pieces) sum += m;
  return sum;
}

// -------------------------------------------------------------------------------------------------------- any balls

// Who bounds whose cell is found by looking at all balls that overlap one, where these are few, as they are in most
// sets that anybody wants; else by the power diagram, whose construction takes longer than a few dozen looks.
class AnyUnion {
 public:
  AnyUnion(std::span<const Sphere> balls, const Context& context)
      : parts_(parts_of(balls)), crowd_(parts_.members, parts_.boxes, context) {
    if (!is_dense(context)) return;
    std::vector<Sphere> all;
    for (const Member& member : parts_.members) all.push_back(member.ball);
    neighbours_ = power_neighbours(all, context);
  }

  std::size_t size() const { return parts_.members.size(); }
  Vec3 middle() const { return 0.5 * (parts_.all.min + parts_.all.max); }

  // Calls visit(piece, member, cell) for every ball that is not hidden; `piece` is the number of the piece of work.
  template <typename Visit>
  void for_each_cell(const Context& context, Visit&& visit) const {
    parallel_for(context, "union", size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Workshop shop(context);
      for (std::size_t n = begin; n < end; ++n) {
        shop.poll(16);
        if (!find_rivals(n, shop)) continue;
        shop.cell.reset(crowd_[n].ball.radius);
        if (shop.rivals.cut(shop.cell, shop.poll)) visit(begin / kGrain, crowd_[n], shop.cell);
      }
    });
  }

 private:
  static constexpr std::size_t kFew = 64;

  struct Parts {
    std::vector<Member> members;
    std::vector<Box> boxes;
    Box all;
  };
  // Points have no part, and bound none.
  static Parts parts_of(std::span<const Sphere> balls) {
    Parts parts;
    for (std::uint32_t i = 0; i < balls.size(); ++i) {
      if (!(balls[i].radius > 0)) continue;
      parts.members.push_back({balls[i], i});
      parts.boxes.push_back(box_of(balls[i]));
      parts.all.include(balls[i]);
    }
    return parts;
  }

  // Whether more pairs overlap than it takes time to look at. Threads stop early once that is known: the answer does
  // not depend on when.
  bool is_dense(const Context& context) const {
    const std::size_t most = kFew * size();
    std::atomic<std::size_t> pairs{0};
    parallel_for(context, {}, size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Workshop shop(context);
      for (std::size_t n = begin; n < end && pairs <= most; ++n) {
        const Box& box = parts_.boxes[crowd_.place_of(n)];
        pairs += crowd_.count_overlapping(n, box, shop.vicinity, most + 1, shop.poll);
      }
    });
    return pairs > most;
  }

  bool find_rivals(std::size_t n, Workshop& shop) const {
    const auto always = [](Vec3, double, double) { return true; };
    const std::size_t place = crowd_.place_of(n);
    if (!neighbours_)
      return crowd_.find_rivals(n, parts_.boxes[place], {}, shop.vicinity, shop.rivals, shop.poll, always);
    shop.rivals.clear();
    bool visible = !neighbours_->hidden[place];
    for (const std::uint32_t other : neighbours_->of(place)) {
      shop.poll();
      visible = visible && add_rival(parts_.members[place], parts_.members[other], {}, shop.rivals, always);
    }
    if (visible) shop.rivals.sort(shop.poll);
    return visible;
  }

  Parts parts_;
  Crowd crowd_;
  std::optional<PowerNeighbours> neighbours_;  // by place among the parts
};

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
    add_balls(collect_balls(), result);
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
  double cell_volume(std::uint32_t cell) const {
    const auto& [i, j, k, l] = cells_[cell];
    return static_cast<double>(exact::six_volumes(points_[i], points_[j], points_[k], points_[l])) / 6;
  }
  // About an origin.
  void take_cell_off(std::uint32_t cell, Vec3 origin, Moments& moments) const {
    const double volume = cell_volume(cell);
    Vec3 sum;
    for (const std::uint32_t v : cells_[cell]) sum = sum + (to_vec3(points_[v]) - origin);
    moments.volume -= volume;
    moments.first = moments.first - volume / 4 * sum;
    add_outer(moments.second, -volume / 20, sum, sum);
    for (const std::uint32_t v : cells_[cell]) {
      const Vec3 corner = to_vec3(points_[v]) - origin;
      add_outer(moments.second, -volume / 20, corner, corner);
    }
  }
  bool on_boundary(std::uint32_t cell) const {
    return std::ranges::find(across_[cell], no_cell) != across_[cell].end();
  }

  void measure_cells(UnionMeasures& result) {
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t c = begin; c < end; ++c) result.parts[c].volume_mm3 = cell_volume(static_cast<std::uint32_t>(c));
    });
  }

  // Cells that share a sphere (the rule on a grid) are one ball over a polytope: between them is no plane of equal
  // power that could be computed. So are cells whose balls differ by less than 2^-27 radii, where it could not be well
  // enough; taking one for the other moves the surface by that.
  void group_cells() {
    group_.assign(cells_.size(), no_cell);
    several_.assign(cells_.size(), false);
    std::vector<std::uint32_t> reached;
    Poll poll(context_);
    for (std::uint32_t c = 0; c < cells_.size(); ++c) {
      poll(4);
      if (group_[c] != no_cell || !on_boundary(c)) continue;
      group_[c] = c;
      reached.assign(1, c);
      for (std::size_t next = 0; next < reached.size(); ++next) {
        poll(16);
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
      several_[c] = true;
      for (const std::uint32_t member : reached) members_.push_back({c, member});
    }
    std::sort(members_.begin(), members_.end(), Polled(poll, std::less<>()));
  }

  // Calls visit(cell) for the cells of a group, ascending.
  template <typename Visit>
  void for_each_member(std::uint32_t group, Visit&& visit) const {
    if (!several_[group]) return visit(group);
    for (auto m = std::lower_bound(members_.begin(), members_.end(), std::pair{group, 0U});
         m != members_.end() && m->first == group; ++m)
      visit(m->second);
  }

  // What a group's ball has beyond its boundary facets.
  void find_caps(const Sphere& ball, std::uint32_t group, std::vector<Cap>& caps) const {
    caps.clear();
    for_each_member(group, [&](std::uint32_t member) {
      for (std::uint32_t v = 0; v < 4; ++v) {
        if (across_[member][v] != no_cell) continue;
        const Facet f = facet(member, v);
        const double offset = f.offset_from(ball.centre);
        if (offset < kTangent * ball.radius) caps.emplace_back(ball.radius, f.normal, std::max(offset, -ball.radius));
      }
    });
  }

  // One ball of each group, and the box of what it has beyond boundary facets: of one point, where that is nothing.
  struct Balls {
    std::vector<Member> balls;
    std::vector<Box> boxes;
  };
  Balls collect_balls() const {
    std::vector<std::size_t> start((cells_.size() + kGrain - 1) / kGrain + 1, 0);
    const auto leads = [&](std::size_t c) { return group_[c] == c; };
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      for (std::size_t c = begin; c < end; ++c) start[begin / kGrain + 1] += leads(c);
    });
    std::partial_sum(start.begin(), start.end(), start.begin());
    Balls all{std::vector<Member>(start.back()), std::vector<Box>(start.back())};
    parallel_for(context_, {}, cells_.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      std::vector<Cap> caps;
      std::size_t place = start[begin / kGrain];
      for (auto c = static_cast<std::uint32_t>(begin); c < end; ++c) {
        if (!leads(c)) continue;
        const auto& [i, j, k, l] = cells_[c];
        const Sphere ball = circumsphere({points_[i], points_[j], points_[k], points_[l]});
        find_caps(ball, c, caps);
        Box& box = all.boxes[place];
        for (const Cap& cap : caps) {
          const Box beyond = moved(cap_box(ball.radius, cap.normal, cap.offset), ball.centre);
          box.include(beyond.min);
          box.include(beyond.max);
        }
        if (caps.empty()) box.include(to_vec3(points_[i]));
        all.balls[place++] = {ball, c};
      }
    });
    return all;
  }

  // What the group's neighbours within the solid leave of the space around the part of its ball that counts.
  void start_cell(const Sphere& ball, std::uint32_t group, const Box& box, Vec3 pivot, BallCell& cell) const {
    const Vec3 centre = ball.centre;
    if (!several_[group]) {
      // A cell's second and first corner, third and fourth: clockwise.
      static constexpr std::array<std::uint8_t, 4> kOrder{1, 0, 2, 3};
      std::array<Vec3, 4> corners;
      std::array<double, 4> outwards{};
      double enlarged = 1;
      for (std::size_t v = 0; v < 4; ++v) {
        const std::size_t corner = kOrder[v];
        corners[v] = to_vec3(points_[cells_[group][corner]]) - centre;
        if (across_[group][corner] != no_cell) continue;
        const Facet f = facet(group, corner);
        outwards[v] = std::max(0.0, 1.001 * ball.radius - f.offset_from(centre));
        enlarged += outwards[v] / dot(f.normal, f.corners[0] - f.apex);
      }
      // Of flatter cells the enlarged one's corners are too far away for the tolerance of cuts.
      if (enlarged < 32) return cell.reset(corners, outwards, pivot);
    }
    Box all = box;
    for_each_member(group, [&](std::uint32_t member) {
      for (const std::uint32_t v : cells_[member]) all.include(to_vec3(points_[v]));
    });
    cell.reset(moved(all, -centre), pivot);
    for_each_member(group, [&](std::uint32_t member) {
      for (std::uint32_t i = 0; i < 4; ++i) {
        const std::uint32_t other = across_[member][i];
        if (other == no_cell || group_[other] == group) continue;
        const Facet f = facet(member, i);
        cell.cut(f.normal, f.offset_from(centre));
      }
    });
  }

  // Balls come in another order than cells do, so that each of these would be waited for.
  static constexpr std::size_t kAhead = 4;
  void fetch(std::uint32_t cell, const UnionMeasures& result) const {
    __builtin_prefetch(&cells_[cell]);
    __builtin_prefetch(&across_[cell]);
    __builtin_prefetch(&result.parts[cell]);
  }

  void add_balls(const Balls& all, UnionMeasures& result) const {
    const Crowd crowd(all.balls, all.boxes, context_);
    auto pieces = one_a_piece<Moments>(all.balls.size());
    parallel_for(context_, "union", all.balls.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      Workshop shop(context_);
      Moments sum;
      for (std::size_t n = begin; n < end; ++n) {
        shop.poll(16);
        if (n + kAhead < end) fetch(crowd[n + kAhead].number, result);
        const auto& [ball, group] = crowd[n];
        const std::size_t place = crowd.place_of(n);
        const Box& box = all.boxes[place];
        find_caps(ball, group, shop.caps);
        if (shop.caps.empty()) continue;
        Vec3 pivot;
        for (const Cap& cap : shop.caps)
          pivot = pivot + cap.offset / static_cast<double>(shop.caps.size()) * cap.normal;
        const auto matters = [&](Vec3 d, double length, double half) {
          return std::ranges::any_of(shop.caps,
                                     [&](const Cap& cap) { return cap.meets(ball.radius, d, length, half); });
        };
        if (!crowd.find_rivals(n, box, pivot, shop.vicinity, shop.rivals, shop.poll, matters)) continue;
        start_cell(ball, group, box, pivot, shop.cell);
        if (!shop.rivals.cut(shop.cell, shop.poll)) continue;
        const BallPiece piece = shop.cell.measure(ball.radius);
        Moments beyond = piece.moments;
        for_each_member(group, [&](std::uint32_t member) { take_cell_off(member, ball.centre, beyond); });
        BallPart& part = result.parts[group];
        part = {part.volume_mm3 + beyond.volume, piece.area, piece.push};
        sum += translated(beyond, ball.centre - kMiddle);
      }
      pieces[begin / kGrain] = sum;
    });
    result.moments = total(pieces);
  }

  void to_patient(UnionMeasures& result) const {
    const Lattice& lattice = solid_.boundary.lattice;
    const double u = lattice.unit_mm;
    const Mat3& axes = lattice.grid.direction;
    auto areas = one_a_piece<double>(result.parts.size());
    parallel_for(context_, {}, result.parts.size(), kGrain, [&](std::size_t begin, std::size_t end) {
      double area = 0;
      for (BallPart& part : std::span(result.parts).subspan(begin, end - begin)) {
        part.volume_mm3 *= u * u * u;
        part.area_mm2 *= u * u;
        part.push_mm2 = (u * u) * (axes * part.push_mm2);
        area += part.area_mm2;
      }
      areas[begin / kGrain] = area;
    });
    result.area_mm2 = std::accumulate(areas.begin(), areas.end(), 0.0);
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
  std::vector<std::uint32_t> group_;  // a cell of the same ball, for cells of a ball that may reach beyond the solid
  std::vector<bool> several_;         // cells have the group of this one
  std::vector<std::pair<std::uint32_t, std::uint32_t>> members_;  // group and cell, for groups of several
};

}  // namespace

UnionMeasures measure_union(std::span<const Sphere> balls, const Context& context) {
  UnionMeasures result;
  result.parts.resize(balls.size());
  const AnyUnion any(balls, context);
  if (any.size() == 0) return result;
  auto pieces = one_a_piece<Moments>(any.size());
  any.for_each_cell(context, [&](std::size_t piece_of_work, const Member& member, BallCell& cell) {
    const auto& [ball, number] = member;
    const BallPiece piece = cell.measure(ball.radius);
    result.parts[number] = {piece.moments.volume, piece.area, piece.push};
    pieces[piece_of_work] += translated(piece.moments, ball.centre - any.middle());
  });
  for (const BallPart& part : result.parts) result.area_mm2 += part.area_mm2;
  result.moments = translated(total(pieces), any.middle());
  return result;
}

std::vector<Vec3> union_corners(std::span<const Sphere> balls, const Context& context) {
  const AnyUnion any(balls, context);
  auto pieces = one_a_piece<std::vector<Vec3>>(any.size());
  any.for_each_cell(context, [&](std::size_t piece_of_work, const Member& member, const BallCell& cell) {
    std::vector<Vec3>& corners = pieces[piece_of_work];
    const std::size_t old = corners.size();
    cell.append_outline_corners(member.ball.radius, corners);
    for (Vec3& corner : std::span(corners).subspan(old)) corner = corner + member.ball.centre;
  });
  std::vector<Vec3> all;
  for (const std::vector<Vec3>& piece : pieces) all.insert(all.end(), piece.begin(), piece.end());
  return all;
}

double exposed_area(const Sphere& ball, std::span<const Sphere> others, const Context& context) {
  if (!(ball.radius > 0)) return 0;
  Workshop shop(context);
  for (std::uint32_t i = 0; i < others.size(); ++i) {
    shop.poll();
    if (!add_rival({ball, 0}, {others[i], i + 1}, {}, shop.rivals, [](Vec3, double, double) { return true; })) return 0;
  }
  shop.rivals.sort(shop.poll);
  shop.cell.reset(ball.radius);
  return shop.rivals.cut(shop.cell, shop.poll) ? shop.cell.measure(ball.radius).area : 0;
}

UnionMeasures measure_raw_union(const SphereModel& model, const Context& context) {
  SPHERULE_CHECK(model.solid.has_value());
  return RawUnion(model, context).measure();
}

UnionMeasures measure_union(const SphereModel& model, const Context& context) {
  return model.solid ? measure_raw_union(model, context) : measure_union(std::span(model.spheres), context);
}

}  // namespace spherule
