// SPDX-License-Identifier: GPL-3.0-or-later
//
// Small value types of Euclidean space. Lengths are mm and the frame is DICOM LPS (x to the patient's left,
// y to the posterior, z to the head) unless a comment says otherwise.
#pragma once

#include <algorithm>
#include <array>
#include <cmath>
#include <limits>

namespace spherule {

struct Vec3 {
  double x = 0, y = 0, z = 0;

  constexpr double operator[](int axis) const { return axis == 0 ? x : axis == 1 ? y : z; }
  constexpr double& operator[](int axis) { return axis == 0 ? x : axis == 1 ? y : z; }
  friend constexpr Vec3 operator+(Vec3 a, Vec3 b) { return {a.x + b.x, a.y + b.y, a.z + b.z}; }
  friend constexpr Vec3 operator-(Vec3 a, Vec3 b) { return {a.x - b.x, a.y - b.y, a.z - b.z}; }
  friend constexpr Vec3 operator-(Vec3 a) { return {-a.x, -a.y, -a.z}; }
  friend constexpr Vec3 operator*(double s, Vec3 a) { return {s * a.x, s * a.y, s * a.z}; }
  friend constexpr bool operator==(const Vec3&, const Vec3&) = default;
};

constexpr double dot(Vec3 a, Vec3 b) { return a.x * b.x + a.y * b.y + a.z * b.z; }
constexpr Vec3 cross(Vec3 a, Vec3 b) { return {a.y * b.z - a.z * b.y, a.z * b.x - a.x * b.z, a.x * b.y - a.y * b.x}; }
constexpr double squared_norm(Vec3 a) { return dot(a, a); }
inline double norm(Vec3 a) { return std::sqrt(dot(a, a)); }
inline Vec3 normalised(Vec3 a) { return (1 / norm(a)) * a; }

/// 3x3 matrix, row-major; the default is the identity.
struct Mat3 {
  std::array<Vec3, 3> rows{Vec3{1, 0, 0}, Vec3{0, 1, 0}, Vec3{0, 0, 1}};

  constexpr Vec3 column(int j) const { return {rows[0][j], rows[1][j], rows[2][j]}; }
  friend constexpr Vec3 operator*(const Mat3& m, Vec3 v) {
    return {dot(m.rows[0], v), dot(m.rows[1], v), dot(m.rows[2], v)};
  }
  friend constexpr bool operator==(const Mat3&, const Mat3&) = default;
};

constexpr Mat3 transposed(const Mat3& m) { return {{m.column(0), m.column(1), m.column(2)}}; }
constexpr Mat3 operator*(const Mat3& a, const Mat3& b) {
  const Mat3 bt = transposed(b);
  return {{bt * a.rows[0], bt * a.rows[1], bt * a.rows[2]}};
}
constexpr double determinant(const Mat3& m) { return dot(m.rows[0], cross(m.rows[1], m.rows[2])); }

struct Sphere {
  Vec3 centre;        ///< mm
  double radius = 0;  ///< mm
  friend constexpr bool operator==(const Sphere&, const Sphere&) = default;
};

/// Axis-aligned box; the default is empty (min > max).
struct Box {
  Vec3 min{std::numeric_limits<double>::infinity(), std::numeric_limits<double>::infinity(),
           std::numeric_limits<double>::infinity()};
  Vec3 max{-std::numeric_limits<double>::infinity(), -std::numeric_limits<double>::infinity(),
           -std::numeric_limits<double>::infinity()};

  constexpr bool empty() const { return min.x > max.x; }
  constexpr void include(Vec3 p) {
    for (int a = 0; a < 3; ++a) min[a] = std::min(min[a], p[a]), max[a] = std::max(max[a], p[a]);
  }
  constexpr void include(const Sphere& s) {
    include(s.centre - Vec3{s.radius, s.radius, s.radius});
    include(s.centre + Vec3{s.radius, s.radius, s.radius});
  }
};
/// The box around a ball.
constexpr Box box_of(const Sphere& s) {
  Box box;
  box.include(s);
  return box;
}

}  // namespace spherule
