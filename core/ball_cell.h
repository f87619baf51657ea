// SPDX-License-Identifier: GPL-3.0-or-later
//
// One ball within one convex cell: the brick that unions of balls are measured with.
#pragma once

#include <array>
#include <cstdint>
#include <vector>

#include "core/base/geometry.h"
#include "core/mass.h"

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

  /// Starts over with a frustum: what is beyond the triangle `base` as seen from `apex`, as far as the triangle
  /// enlarged by `scale` > 1 about the apex. The corners may be relative to any origin; the ball's centre is at
  /// `centre` there. Seen from the apex the base is clockwise.
  void reset(const std::array<Vec3, 3>& base, Vec3 apex, double scale, Vec3 centre, Vec3 pivot);

  /// Keeps the half space normal · x <= offset; `normal` of length 1. What a plane would cut off within a relative
  /// 2^-42 of the box is left. False when nothing remains. O(corners).
  bool cut(Vec3 normal, double offset);

  bool empty() const { return faces_.empty(); }

  /// The largest distance of a corner from the pivot: planes farther from it cut nothing.
  double reach() const { return reach_; }

  /// The ball of this radius within the cell. Volume and moments by the divergence theorem over the flat faces within
  /// the ball and the spherical rest; the rest's area by the theorem of Gauss and Bonnet, with its Euler characteristic
  /// counted from the flat part (both together bound a convex body). Absolute error of the area about 2^-50 radius²;
  /// where the plane of a face nearly touches the ball, in a disk of radius d, 2^-50 radius³/d. O(corners).
  BallPiece measure(double radius) const;

 private:
  struct Face {
    Vec3 normal;
    double offset = 0;
    std::uint32_t begin = 0, end = 0;  // of its corners in loops_, counter-clockwise as seen from outside
  };
  struct Cut {
    std::uint32_t kept, removed;  // ends of the edge that the plane cuts
    std::uint32_t next;           // the following corner of the new face, as a cut's number
  };
  struct CrossedEdge {
    std::uint32_t low, high;  // its corners
    std::uint32_t face;
    std::uint32_t older;  // edge of the same low corner, or none
  };
  void start(Vec3 pivot);
  bool cut_above(Vec3 normal, double offset, double limit);
  std::uint32_t cut_edge(std::uint32_t kept, std::uint32_t removed);
  bool cut_face(std::uint32_t face, std::uint32_t first_new);
  // Whether a face lies around the disk, given that it does or is far from it.
  bool surrounds(const Face& face, Vec3 foot, double disk_squared) const;

  // Corners and loops only grow until the next reset: what a cut leaves alone stays where it is.
  Vec3 pivot_;
  std::vector<Vec3> corners_;
  std::vector<std::uint32_t> alive_;  // the polyhedron's corners, of all that ever were
  std::vector<Face> faces_;
  std::vector<std::uint32_t> loops_;
  double reach_ = 0, tolerance_ = 0;
  // Of the cut under way.
  std::vector<double> heights_;        // of all alive corners, by number
  std::vector<std::uint8_t> removed_;  // by number
  std::vector<Cut> cuts_;
  struct NewLoop {
    std::uint32_t face, begin, end;
  };
  std::vector<NewLoop> new_loops_;  // of the faces that lose corners, ascending; empty ones vanish
  // Of the measurement under way.
  mutable std::vector<CrossedEdge> crossed_;
  mutable std::vector<std::uint32_t> newest_;
  mutable std::vector<std::uint8_t> in_ball_;
};

/// The box of the part of a ball about the origin that lies beyond a plane (normal · x >= offset), for |offset| <=
/// radius.
Box cap_box(double radius, Vec3 normal, double offset);

}  // namespace spherule
