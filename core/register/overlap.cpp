// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/overlap.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "core/base/parallel.h"

namespace spherule {

namespace {

// (1 - u/16)^15, from which the kernel and its derivative, the negative of this, follow.
double power15(double t) {
  const double t2 = t * t, t4 = t2 * t2, t8 = t4 * t4;
  return t8 * t4 * t2 * t;
}

}  // namespace

OverlapValue overlap(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& pose, double own) {
  OverlapValue sum;
  const double s = pose.scale;
  // Masses s³, the root of the moving set's own integral s^1.5.
  const double common = s * std::sqrt(s) / std::sqrt(own);
  for (const SoftBall& m : moving) {
    const Vec3 y = pose(m.centre);
    const double grown = s * s * m.sigma * m.sigma;
    for (const SoftBall& f : fixed) {
      const double variance = f.sigma * f.sigma + grown;
      const Vec3 d = f.centre - y;
      const double u = squared_norm(d) / (2 * variance);
      const double t = 1 - u / 16;
      if (t <= 0) continue;
      const double weight = common * f.mass * m.mass / (variance * std::sqrt(variance));
      const double p = power15(t), slope = weight * p / variance;
      const double value = weight * p * t;
      sum.value += value;
      const Vec3 turn = cross(y, d);
      const std::array<double, 7> step{turn.x, turn.y, turn.z, d.x, d.y, d.z, dot(y, d)};
      for (std::size_t i = 0; i < 7; ++i) sum.gradient[i] += slope * step[i];
      // Growth also widens the balls: in the factor before the kernel, and in u.
      sum.gradient[6] += 1.5 * value - 3 * value * grown / variance + 2 * slope * u * grown;
      // Of the point y: it moves by turns × y + shifts + growth · y.
      const Vec3 rows[7] = {{0, -y.z, y.y}, {y.z, 0, -y.x}, {-y.y, y.x, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, y};
      for (std::size_t i = 0; i < 7; ++i)
        for (std::size_t j = 0; j <= i; ++j) sum.curvature[i][j] += slope * dot(rows[i], rows[j]);
    }
  }
  for (std::size_t i = 0; i < 7; ++i)
    for (std::size_t j = 0; j < i; ++j) sum.curvature[j][i] = sum.curvature[i][j];
  return sum;
}

double self_overlap(std::span<const SoftBall> balls) {
  double sum = 0;
  for (const SoftBall& a : balls) {
    for (const SoftBall& b : balls) {
      const double variance = a.sigma * a.sigma + b.sigma * b.sigma;
      const double t = 1 - squared_norm(a.centre - b.centre) / (32 * variance);
      if (t > 0) sum += a.mass * b.mass / (variance * std::sqrt(variance)) * power15(t) * t;
    }
  }
  return sum;
}

std::vector<float> overlaps(std::span<const SoftBall> fixed, std::span<const SoftBall> moving,
                            std::span<const Mat3> rotations, const Context& context) {
  constexpr std::size_t kLanes = 16;
  std::vector<float> weights, inverses;
  const double common = 1 / std::sqrt(self_overlap(fixed) * self_overlap(moving));
  for (const SoftBall& m : moving) {
    for (const SoftBall& f : fixed) {
      const double variance = f.sigma * f.sigma + m.sigma * m.sigma;
      weights.push_back(static_cast<float>(common * f.mass * m.mass / (variance * std::sqrt(variance))));
      inverses.push_back(static_cast<float>(1 / (32 * variance)));
    }
  }
  std::vector<float> values(rotations.size());
  parallel_for(context, {}, rotations.size(), 2 * kLanes, [&](std::size_t begin, std::size_t end) {
    for (std::size_t first = begin; first < end; first += kLanes) {
      const std::size_t count = std::min(kLanes, end - first);
      std::array<float, kLanes> sum{}, x{}, y{}, z{};
      for (std::size_t m = 0; m < moving.size(); ++m) {
        for (std::size_t l = 0; l < count; ++l) {
          const Vec3 p = rotations[first + l] * moving[m].centre;
          x[l] = static_cast<float>(p.x), y[l] = static_cast<float>(p.y), z[l] = static_cast<float>(p.z);
        }
        for (std::size_t f = 0; f < fixed.size(); ++f) {
          const auto fx = static_cast<float>(fixed[f].centre.x), fy = static_cast<float>(fixed[f].centre.y),
                     fz = static_cast<float>(fixed[f].centre.z);
          const float weight = weights[m * fixed.size() + f], inverse = inverses[m * fixed.size() + f];
          for (std::size_t l = 0; l < kLanes; ++l) {
            const float dx = fx - x[l], dy = fy - y[l], dz = fz - z[l];
            float t = 1 - (dx * dx + dy * dy + dz * dz) * inverse;
            t = t > 0 ? t : 0;
            t *= t, t *= t, t *= t, t *= t;
            sum[l] += weight * t;
          }
        }
      }
      for (std::size_t l = 0; l < count; ++l) values[first + l] = sum[l];
    }
  });
  return values;
}

Climbed climb(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& start, bool scale_too,
              int steps) {
  const double own = self_overlap(fixed) * self_overlap(moving);
  const int n = scale_too ? 7 : 6;
  Pose pose = start;
  OverlapValue now = overlap(fixed, moving, pose, own);
  double damping = 1e-3;
  for (int step = 0; step < steps && damping < 1e6; ++step) {
    Eigen::Matrix<double, 7, 7> curvature = Eigen::Matrix<double, 7, 7>::Identity();
    Eigen::Matrix<double, 7, 1> gradient = Eigen::Matrix<double, 7, 1>::Zero();
    for (int i = 0; i < n; ++i) {
      gradient(i) = now.gradient[static_cast<std::size_t>(i)];
      for (int j = 0; j < n; ++j)
        curvature(i, j) = now.curvature[static_cast<std::size_t>(i)][static_cast<std::size_t>(j)];
    }
    for (int i = 0; i < n; ++i) curvature(i, i) = curvature(i, i) * (1 + damping) + 1e-12 * now.value;
    const Eigen::Matrix<double, 7, 1> by = curvature.ldlt().solve(gradient);
    if (!by.allFinite()) break;
    const Mat3 turn = rotation(Vec3{by(0), by(1), by(2)});
    const double growth = std::exp(std::clamp(by(6), -0.2, 0.2));
    const Pose next{turn * pose.rotation, growth * pose.scale,
                    growth * (turn * pose.shift) + Vec3{by(3), by(4), by(5)}};
    const OverlapValue then = overlap(fixed, moving, next, own);
    if (then.value > now.value) {
      const double gain = then.value - now.value;
      pose = next, now = then;
      damping = std::max(damping * 0.3, 1e-4);
      if (gain < 1e-6 * now.value) break;
    } else {
      damping *= 8;
    }
  }
  return {pose, now.value};
}

}  // namespace spherule
