// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/transform.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>
#include <limits>
#include <numbers>

#include "core/base/check.h"
#include "core/base/elementary.h"

namespace spherule {

namespace {

constexpr double kDegrees = 180 / std::numbers::pi;

Mat3 from_columns(Vec3 a, Vec3 b, Vec3 c) { return transposed({{a, b, c}}); }

// The determinant of a matrix divided by 2^exponent, which leaves its largest element near 1: that of the matrix itself
// could be too large or too small for a number. Not a number where an element is none.
struct Sized {
  double determinant = 0;
  int exponent = 0;
};
Sized sized(const Mat3& m) {
  double largest = 0;
  for (const Vec3 row : m.rows) {
    for (int a = 0; a < 3; ++a) {
      if (!std::isfinite(row[a])) return {std::numeric_limits<double>::quiet_NaN(), 0};
      largest = std::max(largest, std::abs(row[a]));
    }
  }
  if (largest == 0) return {};
  const int exponent = std::ilogb(largest);
  Mat3 near_one = m;
  for (Vec3& row : near_one.rows)
    row = {std::ldexp(row.x, -exponent), std::ldexp(row.y, -exponent), std::ldexp(row.z, -exponent)};
  return {determinant(near_one), exponent};
}

}  // namespace

Mat3 scaled(double factor, const Mat3& m) { return {{factor * m.rows[0], factor * m.rows[1], factor * m.rows[2]}}; }

Mat3 inverse(const Mat3& m) {
  const auto& [a, b, c] = m.rows;
  return scaled(1 / determinant(m), from_columns(cross(b, c), cross(c, a), cross(a, b)));
}

AffineMap inverse(const AffineMap& map) {
  const Mat3 back = inverse(map.linear);
  return {back, -(back * map.shift)};
}

bool is_proper(const AffineMap& map) {
  const double sum = squared_norm(map.shift);
  return std::isfinite(sum) && sized(map.linear).determinant > 0;
}

double scale_of(const AffineMap& map) {
  const Sized sized_linear = sized(map.linear);
  return std::ldexp(elementary::cbrt(sized_linear.determinant), sized_linear.exponent);
}

Mat3 rotation(const Quaternion& q) {
  const double xx = q.x * q.x, yy = q.y * q.y, zz = q.z * q.z;
  return {{Vec3{1 - 2 * (yy + zz), 2 * (q.x * q.y - q.w * q.z), 2 * (q.x * q.z + q.w * q.y)},
           Vec3{2 * (q.x * q.y + q.w * q.z), 1 - 2 * (xx + zz), 2 * (q.y * q.z - q.w * q.x)},
           Vec3{2 * (q.x * q.z - q.w * q.y), 2 * (q.y * q.z + q.w * q.x), 1 - 2 * (xx + yy)}}};
}

Mat3 rotation(Vec3 v) {
  const double angle = norm(v);
  if (angle == 0) return {};
  const Vec3 half = (elementary::sin(angle / 2) / angle) * v;
  return rotation(Quaternion{elementary::cos(angle / 2), half.x, half.y, half.z});
}

Quaternion quaternion(const Mat3& m) {
  // The largest of the four components first: its square is at least 1/4, so dividing by it loses nothing.
  const double xx = m.rows[0].x, yy = m.rows[1].y, zz = m.rows[2].z;
  const std::array<double, 4> squares{1 + xx + yy + zz, 1 + xx - yy - zz, 1 - xx + yy - zz, 1 - xx - yy + zz};
  const auto largest = std::ranges::max_element(squares) - squares.begin();
  const double wx = m.rows[2].y - m.rows[1].z, wy = m.rows[0].z - m.rows[2].x, wz = m.rows[1].x - m.rows[0].y;
  const double xy = m.rows[1].x + m.rows[0].y, xz = m.rows[0].z + m.rows[2].x, yz = m.rows[2].y + m.rows[1].z;
  const double s = squares[static_cast<std::size_t>(largest)];
  Quaternion q = largest == 0   ? Quaternion{s, wx, wy, wz}
                 : largest == 1 ? Quaternion{wx, s, xy, xz}
                 : largest == 2 ? Quaternion{wy, xy, s, yz}
                                : Quaternion{wz, xz, yz, s};
  double size = std::sqrt(q.w * q.w + q.x * q.x + q.y * q.y + q.z * q.z);
  if (q.w < 0) size = -size;
  return {q.w / size, q.x / size, q.y / size, q.z / size};
}

double angle_between(const Mat3& a, const Mat3& b) {
  const Quaternion q = quaternion(b * transposed(a));
  return 2 * elementary::atan2(std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z), q.w) * kDegrees;
}

Mat3 nearest_rotation(const Mat3& m) {
  Eigen::Matrix3d e;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) e(i, j) = m.rows[static_cast<std::size_t>(i)][j];
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(e, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Matrix3d r = svd.matrixU() * svd.matrixV().transpose();
  if (r.determinant() < 0) {
    Eigen::Matrix3d u = svd.matrixU();
    u.col(2) *= -1;
    r = u * svd.matrixV().transpose();
  }
  Mat3 result;
  for (int i = 0; i < 3; ++i)
    for (int j = 0; j < 3; ++j) result.rows[static_cast<std::size_t>(i)][j] = r(i, j);
  return result;
}

Decomposition decompose(const AffineMap& map, Vec3 centre) {
  SPHERULE_CHECK(is_proper(map));
  const Vec3 a = map.linear.column(0), b = map.linear.column(1), c = map.linear.column(2);
  Decomposition d;
  const Vec3 x = normalised(a);
  const Vec3 y = normalised(b - dot(x, b) * x);
  const Vec3 z = cross(x, y);
  d.rotation = from_columns(x, y, z);
  d.scales = {norm(a), dot(y, b), dot(z, c)};
  d.shear = {dot(x, b) / d.scales.x, dot(x, c) / d.scales.x, dot(y, c) / d.scales.y};
  d.quaternion = quaternion(d.rotation);
  const Vec3 imaginary{d.quaternion.x, d.quaternion.y, d.quaternion.z};
  const double sine = norm(imaginary);
  if (sine > 0) d.axis = (1 / sine) * imaginary;
  d.angle_deg = 2 * elementary::atan2(sine, d.quaternion.w) * kDegrees;
  const auto& r = d.rotation.rows;
  d.euler_xyz_deg.y = elementary::asin(std::clamp(-r[2].x, -1.0, 1.0)) * kDegrees;
  if (elementary::hypot(r[2].y, r[2].z) > 1e-9) {
    d.euler_xyz_deg.x = elementary::atan2(r[2].y, r[2].z) * kDegrees;
    d.euler_xyz_deg.z = elementary::atan2(r[1].x, r[0].x) * kDegrees;
  } else {
    // Only the sum or the difference of the two is known: all of it is given to z.
    d.euler_xyz_deg.z = elementary::atan2(-r[0].y, r[1].y) * kDegrees;
  }
  d.centre = centre;
  d.translation = map(centre) - centre;
  return d;
}

AffineMap composed(const Decomposition& d) {
  const Mat3 upper{{Vec3{d.scales.x, d.scales.x * d.shear.x, d.scales.x * d.shear.y},
                    Vec3{0, d.scales.y, d.scales.y * d.shear.z}, Vec3{0, 0, d.scales.z}}};
  const Mat3 linear = d.rotation * upper;
  return {linear, d.centre + d.translation - linear * d.centre};
}

}  // namespace spherule
