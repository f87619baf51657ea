// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/solve.h"

#include <Eigen/Dense>
#include <cmath>

namespace spherule {

namespace {

Eigen::Vector3d eigen(Vec3 v) { return {v.x, v.y, v.z}; }
Mat3 from_eigen(const Eigen::Matrix3d& e) {
  return {{Vec3{e(0, 0), e(0, 1), e(0, 2)}, Vec3{e(1, 0), e(1, 1), e(1, 2)}, Vec3{e(2, 0), e(2, 1), e(2, 2)}}};
}

}  // namespace

AffineMap solve(TransformKind kind, std::span<const PointPair> pairs) {
  double weight = 0;
  Vec3 moving, fixed;
  for (const PointPair& p : pairs) {
    weight += p.weight;
    moving = moving + p.weight * p.moving;
    fixed = fixed + p.weight * p.fixed;
  }
  if (!(weight > 0)) return {};
  moving = (1 / weight) * moving;
  fixed = (1 / weight) * fixed;
  Eigen::Matrix3d across = Eigen::Matrix3d::Zero(), within = Eigen::Matrix3d::Zero();
  for (const PointPair& p : pairs) {
    const Eigen::Vector3d m = eigen(p.moving - moving), f = eigen(p.fixed - fixed);
    across += p.weight * f * m.transpose();
    within += p.weight * m * m.transpose();
  }
  AffineMap map;
  const auto place = [&] {
    map.shift = fixed - map.linear * moving;
    return map;
  };
  if (kind == TransformKind::affine) {
    const Eigen::FullPivLU<Eigen::Matrix3d> lu(within);
    if (lu.isInvertible()) {
      // linear · within = across, and both sides transposed are what a solver takes.
      map.linear = from_eigen(lu.solve(across.transpose()).transpose());
      if (determinant(map.linear) > 0) return place();
    }
  }
  const Eigen::JacobiSVD<Eigen::Matrix3d> svd(across, Eigen::ComputeFullU | Eigen::ComputeFullV);
  Eigen::Vector3d sign(1, 1, 1);
  if (svd.matrixU().determinant() * svd.matrixV().determinant() < 0) sign(2) = -1;
  const Eigen::Matrix3d turn = svd.matrixU() * sign.asDiagonal() * svd.matrixV().transpose();
  const double spread = within.trace(), along = svd.singularValues().dot(sign);
  const double scale = kind != TransformKind::rigid && spread > 0 && along > 0 ? along / spread : 1;
  map.linear = scaled(scale, from_eigen(turn));
  return place();
}

double rms_residual(const AffineMap& map, std::span<const PointPair> pairs) {
  double sum = 0, weight = 0;
  for (const PointPair& p : pairs) {
    sum += p.weight * squared_norm(p.fixed - map(p.moving));
    weight += p.weight;
  }
  return weight > 0 ? std::sqrt(sum / weight) : 0;
}

}  // namespace spherule
