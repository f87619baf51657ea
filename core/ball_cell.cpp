// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/ball_cell.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

namespace spherule {

namespace {

constexpr std::uint32_t kNone = 0xffffffffU;
constexpr double kTwoPi = 2 * std::numbers::pi;

void add_outer(Mat3& sum, double weight, Vec3 a, Vec3 b) {
  for (int i = 0; i < 3; ++i)
    sum.rows[static_cast<std::size_t>(i)] = sum.rows[static_cast<std::size_t>(i)] + weight * a[i] * b;
}

// Where the line through two corners meets the sphere. The two faces at an edge must see the same points, so callers
// pass its corners in the order of their numbers.
struct Chord {
  Vec3 first, second;
  bool crosses = false;  // of an edge with both corners outside
};

// The corners are on different sides: the one point where the edge passes through the sphere.
Vec3 passage(Vec3 inside, Vec3 outside, double radius_squared) {
  const Vec3 d = outside - inside;
  const double a = squared_norm(d), b = dot(inside, d), c = radius_squared - squared_norm(inside);
  const double root = std::sqrt(b * b + a * c);
  // Of the two forms of the root, the one without cancellation.
  const double t = b > 0 ? c / (b + root) : (root - b) / a;
  return inside + std::clamp(t, 0.0, 1.0) * d;
}

// Both corners are outside: two points, or none.
Chord chord(Vec3 from, Vec3 to, double radius_squared) {
  const Vec3 d = to - from;
  const double a = squared_norm(d), b = dot(from, d);
  if (!(b < 0) || !(-b < a)) return {};
  const double depth = radius_squared - squared_norm(cross(from, d)) / a;
  if (!(depth > 0)) return {};
  const double middle = -b / a, half = std::sqrt(depth / a);
  return {.first = from + std::max(middle - half, 0.0) * d,
          .second = from + std::min(middle + half, 1.0) * d,
          .crosses = true};
}

// A point of a face's plane, in coordinates about the foot of the ball's centre.
struct Flat {
  double x = 0, y = 0;
};
double flat_dot(Flat p, Flat q) { return p.x * q.x + p.y * q.y; }
double flat_cross(Flat p, Flat q) { return p.x * q.y - p.y * q.x; }

// Outline of a convex polygon within a disk about the foot, put together from straight pieces and arcs, and the
// integrals of 1, x and x·xᵀ over what it surrounds: sums over triangles and sectors between the foot and its pieces.
class Outline {
 public:
  Outline(Vec3 normal, double disk_squared) : disk_squared_(disk_squared) {
    const Vec3 any = std::abs(normal.x) < 0.6 ? Vec3{1, 0, 0} : Vec3{0, 1, 0};
    right_ = normalised(cross(any, normal));
    up_ = cross(normal, right_);
  }

  void segment(Vec3 from, Vec3 to) {
    const Flat p = flat(from), q = flat(to), both{p.x + q.x, p.y + q.y};
    const double area = flat_cross(p, q) / 2;
    area_ += area;
    first_.x += area / 3 * both.x;
    first_.y += area / 3 * both.y;
    second_[0] += area / 12 * (p.x * p.x + q.x * q.x + both.x * both.x);
    second_[1] += area / 12 * (p.x * p.y + q.x * q.y + both.x * both.y);
    second_[2] += area / 12 * (p.y * p.y + q.y * q.y + both.y * both.y);
    const Flat piece{q.x - p.x, q.y - p.y};
    straight_squared_ = std::max(straight_squared_, flat_dot(piece, piece));
    ++segments_;
  }
  void enter(Vec3 where) {
    const Flat p = flat(where);
    if (left_) {
      arc(exit_, p);
      left_ = false;
    } else {
      first_entry_ = p;
    }
  }
  void leave(Vec3 where) {
    exit_ = flat(where);
    left_ = true;
  }
  // Closes an outline that has any straight piece.
  void close() {
    if (left_) arc(exit_, first_entry_);
  }
  // Whether an arc ended where it began, so that it is nothing or the whole circle. Where the circle is whole, there is
  // nearly nothing else.
  bool may_lack_circle() const { return doubtful_ && straight_squared_ < disk_squared_ / 4; }
  void whole_circle() { arc({}, {}, kTwoPi); }

  double area() const { return area_; }
  Vec3 first() const { return first_.x * right_ + first_.y * up_; }  // about the foot
  void add_second(Mat3& sum, double weight) const {
    add_outer(sum, weight, right_, second_[0] * right_ + second_[1] * up_);
    add_outer(sum, weight, up_, second_[1] * right_ + second_[2] * up_);
  }
  double arcs() const { return arcs_; }  // their angles together
  int segments() const { return segments_; }

 private:
  Flat flat(Vec3 p) const { return {dot(right_, p), dot(up_, p)}; }
  void arc(Flat p, Flat q) {
    double angle = std::atan2(flat_cross(p, q), flat_dot(p, q));
    if (std::abs(angle) < 0x1p-20) {
      doubtful_ = true;
    } else if (angle < 0) {
      angle += kTwoPi;
    }
    arc(p, q, angle);
  }
  // With u the unit vector to a point of the arc and v that turned by a right angle, u·uᵀ is half the identity less the
  // derivative of (u·vᵀ + v·uᵀ) / 4 by the angle.
  void arc(Flat p, Flat q, double angle) {
    arcs_ += angle;
    area_ += disk_squared_ * angle / 2;
    first_.x += disk_squared_ / 3 * (q.y - p.y);
    first_.y -= disk_squared_ / 3 * (q.x - p.x);
    const double weight = disk_squared_ / 8, isotropic = weight * disk_squared_ * angle;
    const double turned = weight * (q.x * q.y - p.x * p.y);
    second_[0] += isotropic + turned;
    second_[1] += weight / 2 * ((p.x * p.x - p.y * p.y) - (q.x * q.x - q.y * q.y));
    second_[2] += isotropic - turned;
  }

  Vec3 right_, up_;
  double disk_squared_;
  double area_ = 0;
  Flat first_;
  std::array<double, 3> second_{};  // xx, xy, yy
  double arcs_ = 0, straight_squared_ = 0;
  Flat first_entry_, exit_;
  bool left_ = false, doubtful_ = false;
  int segments_ = 0;
};

}  // namespace

void BallCell::start(Vec3 pivot) {
  pivot_ = pivot;
  double farthest = 0, largest = 0;
  alive_.clear();
  for (std::uint32_t v = 0; v < corners_.size(); ++v) {
    farthest = std::max(farthest, squared_norm(corners_[v] - pivot));
    largest = std::max(largest, squared_norm(corners_[v]));
    alive_.push_back(v);
  }
  reach_ = std::sqrt(farthest);
  tolerance_ = 0x1p-42 * std::sqrt(largest);
}

void BallCell::reset(const Box& part, Vec3 pivot) {
  const Vec3 size = part.max - part.min;
  const double margin = 0x1p-6 * std::max({size.x, size.y, size.z});
  const Vec3 m{margin, margin, margin};
  const std::array<Vec3, 2> ends{part.min - m, part.max + m};
  corners_.clear();
  for (std::size_t c = 0; c < 8; ++c) corners_.push_back({ends[c & 1].x, ends[c >> 1 & 1].y, ends[c >> 2].z});
  loops_ = {0, 4, 6, 2, 1, 3, 7, 5, 0, 1, 5, 4, 2, 6, 7, 3, 0, 2, 3, 1, 4, 5, 7, 6};
  faces_.clear();
  for (std::uint32_t f = 0; f < 6; ++f) {
    const int axis = static_cast<int>(f / 2);
    Face face{.normal = {}, .offset = f % 2 ? ends[1][axis] : -ends[0][axis], .begin = 4 * f, .end = 4 * f + 4};
    face.normal[axis] = f % 2 ? 1 : -1;
    faces_.push_back(face);
  }
  start(pivot);
}

void BallCell::reset(double radius) {
  // The regular tetrahedron around a slightly larger ball.
  const double far = 1.01 * std::numbers::sqrt3 * radius, near = 1.01 * radius, n = 1 / std::numbers::sqrt3;
  corners_ = {{far, far, far}, {far, -far, -far}, {-far, far, -far}, {-far, -far, far}};
  loops_ = {1, 3, 2, 0, 2, 3, 0, 3, 1, 0, 1, 2};
  faces_.clear();
  faces_.push_back({{-n, -n, -n}, near, 0, 3});
  faces_.push_back({{-n, n, n}, near, 3, 6});
  faces_.push_back({{n, -n, n}, near, 6, 9});
  faces_.push_back({{n, n, -n}, near, 9, 12});
  start({});
}

void BallCell::reset(const std::array<Vec3, 3>& base, Vec3 apex, double scale, Vec3 centre, Vec3 pivot) {
  corners_.clear();
  for (const Vec3& v : base) corners_.push_back(v - centre);
  for (const Vec3& v : base) corners_.push_back(apex + scale * (v - apex) - centre);
  loops_ = {0, 2, 1, 3, 4, 5, 0, 1, 4, 3, 1, 2, 5, 4, 2, 0, 3, 5};
  const Vec3 outward = normalised(cross(base[1] - base[0], base[2] - base[0]));
  faces_.clear();
  faces_.push_back({-outward, -dot(outward, corners_[0]), 0, 3});
  faces_.push_back({outward, dot(outward, corners_[3]), 3, 6});
  for (std::uint32_t i = 0; i < 3; ++i) {
    const Vec3 normal = normalised(cross(base[(i + 1) % 3] - base[i], base[i] - apex));
    faces_.push_back({normal, dot(normal, corners_[i]), 6 + 4 * i, 10 + 4 * i});
  }
  start(pivot);
}

bool BallCell::cut(Vec3 normal, double offset) {
  heights_.resize(corners_.size());
  double highest = -std::numeric_limits<double>::infinity(), lowest = -highest;
  for (const std::uint32_t v : alive_) {
    const double height = dot(normal, corners_[v]) - offset;
    heights_[v] = height;
    highest = std::max(highest, height);
    lowest = std::min(lowest, height);
  }
  // Corners at a plane's height but for rounding can be above and below it by turns around a face, and then no plane
  // of that height cuts the polyhedron: a slightly higher one does.
  for (double limit = tolerance_; highest > limit; limit *= 8) {
    if (lowest > limit) {
      faces_.clear();
      alive_.clear();
      reach_ = 0;
      return false;
    }
    if (cut_above(normal, offset, limit)) break;
  }
  return true;
}

std::uint32_t BallCell::cut_edge(std::uint32_t kept, std::uint32_t removed) {
  for (auto c = static_cast<std::uint32_t>(cuts_.size()); c-- > 0;)
    if (cuts_[c].kept == kept && cuts_[c].removed == removed) return c;
  const double low = heights_[kept], high = heights_[removed];
  const double t = std::clamp(low / (low - high), 0.0, 1.0);
  const Vec3 from = corners_[kept], to = corners_[removed];
  corners_.push_back(from + t * (to - from));
  cuts_.push_back({kept, removed, kNone});
  return static_cast<std::uint32_t>(cuts_.size() - 1);
}

// False when the corners to keep do not follow each other around the face.
bool BallCell::cut_face(std::uint32_t face, std::uint32_t first_new) {
  const std::uint32_t old_begin = faces_[face].begin, old_end = faces_[face].end;
  const auto begin = static_cast<std::uint32_t>(loops_.size());
  loops_.resize(begin + (old_end - old_begin) + 2);
  std::uint32_t* out = loops_.data() + begin;
  std::uint32_t exit = kNone, entry = kNone, previous = loops_[old_end - 1];
  for (std::uint32_t k = old_begin; k < old_end; ++k) {
    const std::uint32_t corner = loops_[k];
    if (removed_[previous] != removed_[corner]) {
      std::uint32_t& end = removed_[corner] ? exit : entry;
      if (end != kNone) return false;
      end = removed_[corner] ? cut_edge(previous, corner) : cut_edge(corner, previous);
      *out++ = first_new + end;
    }
    if (!removed_[corner]) *out++ = corner;
    previous = corner;
  }
  cuts_[entry].next = exit;
  const auto end = static_cast<std::uint32_t>(out - loops_.data());
  loops_.resize(end);
  new_loops_.push_back({face, begin, end});
  return true;
}

bool BallCell::cut_above(Vec3 normal, double offset, double limit) {
  const auto first_new = static_cast<std::uint32_t>(corners_.size());
  const std::size_t first_loop = loops_.size();
  removed_.resize(first_new);
  for (const std::uint32_t v : alive_) removed_[v] = heights_[v] > limit;
  cuts_.clear();
  new_loops_.clear();
  const auto undo = [&] {
    corners_.resize(first_new);
    loops_.resize(first_loop);
    return false;
  };
  for (std::uint32_t f = 0; f < faces_.size(); ++f) {
    const Face& face = faces_[f];
    std::uint32_t removed = 0;
    for (std::uint32_t k = face.begin; k < face.end; ++k) removed += removed_[loops_[k]];
    if (removed == face.end - face.begin) {
      new_loops_.push_back({f, 0, 0});
    } else if (removed > 0 && !cut_face(f, first_new)) {
      return undo();
    }
  }
  const auto begin = static_cast<std::uint32_t>(loops_.size());
  std::uint32_t c = 0;
  do {
    loops_.push_back(first_new + c);
    c = cuts_[c].next;
  } while (c != 0 && c != kNone && loops_.size() - begin < cuts_.size());
  if (c != 0 || loops_.size() - begin != cuts_.size()) return undo();

  for (auto loop = new_loops_.rbegin(); loop != new_loops_.rend(); ++loop) {
    if (loop->begin == loop->end) {
      faces_[loop->face] = faces_.back();
      faces_.pop_back();
    } else {
      faces_[loop->face].begin = loop->begin;
      faces_[loop->face].end = loop->end;
    }
  }
  faces_.push_back({normal, offset, begin, static_cast<std::uint32_t>(loops_.size())});

  std::size_t kept = 0;
  double farthest = 0;
  const auto keep = [&](std::uint32_t v) { farthest = std::max(farthest, squared_norm(corners_[v] - pivot_)); };
  for (const std::uint32_t v : alive_) {
    if (removed_[v]) continue;
    alive_[kept++] = v;
    keep(v);
  }
  alive_.resize(kept);
  for (std::uint32_t v = first_new; v < corners_.size(); ++v) {
    alive_.push_back(v);
    keep(v);
  }
  reach_ = std::sqrt(farthest);
  return true;
}

bool BallCell::surrounds(const Face& face, Vec3 foot, double disk_squared) const {
  double widest = 0;
  bool around = true;
  Vec3 p = corners_[loops_[face.end - 1]];
  for (std::uint32_t k = face.begin; k < face.end; ++k) {
    const Vec3 q = corners_[loops_[k]], edge = q - p;
    widest = std::max(widest, squared_norm(q - corners_[loops_[face.begin]]));
    const double side = dot(face.normal, cross(p - foot, edge));
    around = around && (side >= 0 && side * side >= disk_squared / 4 * squared_norm(edge));
    p = q;
  }
  return around && widest > disk_squared;
}

BallPiece BallCell::measure(double ball_radius) const {
  if (empty()) return {};
  in_ball_.resize(corners_.size());
  // Where planes meet on the sphere, as at every corner of a raw model's cells, rounding would decide which edges cross
  // it, and in which order. A ball that is larger by far more than rounding has those corners inside; what it has too
  // much is taken off by its derivatives, up to the square of 2^-30.
  const bool corner_on_sphere = std::ranges::any_of(alive_, [&](std::uint32_t v) {
    return std::abs(squared_norm(corners_[v]) - ball_radius * ball_radius) < 0x1p-29 * ball_radius * ball_radius;
  });
  const double growth = corner_on_sphere ? 0x1p-30 * ball_radius : 0;
  const double radius = ball_radius + growth, radius_squared = radius * radius;
  int corners_in = 0, segments = 0, flat_parts = 0;
  newest_.resize(corners_.size());
  for (const std::uint32_t v : alive_) {
    in_ball_[v] = squared_norm(corners_[v]) < radius_squared;
    corners_in += in_ball_[v];
    newest_[v] = kNone;
  }
  crossed_.clear();

  double turning = 0;  // of the spherical part's outline, at its corners; each is the crossing of an edge
  const auto crossed_by = [&](std::uint32_t low, std::uint32_t high) {
    std::uint32_t e = newest_[low];
    while (e != kNone && crossed_[e].high != high) e = crossed_[e].older;
    return e;
  };
  // The outline comes along the arc of one face and goes on along that of another: where the other's polygon enters the
  // ball. It turns by the angle between the planes' normals within the sphere's tangent plane. The angle has a sign: on
  // the spheres of grids many planes meet in one point, rounding decides the order in which the outline passes them,
  // and then only signed angles add up to the right one. None turns back, so those near -π are near π.
  int turns = 0;
  const auto turn = [&](Vec3 where, const Face& from, const Face& to) {
    ++turns;
    const double angle = std::atan2(dot(where, cross(from.normal, to.normal)) / radius,
                                    dot(from.normal, to.normal) - from.offset * to.offset / radius_squared);
    turning += angle < -3 ? angle + kTwoPi : angle;
  };
  const auto remember = [&](std::uint32_t low, std::uint32_t high, std::uint32_t face) {
    crossed_.push_back({low, high, face, newest_[low]});
    newest_[low] = static_cast<std::uint32_t>(crossed_.size() - 1);
  };

  double bending = 0;  // of the outline along its arcs
  double height_areas = 0;
  Vec3 push, bent_normals, height_first;
  Mat3 height_second{{Vec3{}, Vec3{}, Vec3{}}}, normal_first{{Vec3{}, Vec3{}, Vec3{}}};
  bool holds_centre = true;
  for (std::uint32_t f = 0; f < faces_.size(); ++f) {
    const Face& face = faces_[f];
    holds_centre &= face.offset > 0;
    // Too far for any of its edges to meet the ball, whatever the rounding.
    if (std::abs(face.offset) > (1 + 0x1p-40) * radius) continue;
    const Vec3 foot = face.offset * face.normal;
    const double disk_squared = std::max(0.0, (radius - face.offset) * (radius + face.offset));
    Outline outline(face.normal, disk_squared);
    std::uint32_t a = loops_[face.end - 1];
    for (std::uint32_t k = face.begin; k < face.end; ++k) {
      const std::uint32_t b = loops_[k];
      const Vec3 p = corners_[a], q = corners_[b];
      const std::uint32_t low = std::min(a, b), high = std::max(a, b);
      if (in_ball_[a] && in_ball_[b]) {
        outline.segment(p, q);
      } else if (in_ball_[a]) {
        const Vec3 x = passage(p, q, radius_squared);
        outline.segment(p, x);
        outline.leave(x);
        const std::uint32_t e = crossed_by(low, high);
        e == kNone ? remember(low, high, f) : turn(x, face, faces_[crossed_[e].face]);
      } else if (in_ball_[b]) {
        const Vec3 x = passage(q, p, radius_squared);
        outline.enter(x);
        outline.segment(x, q);
        const std::uint32_t e = crossed_by(low, high);
        e == kNone ? remember(low, high, f) : turn(x, faces_[crossed_[e].face], face);
      } else {
        const Chord both = chord(corners_[low], corners_[high], radius_squared);
        if (both.crosses) {
          const Vec3 in = a == low ? both.first : both.second, out = a == low ? both.second : both.first;
          outline.enter(in);
          outline.segment(in, out);
          outline.leave(out);
          const std::uint32_t e = crossed_by(low, high);
          if (e == kNone) {
            remember(low, high, f);
          } else {
            turn(in, faces_[crossed_[e].face], face);
            turn(out, face, faces_[crossed_[e].face]);
          }
        }
      }
      a = b;
    }
    if (outline.segments() > 0) {
      outline.close();
      if (outline.may_lack_circle() && surrounds(face, foot, disk_squared)) outline.whole_circle();
    } else if (disk_squared > 0 && surrounds(face, foot, disk_squared)) {
      outline.whole_circle();
    } else {
      continue;
    }
    ++flat_parts;
    segments += outline.segments();
    bending += face.offset / radius * outline.arcs();
    const double flat_area = outline.area();
    const Vec3 about_foot = outline.first(), first = flat_area * foot + about_foot;
    height_areas += face.offset * flat_area;
    push = push - flat_area * face.normal;
    bent_normals = bent_normals + outline.arcs() * face.normal;
    height_first = height_first + face.offset * first;
    add_outer(normal_first, 1, face.normal, first);
    add_outer(height_second, face.offset, foot, first);
    add_outer(height_second, face.offset, about_foot, foot);
    outline.add_second(height_second, face.offset);
  }
  // No flat part: the ball is within the cell or beyond it.
  if (flat_parts == 0 && !holds_centre) return {};

  const int characteristic = 2 - (flat_parts - segments / 2 + corners_in);
  BallPiece piece{.moments = {}, .area = 0, .push = {}, .characteristic = characteristic, .corners = turns};
  const double area = radius_squared * (kTwoPi * characteristic + bending - turning);
  const double volume = (height_areas + radius * area) / 3;
  piece.area = area - growth * (2 * area / radius - radius * bending);
  piece.moments.volume = volume - growth * piece.area;
  piece.moments.first = 0.25 * (height_first + radius_squared * push) - (growth * radius) * push;
  piece.push = push + (growth * radius) * bent_normals;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const int ii = static_cast<int>(i), jj = static_cast<int>(j);
      // The integral of x·xᵀ over the spherical part, by radius.
      const double spherical = (i == j ? volume : 0) - (normal_first.rows[i][jj] + normal_first.rows[j][ii]) / 2;
      piece.moments.second.rows[i][jj] =
          (height_second.rows[i][jj] + radius_squared * spherical) / 5 - growth * radius * spherical;
    }
  }
  return piece;
}

Box cap_box(double radius, Vec3 normal, double offset) {
  const double disk = std::sqrt(std::max(0.0, (radius - offset) * (radius + offset)));
  Box box;
  for (int a = 0; a < 3; ++a) {
    const double spread = disk * std::sqrt(std::max(0.0, 1 - normal[a] * normal[a]));
    box.max[a] = normal[a] * radius >= offset ? radius : offset * normal[a] + spread;
    box.min[a] = -normal[a] * radius >= offset ? -radius : offset * normal[a] - spread;
  }
  return box;
}

}  // namespace spherule
