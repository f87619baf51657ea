// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/ball_cell.h"

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/base/elementary.h"
#include "core/base/vectors.h"

namespace spherule {

namespace {

constexpr std::uint32_t kNone = 0xffffffffU;
constexpr double kTwoPi = 2 * std::numbers::pi;
// tan(π - 3): the tangent of an angle of -3.
constexpr double kNearlyBack = 0.1425;

// Where an edge with one end in the ball passes through its sphere.
Vec3 passage(Vec3 inside, Vec3 outside, double radius_squared) {
  const Vec3 d = outside - inside;
  const double a = squared_norm(d), b = dot(inside, d), c = radius_squared - squared_norm(inside);
  const double root = std::sqrt(b * b + a * c);
  // Of the two forms of the root, the one without cancellation.
  const double t = b > 0 ? c / (b + root) : (root - b) / a;
  return inside + std::clamp(t, 0.0, 1.0) * d;
}

// Edges are numbered at each end by the face that they do not touch.
constexpr std::uint8_t after(unsigned i) { return static_cast<std::uint8_t>(i == 2 ? 0 : i + 1); }
constexpr std::uint8_t before(unsigned i) { return static_cast<std::uint8_t>(i == 0 ? 2 : i - 1); }

// Corners are worked on by eights: the compiler makes vectors of them, and no result depends on how long those are.
constexpr std::size_t kLanes = 8;

// Adds angles as unit complex numbers are multiplied, so that only the sum costs an arc tangent.
class AngleSum {
 public:
  // The angle of (c, s), from -π to π, where these are its cosine and sine times something above 2^-200 and up to 1; or
  // both 0, for no angle.
  void add(double c, double s) {
    if (c == 0 && s == 0) return;
    const double product_c = c * cosine_ - s * sine_, product_s = c * sine_ + s * cosine_;
    // Two angles on one side of the axis may have a sum on the other, beyond π.
    const bool lower = s < 0;
    if (lower == (sine_ < 0) && ((c < 0 && cosine_ < 0) || lower != (product_s < 0))) turns_ += lower ? -1 : 1;
    cosine_ = product_c;
    sine_ = product_s;
    if (std::abs(cosine_) + std::abs(sine_) < 0x1p-500) cosine_ *= 0x1p500, sine_ *= 0x1p500;
  }
  void add_turn() { ++turns_; }
  // -0 is on the upper side, too.
  double sum() const { return kTwoPi * turns_ + elementary::atan2(sine_ + 0.0, cosine_); }

 private:
  double cosine_ = 1, sine_ = 0;
  int turns_ = 0;
};

double largest(std::array<double, kLanes> values) {
  for (std::size_t half = kLanes / 2; half > 0; half /= 2)
    for (std::size_t k = 0; k < half; ++k) values[k] = values[k + half] > values[k] ? values[k + half] : values[k];
  return values[0];
}

// Heights over the plane normal · x = offset; returns the largest.
SPHERULE_VECTORS
double heights_over(Vec3 normal, double offset, const double* x, const double* y, const double* z, std::size_t count,
                    double* heights) {
  std::array<double, kLanes> highest;
  highest.fill(-std::numeric_limits<double>::infinity());
  for (std::size_t v = 0; v < count; v += kLanes) {
    for (std::size_t k = 0; k < kLanes; ++k) {
      const double height = normal.x * x[v + k] + normal.y * y[v + k] + normal.z * z[v + k] - offset;
      heights[v + k] = height;
      highest[k] = height > highest[k] ? height : highest[k];
    }
  }
  return largest(highest);
}

// Squared distances from a point; returns the largest.
SPHERULE_VECTORS
double squares_from(Vec3 point, const double* x, const double* y, const double* z, std::size_t count, double* squares) {
  std::array<double, kLanes> farthest{};
  for (std::size_t v = 0; v < count; v += kLanes) {
    for (std::size_t k = 0; k < kLanes; ++k) {
      const double dx = x[v + k] - point.x, dy = y[v + k] - point.y, dz = z[v + k] - point.z;
      const double square = dx * dx + dy * dy + dz * dz;
      squares[v + k] = square;
      farthest[k] = square > farthest[k] ? square : farthest[k];
    }
  }
  return largest(farthest);
}

}  // namespace

BallCell::Outline::Outline(Vec3 normal, double scale) : scale_(scale) {
  // T. Duff and others, Building an orthonormal basis, revisited (2017).
  const double sign = std::copysign(1.0, normal.z), a = -1 / (sign + normal.z), b = normal.x * normal.y * a;
  right_ = {1 + sign * normal.x * normal.x * a, sign * b, -sign * normal.x};
  up_ = {b, sign + normal.y * normal.y * a, -normal.y};
}

void BallCell::Outline::add_piece(Flat from, Flat to) {
  const double area = from.x * to.y - from.y * to.x;
  const Flat both{from.x + to.x, from.y + to.y}, piece{to.x - from.x, to.y - from.y};
  triangles_ += area;
  triangles_first_.x += area * both.x;
  triangles_first_.y += area * both.y;
  triangles_second_[0] += area * (from.x * from.x + to.x * to.x + both.x * both.x);
  triangles_second_[1] += area * (from.x * from.y + to.x * to.y + both.x * both.y);
  triangles_second_[2] += area * (from.y * from.y + to.y * to.y + both.y * both.y);
  longest_squared_ = std::max(longest_squared_, piece.x * piece.x + piece.y * piece.y);
  has_pieces_ = true;
}

// With u the unit vector to a point of an arc and v that turned by a right angle, u·uᵀ is half the identity less the
// derivative of (u·vᵀ + v·uᵀ) / 4 by the angle.
void BallCell::Outline::end_arc(Flat p, double sign) {
  const double c = scale_ * p.x, s = sign * scale_ * p.y;
  const double cosine = c * cosine_ - s * sine_;
  sine_ = c * sine_ + s * cosine_;
  cosine_ = cosine;
  arcs_first_.x += sign * p.y;
  arcs_first_.y -= sign * p.x;
  arcs_second_[0] += sign * p.x * p.y;
  arcs_second_[1] += sign * (p.y * p.y - p.x * p.x) / 2;
}

bool BallCell::Outline::may_be_circle(double disk_squared) const {
  return std::abs(sine_) <= 0x1p-20 * cosine_ && longest_squared_ < disk_squared / 4;
}

// About the foot, in the axes `right`, `up`.
void BallCell::Outline::finish(double disk_squared, bool circle) {
  // Arcs do not overlap, so together they are at most one turn; rounding may turn nothing a little backwards.
  arcs_ = elementary::atan2(sine_, cosine_);
  if (circle || (arcs_ < 0 && std::abs(sine_) > 0x1p-20 * cosine_)) arcs_ += kTwoPi;
  area_ = (triangles_ + disk_squared * arcs_) / 2;
  first_.x = triangles_first_.x / 6 + disk_squared / 3 * arcs_first_.x;
  first_.y = triangles_first_.y / 6 + disk_squared / 3 * arcs_first_.y;
  const double weight = disk_squared / 8, isotropic = weight * disk_squared * arcs_;
  second_[0] = triangles_second_[0] / 24 + isotropic + weight * arcs_second_[0];
  second_[1] = triangles_second_[1] / 24 + weight * arcs_second_[1];
  second_[2] = triangles_second_[2] / 24 + isotropic - weight * arcs_second_[0];
}

void BallCell::Outline::add_second(Mat3& sum, double weight) const {
  add_outer(sum, weight, right_, second_[0] * right_ + second_[1] * up_);
  add_outer(sum, weight, up_, second_[1] * right_ + second_[2] * up_);
}

template <std::size_t Count>
void BallCell::start(const std::array<Vec3, Count>& positions, const std::array<Corner, Count>& corners, Vec3 pivot) {
  corners_.assign(corners.begin(), corners.end());
  make_room();
  for (std::size_t v = 0; v < Count; ++v) place(v, positions[v]);
  fill_lanes();
  tolerance_ = 0x1p-42 * std::sqrt(squares_from({}, x_.data(), y_.data(), z_.data(), lanes(), values_.data()));
  pivot_ = pivot;
  measure_reach();
  cut_of_face_.assign(faces_.size(), kNone);
}

void BallCell::reset(const Box& part, Vec3 pivot) {
  // Corner c is at the high ends of the axes whose bits are in c; face 2 a + e is at the end e of axis a.
  static constexpr std::array<Corner, 8> kCorners{{{{0, 4, 2}, {1, 4, 2}},
                                                   {{1, 2, 4}, {0, 3, 5}},
                                                   {{0, 3, 4}, {3, 0, 6}},
                                                   {{1, 4, 3}, {2, 7, 1}},
                                                   {{0, 2, 5}, {5, 6, 0}},
                                                   {{1, 5, 2}, {4, 1, 7}},
                                                   {{0, 5, 3}, {7, 2, 4}},
                                                   {{1, 3, 5}, {6, 5, 3}}}};
  const Vec3 size = part.max - part.min;
  const double margin = 0x1p-6 * std::max({size.x, size.y, size.z});
  const Vec3 m{margin, margin, margin};
  const std::array<Vec3, 2> ends{part.min - m, part.max + m};
  faces_.clear();
  for (int axis = 0; axis < 3; ++axis) {
    for (std::size_t end = 0; end < 2; ++end) {
      Face face{.normal = {}, .offset = end ? ends[1][axis] : -ends[0][axis]};
      face.normal[axis] = end ? 1 : -1;
      faces_.push_back(face);
    }
  }
  std::array<Vec3, 8> corners;
  for (std::size_t c = 0; c < 8; ++c) corners[c] = {ends[c & 1].x, ends[c >> 1 & 1].y, ends[c >> 2].z};
  start(corners, kCorners, pivot);
}

void BallCell::reset(const std::array<Vec3, 4>& corners, const std::array<double, 4>& outwards, Vec3 pivot) {
  // Face i is opposite corner i, so the edge that does not touch it leads there.
  static constexpr std::array<Triple, 4> kOthers{{{1, 2, 3}, {0, 3, 2}, {0, 1, 3}, {0, 2, 1}}};
  static constexpr std::array<Corner, 4> kCorners{
      {{kOthers[0], kOthers[0]}, {kOthers[1], kOthers[1]}, {kOthers[2], kOthers[2]}, {kOthers[3], kOthers[3]}}};
  faces_.clear();
  std::array<Vec3, 4> moved = corners;
  for (std::size_t f = 0; f < 4; ++f) {
    const auto& [i, j, k] = kOthers[f];
    const Vec3 normal = normalised(cross(corners[k] - corners[i], corners[j] - corners[i]));
    faces_.push_back({normal, dot(normal, corners[i]) + outwards[f]});
    if (outwards[f] == 0) continue;
    // The other corners move away from that opposite.
    const double enlarged = outwards[f] / dot(normal, corners[i] - corners[f]);
    for (const std::uint32_t v : kOthers[f]) moved[v] = moved[v] + enlarged * (corners[v] - corners[f]);
  }
  start(moved, kCorners, pivot);
}

void BallCell::reset(double radius) {
  // The regular tetrahedron around a slightly larger ball.
  const double far = 1.01 * std::numbers::sqrt3 * radius;
  reset({{{far, far, far}, {far, -far, -far}, {-far, far, -far}, {-far, -far, far}}}, {}, {});
}

void BallCell::make_room() {
  if (x_.size() >= lanes()) return;
  const std::size_t room = 2 * lanes();
  for (std::vector<double>* values : {&x_, &y_, &z_, &values_}) values->resize(room);
}

void BallCell::fill_lanes() {
  for (std::size_t v = corners_.size(); v < lanes(); ++v) place(v, position(0));
}

void BallCell::measure_reach() {
  reach_ = std::sqrt(squares_from(pivot_, x_.data(), y_.data(), z_.data(), lanes(), values_.data()));
  reach_is_tight_ = true;
}

bool BallCell::cut(Vec3 normal, double offset) {
  if (empty()) return false;
  const double highest = heights_over(normal, offset, x_.data(), y_.data(), z_.data(), lanes(), values_.data());
  // Corners at a plane's height but for rounding can be above and below it by turns around a face, and then no plane
  // of that height cuts the polyhedron: a slightly higher one does.
  for (double limit = tolerance_; highest > limit; limit *= 8) {
    if (!find_cuts(limit)) continue;
    if (removed_.size() == corners_.size()) {
      corners_.clear();
      reach_ = 0;
      return false;
    }
    faces_.push_back({normal, offset});
    cut_of_face_.push_back(kNone);
    replace_removed();
    reach_is_tight_ = false;
    return true;
  }
  if (!reach_is_tight_) measure_reach();
  return true;
}

// False when the edges cut do not follow each other once around.
bool BallCell::find_cuts(double limit) {
  // No branches: which corners go is not to be predicted.
  removed_.resize(corners_.size());
  std::size_t count = 0;
  for (std::uint32_t v = 0; v < corners_.size(); ++v) {
    removed_[count] = v;
    count += values_[v] > limit;
  }
  removed_.resize(count);
  cuts_.clear();
  for (const std::uint32_t v : removed_) {
    const Corner& corner = corners_[v];
    for (unsigned i = 0; i < 3; ++i)
      if (!(values_[corner.next[i]] > limit)) cuts_.push_back({v, static_cast<std::uint8_t>(i)});
  }
  if (cuts_.empty()) return true;
  bool once = true;
  for (std::uint32_t c = 0; c < cuts_.size(); ++c) {
    Cut& cut = cuts_[c];
    const Corner& from = corners_[cut.removed];
    cut.kept = from.next[cut.edge];
    cut.right = from.faces[after(cut.edge)];
    cut.left = from.faces[before(cut.edge)];
    once = once && cut_of_face_[cut.right] == kNone;
    cut_of_face_[cut.right] = c;
  }
  std::uint32_t c = 0, around = 0;
  do {
    const std::uint32_t following = cut_of_face_[cuts_[c].left];
    if (following == kNone) break;
    cuts_[c].following = following;
    cuts_[following].previous = c;
    c = following;
  } while (++around < cuts_.size() && c != 0);
  for (const Cut& cut : cuts_) cut_of_face_[cut.right] = kNone;
  return once && c == 0 && around == cuts_.size();
}

void BallCell::replace_removed() {
  const auto face = static_cast<std::uint32_t>(faces_.size() - 1);
  const auto old = static_cast<std::uint32_t>(corners_.size()), gone = static_cast<std::uint32_t>(removed_.size());
  // New corners take the places of removed ones, and more at the end.
  const auto place_of = [&](std::uint32_t c) { return c < gone ? removed_[c] : old + (c - gone); };
  for (Cut& cut : cuts_) {
    const double low = values_[cut.kept], high = values_[cut.removed];
    const double t = std::clamp(low / (low - high), 0.0, 1.0);
    const Vec3 from = position(cut.kept), to = position(cut.removed);
    cut.where = from + t * (to - from);
    const Triple& next = corners_[cut.kept].next;
    cut.edge = static_cast<std::uint8_t>(next[0] == cut.removed ? 0 : next[1] == cut.removed ? 1 : 2);
  }
  if (cuts_.size() > gone) {
    corners_.resize(old + cuts_.size() - gone);
    make_room();
  }
  for (std::uint32_t c = 0; c < cuts_.size(); ++c) {
    const Cut& cut = cuts_[c];
    const std::uint32_t v = place_of(c);
    place(v, cut.where);
    corners_[v] = {.faces = {face, cut.right, cut.left},
                   .next = {cut.kept, place_of(cut.following), place_of(cut.previous)}};
    corners_[cut.kept].next[cut.edge] = v;
  }
  // The last corners move to the places left over.
  for (std::size_t c = gone; c-- > cuts_.size();) {
    const std::uint32_t v = removed_[c];
    const auto last = static_cast<std::uint32_t>(corners_.size() - 1);
    if (v != last) {
      place(v, position(last));
      corners_[v] = corners_[last];
      for (const std::uint32_t other : corners_[v].next)
        for (std::uint32_t& next : corners_[other].next)
          if (next == last) next = v;
    }
    corners_.pop_back();
  }
  fill_lanes();
}

bool BallCell::surrounds(std::uint32_t face, Vec3 foot, double disk_squared) const {
  const std::uint32_t start = some_corner_[face];
  const Vec3 first = position(start);
  double widest = 0;
  std::uint32_t v = start;
  do {
    const std::uint32_t w = corners_[v].next[after(number_of(face, v))];
    const Vec3 p = position(v), edge = position(w) - p;
    const double side = dot(faces_[face].normal, cross(p - foot, edge));
    if (!(side >= 0) || side * side < disk_squared / 4 * squared_norm(edge)) return false;
    widest = std::max(widest, squared_norm(p - first));
    v = w;
  } while (v != start);
  return widest > disk_squared;
}

bool BallCell::find_piece(std::uint32_t from, std::uint32_t to, bool begins_in, bool ends_in, double radius,
                          Piece& piece) const {
  const double radius_squared = radius * radius;
  const Vec3 p = position(from), q = position(to);
  piece = {p, q, begins_in, ends_in};
  if (!begins_in && !ends_in) {
    const Vec3 d = q - p;
    const double a = squared_norm(d), b = dot(p, d);
    if (!(b < 0) || !(-b < a)) return false;
    const double depth = radius_squared - squared_norm(cross(p, d)) / a;
    if (!(depth > 0)) return false;
    const double middle = -b / a, half = std::sqrt(depth / a);
    piece.begin = p + std::max(middle - half, 0.0) * d;
    piece.end = p + std::min(middle + half, 1.0) * d;
  } else if (!ends_in) {
    piece.end = passage(p, q, radius_squared);
  } else if (!begins_in) {
    piece.begin = passage(q, p, radius_squared);
  }
  return true;
}

void BallCell::append_outline_corners(double radius, std::vector<Vec3>& corners) const {
  const auto in_ball = [&](std::uint32_t v) { return squared_norm(position(v)) < radius * radius; };
  for (std::uint32_t v = 0; v < corners_.size(); ++v) {
    for (const std::uint32_t w : corners_[v].next) {
      Piece piece;
      if (w < v || !find_piece(v, w, in_ball(v), in_ball(w), radius, piece)) continue;
      if (!piece.begins_in) corners.push_back(piece.begin);
      if (!piece.ends_in) corners.push_back(piece.end);
    }
  }
}

BallCell::Turning BallCell::trace_edges(double radius) {
  const double radius_squared = radius * radius;
  Turning turning;
  // The outline comes along the arc of one face and goes on along that of another: where the other's polygon enters the
  // ball. It turns by the angle between the planes' normals within the sphere's tangent plane. The angle has a sign: on
  // the spheres of grids many planes meet in one point, rounding decides the order in which the outline passes them,
  // and then only signed angles add up to the right one. None turns back, so those near -π are near π.
  AngleSum angles;
  const auto turn = [&](Vec3 where, const Face& from, const Face& to) {
    ++turning.corners;
    const double sine = dot(where, cross(from.normal, to.normal)) / radius;
    const double cosine = dot(from.normal, to.normal) - from.offset * to.offset / radius_squared;
    angles.add(cosine, sine);
    if (sine < 0 && sine > kNearlyBack * cosine) angles.add_turn();
  };
  for (std::uint32_t v = 0; v < corners_.size(); ++v) {
    for (unsigned i = 0; i < 3; ++i) {
      const std::uint32_t w = corners_[v].next[i];
      if (w < v) continue;
      // As seen walking from v to w; the left one's polygon has the edge in this direction.
      const std::uint32_t left = corners_[v].faces[before(i)], right = corners_[v].faces[after(i)];
      if (some_corner_[left] == kNone || some_corner_[right] == kNone) continue;
      Piece piece;
      if (!find_piece(v, w, in_ball_[v], in_ball_[w], radius, piece)) continue;
      const auto& [begin, end, begins_in, ends_in] = piece;
      ++turning.pieces;
      Outline &on_left = outlines_[left], &on_right = outlines_[right];
      const Flat left_begin = on_left.flat(begin), left_end = on_left.flat(end);
      const Flat right_begin = on_right.flat(begin), right_end = on_right.flat(end);
      on_left.add_piece(left_begin, left_end);
      on_right.add_piece(right_end, right_begin);
      if (!begins_in) {
        on_left.enter(left_begin);
        on_right.leave(right_begin);
        turn(begin, faces_[right], faces_[left]);
      }
      if (!ends_in) {
        on_left.leave(left_end);
        on_right.enter(right_end);
        turn(end, faces_[left], faces_[right]);
      }
    }
  }
  turning.angle = angles.sum();
  return turning;
}

// Where planes meet on the sphere, as at every corner of a raw model's cells, rounding would decide which edges cross
// it, and in which order. A ball that is larger by far more than rounding has those corners inside; what it has too
// much is taken off by its derivatives, up to the square of 2^-30.
double BallCell::growth_for(double ball_radius) {
  squares_from({}, x_.data(), y_.data(), z_.data(), lanes(), values_.data());
  const bool corner_on_sphere =
      std::any_of(values_.begin(), values_.begin() + static_cast<std::ptrdiff_t>(lanes()), [&](double square) {
        return std::abs(square - ball_radius * ball_radius) < 0x1p-29 * ball_radius * ball_radius;
      });
  return corner_on_sphere ? 0x1p-30 * ball_radius : 0;
}

BallCell::Inside BallCell::find_corners_inside(double radius) {
  Inside inside;
  in_ball_.resize(corners_.size());
  some_corner_.assign(faces_.size(), kNone);
  for (std::uint32_t v = 0; v < corners_.size(); ++v) {
    in_ball_[v] = values_[v] < radius * radius;
    inside.corners += in_ball_[v];
    for (const std::uint32_t face : corners_[v].faces) {
      const double offset = faces_[face].offset;
      inside.holds_centre &= offset > 0;
      // Some are too far for any of their edges to meet the ball, whatever the rounding.
      if (std::abs(offset) <= (1 + 0x1p-40) * radius) some_corner_[face] = v;
    }
  }
  return inside;
}

void BallCell::begin_outlines(double radius) {
  outlines_.clear();
  for (std::uint32_t f = 0; f < faces_.size(); ++f) {
    const double offset = some_corner_[f] == kNone ? 0 : faces_[f].offset;
    const double disk = std::sqrt(std::max(0.0, (radius - offset) * (radius + offset)));
    outlines_.emplace_back(faces_[f].normal, 1 / std::max(disk, 0x1p-50 * radius));
  }
}

BallCell::FlatParts BallCell::finish_outlines(double radius) {
  FlatParts parts;
  for (std::uint32_t f = 0; f < faces_.size(); ++f) {
    if (some_corner_[f] == kNone) continue;
    const Face& face = faces_[f];
    const Vec3 foot = face.offset * face.normal;
    const double disk_squared = std::max(0.0, (radius - face.offset) * (radius + face.offset));
    Outline& outline = outlines_[f];
    bool circle = false;
    if (!outline.has_pieces() || outline.may_be_circle(disk_squared)) {
      circle = disk_squared > 0 && surrounds(f, foot, disk_squared);
      if (!circle && !outline.has_pieces()) continue;
    }
    outline.finish(disk_squared, circle);
    ++parts.count;
    parts.bending += face.offset / radius * outline.arcs();
    const double area = outline.area();
    const Vec3 about_foot = outline.first(), first = area * foot + about_foot;
    parts.height_areas += face.offset * area;
    parts.push = parts.push - area * face.normal;
    parts.bent_normals = parts.bent_normals + outline.arcs() * face.normal;
    parts.height_first = parts.height_first + face.offset * first;
    add_outer(parts.normal_first, 1, face.normal, first);
    add_outer(parts.height_second, face.offset, foot, first);
    add_outer(parts.height_second, face.offset, about_foot, foot);
    outline.add_second(parts.height_second, face.offset);
  }
  return parts;
}

BallPiece BallCell::measure(double ball_radius) {
  if (empty()) return {};
  const double growth = growth_for(ball_radius);
  const double radius = ball_radius + growth, radius_squared = radius * radius;
  const Inside inside = find_corners_inside(radius);
  begin_outlines(radius);
  const Turning turning = trace_edges(radius);
  const FlatParts flat = finish_outlines(radius);
  // No flat part: the ball is within the cell or beyond it.
  if (flat.count == 0 && !inside.holds_centre) return {};

  const int characteristic = 2 - (flat.count - turning.pieces + inside.corners);
  BallPiece piece{.moments = {}, .area = 0, .push = {}, .characteristic = characteristic, .corners = turning.corners};
  const double area = radius_squared * (kTwoPi * characteristic + flat.bending - turning.angle);
  const double volume = (flat.height_areas + radius * area) / 3;
  piece.area = area - growth * (2 * area / radius - radius * flat.bending);
  piece.moments.volume = volume - growth * piece.area;
  piece.moments.first = 0.25 * (flat.height_first + radius_squared * flat.push) - (growth * radius) * flat.push;
  piece.push = flat.push + (growth * radius) * flat.bent_normals;
  for (std::size_t i = 0; i < 3; ++i) {
    for (std::size_t j = 0; j < 3; ++j) {
      const int ii = static_cast<int>(i), jj = static_cast<int>(j);
      // The integral of x·xᵀ over the spherical part, by radius.
      const double spherical =
          (i == j ? volume : 0) - (flat.normal_first.rows[i][jj] + flat.normal_first.rows[j][ii]) / 2;
      piece.moments.second.rows[i][jj] =
          (flat.height_second.rows[i][jj] + radius_squared * spherical) / 5 - growth * radius * spherical;
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
