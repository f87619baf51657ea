// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/mass.h"

#include <Eigen/Eigenvalues>
#include <cmath>

namespace spherule {

namespace {

Mat3 outer(Vec3 a, Vec3 b) { return {{a.x * b, a.y * b, a.z * b}}; }

Mat3 sum(const Mat3& a, const Mat3& b) {
  return {{a.rows[0] + b.rows[0], a.rows[1] + b.rows[1], a.rows[2] + b.rows[2]}};
}

// The eigenvector with the sign that makes its largest component positive (the first of equal ones).
Vec3 signed_alike(Vec3 v) {
  int largest = 0;
  for (int a = 1; a < 3; ++a)
    if (std::abs(v[a]) > std::abs(v[largest])) largest = a;
  return v[largest] < 0 ? -v : v;
}

}  // namespace

Moments& Moments::operator+=(const Moments& other) {
  volume += other.volume;
  first = first + other.first;
  second = sum(second, other.second);
  return *this;
}

Moments translated(const Moments& m, Vec3 shift) {
  return {
      .volume = m.volume,
      .first = m.first + m.volume * shift,
      .second = sum(sum(m.second, outer(m.volume * shift, shift)), sum(outer(m.first, shift), outer(shift, m.first)))};
}

Moments transformed(const Moments& m, const Mat3& axes, double scale) {
  const double cubed = scale * scale * scale;
  Moments result{.volume = cubed * m.volume, .first = cubed * scale * (axes * m.first), .second = {}};
  result.second = axes * m.second * transposed(axes);
  for (Vec3& row : result.second.rows) row = cubed * scale * scale * row;
  return result;
}

MassProperties mass_properties(const Moments& moments) {
  MassProperties mass;
  if (!(moments.volume > 0)) return mass;
  mass.volume_mm3 = moments.volume;
  mass.centroid_mm = (1 / moments.volume) * moments.first;
  const Mat3 central = translated(moments, -mass.centroid_mm).second;
  const double trace = central.rows[0].x + central.rows[1].y + central.rows[2].z;
  Eigen::Matrix3d inertia;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) {
      const auto row = static_cast<std::size_t>(i);
      mass.inertia_mm5.rows[row][j] = (i == j ? trace : 0) - central.rows[row][j];
      inertia(i, j) = mass.inertia_mm5.rows[row][j];
    }
  }
  const Eigen::SelfAdjointEigenSolver<Eigen::Matrix3d> solver(inertia);
  const auto axis = [&](int i) {
    const auto v = solver.eigenvectors().col(i);
    return signed_alike({v(0), v(1), v(2)});
  };
  for (int i = 0; i < 3; ++i) mass.principal_moments_mm5[static_cast<std::size_t>(i)] = solver.eigenvalues()(i);
  mass.principal_axes.rows = {axis(0), axis(1), cross(axis(0), axis(1))};
  return mass;
}

}  // namespace spherule
