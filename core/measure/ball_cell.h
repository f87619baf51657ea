// SPDX-License-Identifier: GPL-3.0-or-later
//
// One ball within one convex cell: the brick that unions of balls are measured with.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/geometry.h"
#include "core/measure/mass.h"

namespace spherule {

/// A ball within a convex cell, about the ball's centre.
struct BallPiece {
  Moments moments;
  double area = 0;         ///< of the ball's sphere within the cell
  Vec3 push;               ///< integral of the outer normal over that area
  int characteristic = 0;  ///< Euler characteristic of that part of the sphere
  int corners = 0;         ///< of its outline
};

/// A convex polyhedron, cut plane by plane, in coordinates relative to the centre of a ball. Reuse one object for many
/// balls: it keeps its memory. Not thread safe.
class BallCell {
 public:
  /// Starts over with a polyhedron that holds the whole ball of this radius. The pivot is its centre.
  void reset(double radius);

  /// Starts over with a box that holds `part`, some part of the ball, with a margin, so that no side of it touches it.
  void reset(const Box& part, Vec3 pivot);

  /// Starts over with a tetrahedron of which each face, opposite corner i, was moved outwards by `outwards[i]` >= 0.
  /// The first three corners are clockwise as seen from the fourth. O(1).
  void reset(const std::array<Vec3, 4>& corners, const std::array<double, 4>& outwards, Vec3 pivot);

  /// Keeps the half space normal · x <= offset; `normal` of length 1. What a plane would cut off within a relative
  /// 2^-42 of the polyhedron it started as is left. False when nothing remains. O(corners).
  bool cut(Vec3 normal, double offset);

  bool empty() const { return corners_.empty(); }

  /// No corner is farther from the pivot: planes farther from it cut nothing. Tight unless the last plane cut
  /// something.
  double reach() const { return reach_; }

  /// The ball of this radius within the cell. Volume and moments by the divergence theorem over the flat faces within
  /// the ball and the spherical rest; the rest's area by the theorem of Gauss and Bonnet, with its Euler characteristic
  /// counted from the flat part (both together bound a convex body). Absolute error of the area about 2^-50 radius²;
  /// where the plane of a face nearly touches the ball, in a disk of radius d, 2^-50 radius³/d. O(corners).
  BallPiece measure(double radius);

  /// Appends the corners of the outline of the spherical part, where two faces meet on the sphere. O(corners).
  void append_outline_corners(double radius, std::vector<Vec3>& corners) const;

 private:
  using Triple = std::array<std::uint32_t, 3>;
  // Three faces meet at a corner. Where more planes meet, up to rounding, there are several corners in one place.
  struct Corner {
    Triple faces;  // counter-clockwise as seen from outside
    Triple next;   // next[i] is at the other end of the edge that does not touch faces[i]
  };
  struct Face {
    Vec3 normal;
    double offset = 0;
  };
  // An edge that the cut under way shortens.
  struct Cut {
    std::uint32_t removed;  // the end beyond the plane
    std::uint8_t edge;      // its number there; later, at the end kept
    std::uint32_t kept = 0;
    std::uint32_t left = 0, right = 0;          // its faces, walking towards the end kept
    std::uint32_t following = 0, previous = 0;  // cuts around the new face
    Vec3 where{};
  };
  // A point of a face's plane, in coordinates about the foot of the ball's centre.
  struct Flat {
    double x = 0, y = 0;
  };
  // What a face has within the ball: a part of a disk about its foot, with an outline of straight pieces and arcs. The
  // integrals of 1, x and x·xᵀ over it are sums over triangles and sectors between the foot and these pieces, and those
  // of the sectors are differences of what their ends contribute: so pieces may come in any order.
  class Outline {
   public:
    Outline(Vec3 normal, double scale);  // `scale` is about the inverse of the disk's radius

    Flat flat(Vec3 p) const { return {dot(right_, p), dot(up_, p)}; }
    // Of the polygon, counter-clockwise. An arc ends where one enters the ball and begins where one leaves it.
    void add_piece(Flat from, Flat to);
    void enter(Flat p) { end_arc(p, 1); }
    void leave(Flat p) { end_arc(p, -1); }

    bool has_pieces() const { return has_pieces_; }
    // The arcs' angles together are near a whole number of turns, and what else there is is short.
    bool may_be_circle(double disk_squared) const;
    void finish(double disk_squared, bool circle);
    double arcs() const { return arcs_; }  // their angles together
    double area() const { return area_; }
    Vec3 first() const { return first_.x * right_ + first_.y * up_; }
    void add_second(Mat3& sum, double weight) const;

   private:
    void end_arc(Flat p, double sign);

    Vec3 right_, up_;
    double scale_;
    double triangles_ = 0;  // twice their area; so on
    Flat triangles_first_;
    std::array<double, 3> triangles_second_{};  // xx, xy, yy
    double cosine_ = 1, sine_ = 0;              // of the arcs' angles together, times about 1
    Flat arcs_first_;
    std::array<double, 2> arcs_second_{};
    double longest_squared_ = 0;
    bool has_pieces_ = false;
    double arcs_ = 0, area_ = 0;
    Flat first_;
    std::array<double, 3> second_{};
  };
  // An edge within the ball, from its lower-numbered end.
  struct Piece {
    Vec3 begin, end;
    bool begins_in, ends_in;  // whether that is a corner of the cell; else it is on the sphere
  };
  struct Turning {
    double angle = 0;             // of the spherical part's outline at its corners, where edges pass the sphere
    int corners = 0, pieces = 0;  // of it; of edges within the ball
  };

  struct Inside {
    int corners = 0;  // of the cell, within the ball
    bool holds_centre = true;
  };
  // Sums over what faces have within the ball.
  struct FlatParts {
    int count = 0;
    double bending = 0;  // of the spherical part's outline along its arcs
    Vec3 push, bent_normals;
    Mat3 normal_first{{Vec3{}, Vec3{}, Vec3{}}};
    // Integrals of 1, x and x·xᵀ, each by the face's offset.
    double height_areas = 0;
    Vec3 height_first;
    Mat3 height_second{{Vec3{}, Vec3{}, Vec3{}}};
  };

  template <std::size_t Count>
  void start(const std::array<Vec3, Count>& positions, const std::array<Corner, Count>& corners, Vec3 pivot);
  std::size_t lanes() const { return (corners_.size() + 7) / 8 * 8; }
  Vec3 position(std::size_t corner) const { return {x_[corner], y_[corner], z_[corner]}; }
  void place(std::size_t corner, Vec3 at) { x_[corner] = at.x, y_[corner] = at.y, z_[corner] = at.z; }
  void make_room();
  void fill_lanes();
  void measure_reach();
  bool find_cuts(double limit);
  void replace_removed();
  unsigned number_of(std::uint32_t face, std::uint32_t corner) const {
    const Triple& faces = corners_[corner].faces;
    return faces[0] == face ? 0 : faces[1] == face ? 1 : 2;
  }
  // False when the edge misses the ball.
  bool find_piece(std::uint32_t from, std::uint32_t to, bool begins_in, bool ends_in, double radius,
                  Piece& piece) const;
  // The steps of measure, in order.
  double growth_for(double ball_radius);
  Inside find_corners_inside(double radius);
  void begin_outlines(double radius);
  // Hands what edges have within the ball to their faces' outlines.
  Turning trace_edges(double radius);
  FlatParts finish_outlines(double radius);
  // Whether a face lies around the disk, given that it does or is far from it.
  bool surrounds(std::uint32_t face, Vec3 foot, double disk_squared) const;

  Vec3 pivot_;
  std::vector<Corner> corners_;
  std::vector<double> x_, y_, z_;  // of the corners; then of the first one again, to a whole number of lanes
  std::vector<Face> faces_;        // some may have lost all their corners
  double reach_ = 0, tolerance_ = 0;
  bool reach_is_tight_ = false;
  std::vector<double> values_;  // of the corners: heights over a plane, or squared distances
  // Of the cut under way.
  std::vector<std::uint32_t> removed_;  // corners, ascending
  std::vector<Cut> cuts_;
  std::vector<std::uint32_t> cut_of_face_;  // that with the face on its right
  // Of the measurement under way.
  std::vector<std::uint8_t> in_ball_;
  std::vector<std::uint32_t> some_corner_;  // of a face; none without, and when it is too far to meet the ball
  std::vector<Outline> outlines_;           // of the faces
};

/// The box of the part of a ball about the origin that lies beyond a plane (normal · x >= offset), for |offset| <=
/// radius.
Box cap_box(double radius, Vec3 normal, double offset);

}  // namespace spherule
