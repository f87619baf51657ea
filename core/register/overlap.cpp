// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/register/overlap.h"

#include <Eigen/Dense>
#include <algorithm>
#include <cmath>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/vectors.h"

namespace spherule {

namespace {

// (1 - u/16)^15, from which the kernel and its derivative, the negative of this, follow.
double power15(double t) {
  const double t2 = t * t, t4 = t2 * t2, t8 = t4 * t4;
  return t8 * t4 * t2 * t;
}

// Sums run in this many lanes, and the lanes are added in order: the same on every machine.
constexpr std::size_t kLanes = 8, kFloatLanes = 16;

// Balls as arrays, filled up with balls of no mass.
struct Rows {
  std::vector<double> x, y, z, variance, mass;

  explicit Rows(std::span<const SoftBall> balls) {
    const std::size_t count = (balls.size() + kLanes - 1) / kLanes * kLanes;
    for (std::vector<double>* row : {&x, &y, &z, &mass}) row->assign(count, 0);
    variance.assign(count, 1);
    for (std::size_t i = 0; i < balls.size(); ++i) {
      const SoftBall& b = balls[i];
      x[i] = b.centre.x, y[i] = b.centre.y, z[i] = b.centre.z;
      variance[i] = b.sigma * b.sigma, mass[i] = b.mass;
    }
  }
};

// What all fixed balls do together to a moving one of mass 1.
struct Pull {
  double value = 0, slope = 0;  // of the kernel
  Vec3 force;                   // sum of slope · way to the fixed ball
  double widening = 0;          // change of value with the moving ball's own width
};

SPHERULE_VECTORS
Pull pull(const Rows& fixed, Vec3 at, double grown) {
  const double *fx = fixed.x.data(), *fy = fixed.y.data(), *fz = fixed.z.data(), *fv = fixed.variance.data(),
               *fm = fixed.mass.data();
  double value[kLanes]{}, slope[kLanes]{}, x[kLanes]{}, y[kLanes]{}, z[kLanes]{}, widening[kLanes]{};
  const std::size_t count = fixed.x.size();
  for (std::size_t f = 0; f < count; f += kLanes) {
    for (std::size_t l = 0; l < kLanes; ++l) {
      const double inverse = 1 / (fv[f + l] + grown);
      const double dx = fx[f + l] - at.x, dy = fy[f + l] - at.y, dz = fz[f + l] - at.z;
      const double u = 0.5 * inverse * (dx * dx + dy * dy + dz * dz);
      double t = 1 - u / 16;
      t = t > 0 ? t : 0;
      const double steep = fm[f + l] * inverse * std::sqrt(inverse) * power15(t);
      const double v = steep * t, s = steep * inverse;
      value[l] += v;
      slope[l] += s;
      x[l] += s * dx;
      y[l] += s * dy;
      z[l] += s * dz;
      widening[l] += 2 * s * u - 3 * v * inverse;
    }
  }
  Pull sum;
  for (std::size_t l = 0; l < kLanes; ++l) {
    sum.value += value[l];
    sum.slope += slope[l];
    sum.force = sum.force + Vec3{x[l], y[l], z[l]};
    sum.widening += widening[l];
  }
  return sum;
}

OverlapValue overlap(const Rows& fixed, std::span<const SoftBall> moving, const Pose& pose, double own) {
  OverlapValue sum;
  const double s = pose.scale;
  // Masses s³, the root of the moving set's own integral s^1.5.
  const double common = s * std::sqrt(s) / std::sqrt(own);
  for (const SoftBall& m : moving) {
    const Vec3 y = pose(m.centre);
    const double grown = s * s * m.sigma * m.sigma, mass = common * m.mass;
    const Pull p = pull(fixed, y, grown);
    const Vec3 turn = cross(y, p.force);
    sum.value += mass * p.value;
    // Growth also widens the balls, and adds mass.
    const std::array<double, 7> gradient{
        turn.x, turn.y, turn.z, p.force.x, p.force.y, p.force.z, dot(y, p.force) + 1.5 * p.value + grown * p.widening};
    for (std::size_t i = 0; i < 7; ++i) sum.gradient[i] += mass * gradient[i];
    // Of the point y: it moves by turns × y + shifts + growth · y.
    const Vec3 rows[7] = {{0, -y.z, y.y}, {y.z, 0, -y.x}, {-y.y, y.x, 0}, {1, 0, 0}, {0, 1, 0}, {0, 0, 1}, y};
    for (std::size_t i = 0; i < 7; ++i)
      for (std::size_t j = 0; j <= i; ++j) sum.curvature[i][j] += mass * p.slope * dot(rows[i], rows[j]);
  }
  for (std::size_t i = 0; i < 7; ++i)
    for (std::size_t j = 0; j < i; ++j) sum.curvature[j][i] = sum.curvature[i][j];
  return sum;
}

// Adds, in every lane, what all fixed balls and one moving ball have in common when it is at (x, y, z) of the lane.
SPHERULE_VECTORS
void add_overlaps(const Vec3* fixed, std::size_t count, const float* weights, const float* inverses, const float* x,
                  const float* y, const float* z, float* sum) {
  for (std::size_t f = 0; f < count; ++f) {
    const auto fx = static_cast<float>(fixed[f].x), fy = static_cast<float>(fixed[f].y),
               fz = static_cast<float>(fixed[f].z);
    const float weight = weights[f], inverse = inverses[f];
    for (std::size_t l = 0; l < kFloatLanes; ++l) {
      const float dx = fx - x[l], dy = fy - y[l], dz = fz - z[l];
      float t = 1 - (dx * dx + dy * dy + dz * dz) * inverse;
      t = t > 0 ? t : 0;
      t *= t, t *= t, t *= t, t *= t;
      sum[l] += weight * t;
    }
  }
}

}  // namespace

OverlapValue overlap(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& pose, double own) {
  return overlap(Rows(fixed), moving, pose, own);
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
  std::vector<Vec3> centres;
  for (const SoftBall& f : fixed) centres.push_back(f.centre);
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
  parallel_for(context, {}, rotations.size(), 4 * kFloatLanes, [&](std::size_t begin, std::size_t end) {
    for (std::size_t first = begin; first < end; first += kFloatLanes) {
      const std::size_t count = std::min(kFloatLanes, end - first);
      std::array<float, kFloatLanes> sum{}, x{}, y{}, z{};
      for (std::size_t m = 0; m < moving.size(); ++m) {
        for (std::size_t l = 0; l < count; ++l) {
          const Vec3 p = rotations[first + l] * moving[m].centre;
          x[l] = static_cast<float>(p.x), y[l] = static_cast<float>(p.y), z[l] = static_cast<float>(p.z);
        }
        add_overlaps(centres.data(), centres.size(), &weights[m * centres.size()], &inverses[m * centres.size()],
                     x.data(), y.data(), z.data(), sum.data());
      }
      for (std::size_t l = 0; l < count; ++l) values[first + l] = sum[l];
    }
  });
  return values;
}

Climbed climb(std::span<const SoftBall> fixed, std::span<const SoftBall> moving, const Pose& start, bool scale_too,
              int steps, const Context& context) {
  const double own = self_overlap(fixed) * self_overlap(moving);
  const Rows rows(fixed);
  const int n = scale_too ? 7 : 6;
  Pose pose = start;
  OverlapValue now = overlap(rows, moving, pose, own);
  double damping = 1e-3;
  for (int step = 0; step < steps && damping < 1e6; ++step) {
    context.throw_if_cancelled();
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
    const double growth = elementary::exp(std::clamp(by(6), -0.2, 0.2));
    const Pose next{turn * pose.rotation, growth * pose.scale,
                    growth * (turn * pose.shift) + Vec3{by(3), by(4), by(5)}};
    const OverlapValue then = overlap(rows, moving, next, own);
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
