// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/enclosing.h"

#include <Eigen/Dense>
#include <cmath>
#include <optional>

#include "core/base/check.h"

namespace spherule {

namespace {

constexpr double kTolerance = 1e-12;

double reach(Vec3 centre, const Sphere& ball) { return norm(ball.centre - centre) + ball.radius; }

// The smallest sphere that all of 1 … 4 balls touch from inside, if there is one. With d_i = c_i - c_0, s_i = r_i - r_0
// and the centre c_0 + p, radius r_0 + q: |p| = q and |p - d_i| = q - s_i, so 2 p·d_i = d_i² - s_i² + 2 q s_i. p lies
// in the span of the d_i (else a smaller sphere would do), so p = u + q v with u and v from that linear system, and |u
// + q v|² = q² gives q.
std::optional<Sphere> touching(std::span<const Sphere> balls) {
  const Sphere& first = balls[0];
  const auto m = static_cast<Eigen::Index>(balls.size()) - 1;
  if (m == 0) return first;
  Eigen::MatrixXd d(3, m);
  Eigen::MatrixXd right(m, 2);
  for (Eigen::Index i = 0; i < m; ++i) {
    const Sphere& ball = balls[static_cast<std::size_t>(i) + 1];
    const Vec3 offset = ball.centre - first.centre;
    const double s = ball.radius - first.radius;
    d.col(i) << offset.x, offset.y, offset.z;
    right.row(i) << 0.5 * (squared_norm(offset) - s * s), s;
  }
  const Eigen::ColPivHouseholderQR<Eigen::MatrixXd> qr(d.transpose() * d);
  if (qr.rank() < m) return std::nullopt;
  const Eigen::MatrixXd uv = d * qr.solve(right);
  const Eigen::Vector3d u = uv.col(0), v = uv.col(1);
  // (v·v - 1) q² + 2 u·v q + u·u = 0; the least root that holds every ball.
  const double a = v.squaredNorm() - 1, b = u.dot(v), c = u.squaredNorm();
  const double root = std::sqrt(std::max(b * b - a * c, 0.0));
  std::array<double, 2> roots{};
  if (std::abs(a) < 1e-14) {
    if (b == 0) return std::nullopt;
    roots = {-c / (2 * b), -c / (2 * b)};
  } else {
    const double sum = -(b + std::copysign(root, b));
    roots = {sum / a, sum == 0 ? 0 : c / sum};
    if (roots[0] > roots[1]) std::swap(roots[0], roots[1]);
  }
  double least = 0;
  for (const Sphere& ball : balls) least = std::max(least, ball.radius - first.radius);
  for (const double q : roots) {
    if (!(q >= least * (1 - kTolerance))) continue;
    const Eigen::Vector3d p = u + q * v;
    return Sphere{first.centre + Vec3{p.x(), p.y(), p.z()}, first.radius + q};
  }
  return std::nullopt;
}

// The smallest sphere around at most five balls, and which of them it touches: the best of all subsets.
struct Small {
  Sphere sphere{{}, std::numeric_limits<double>::infinity()};
  unsigned subset = 0;
};
Small around(std::span<const Sphere> balls) {
  Small best;
  for (unsigned subset = 1; subset < 1U << balls.size(); ++subset) {
    std::vector<Sphere> chosen;
    for (std::size_t i = 0; i < balls.size(); ++i) {
      if (subset >> i & 1U) chosen.push_back(balls[i]);
    }
    if (chosen.size() > 4) continue;
    const auto sphere = touching(chosen);
    if (!sphere || !(sphere->radius < best.sphere.radius)) continue;
    bool holds = true;
    for (const Sphere& ball : balls) holds &= reach(sphere->centre, ball) <= sphere->radius * (1 + 16 * kTolerance);
    if (holds) best = {*sphere, subset};
  }
  return best;
}

}  // namespace

Enclosing smallest_enclosing(std::span<const Sphere> balls, std::span<const std::uint32_t> members) {
  SPHERULE_CHECK(!members.empty());
  Enclosing result{balls[members[0]], {members[0]}};
  for (;;) {
    std::uint32_t farthest = members[0];
    double most = -1;
    for (const std::uint32_t m : members) {
      const double far = reach(result.sphere.centre, balls[m]);
      if (far > most) most = far, farthest = m;
    }
    // The radius of the support's sphere grows with every pivot and is a lower bound, so this ends.
    const bool done = most <= result.sphere.radius * (1 + kTolerance);
    if (!done) {
      std::vector<Sphere> candidates{balls[farthest]};
      for (const std::uint32_t s : result.support) candidates.push_back(balls[s]);
      const Small next = around(candidates);
      if (next.subset != 0 && next.sphere.radius > result.sphere.radius) {
        std::vector<std::uint32_t> support;
        for (std::size_t i = 0; i < candidates.size(); ++i) {
          if (next.subset >> i & 1U) support.push_back(i == 0 ? farthest : result.support[i - 1]);
        }
        result = {next.sphere, std::move(support)};
        continue;
      }
    }
    result.sphere.radius = std::max(result.sphere.radius, most);
    return result;
  }
}

}  // namespace spherule
