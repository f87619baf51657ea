// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <numbers>

namespace spherule::detail {

namespace {

// Directions spread evenly over the sphere, along a spiral (González, Measurement of areas on a sphere using Fibonacci
// and latitude-longitude lattices, 2010).
Vec3 direction(int i, int count) {
  const double z = 1 - (2 * i + 1.0) / count, around = i * std::numbers::pi * (3 - std::sqrt(5.0));
  const double s = std::sqrt(1 - z * z);
  return {s * std::cos(around), s * std::sin(around), z};
}

}  // namespace

Fit::Fit(const SampledObject& object, std::int32_t margin)
    : spacing_(object.grid.spacing), open_(object.border == Border::open), grid_{{0, 0, 0}, object.grid.dims} {
  const auto [nx, ny, nz] = object.grid.dims;
  window_ = {{nx, ny, nz}, {0, 0, 0}};
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      const auto row = object.inside.row(j, k);
      for (std::size_t w = 0; w < row.size(); ++w) {
        if (row[w] == 0) continue;
        const auto first = static_cast<std::int32_t>(64 * w) + std::countr_zero(row[w]);
        const auto last = static_cast<std::int32_t>(64 * w) + 63 - std::countl_zero(row[w]);
        window_.begin = {std::min(window_.begin[0], first), std::min(window_.begin[1], j),
                         std::min(window_.begin[2], k)};
        window_.end = {std::max(window_.end[0], last + 1), std::max(window_.end[1], j + 1),
                       std::max(window_.end[2], k + 1)};
      }
    }
  }
  for (std::size_t a = 0; a < 3; ++a) {
    window_.begin[a] -= margin;
    window_.end[a] += margin;
    if (open_)
      window_.begin[a] = std::max(window_.begin[a], 0), window_.end[a] = std::min(window_.end[a], object.grid.dims[a]);
  }
  const std::size_t count = static_cast<std::size_t>(window_.size(0)) * static_cast<std::size_t>(window_.size(1)) *
                            static_cast<std::size_t>(window_.size(2));
  value_.assign(count, outside);
  count_.assign(count, 0);
  for (std::int32_t k = std::max(window_.begin[2], 0); k < std::min(window_.end[2], nz); ++k) {
    for (std::int32_t j = std::max(window_.begin[1], 0); j < std::min(window_.end[1], ny); ++j) {
      const auto row = object.inside.row(j, k);
      std::int8_t* values = value_.data() + offset(j, k) - window_.begin[0];
      for (std::int32_t i = std::max(window_.begin[0], 0); i < std::min(window_.end[0], nx); ++i) {
        if (row[static_cast<std::size_t>(i) / 64] >> (i % 64) & 1) values[i] = inside;
      }
    }
  }
}

void Fit::change(const Sphere& ball, int by) {
  visit_rows(spacing_, ball, window_, [&](std::int32_t j, std::int32_t k, Run run) {
    std::uint16_t* counts = count_.data() + offset(j, k) - window_.begin[0];
    for (std::int32_t i = run.begin; i < run.end; ++i) counts[i] = static_cast<std::uint16_t>(counts[i] + by);
  });
}

static int W = getenv("W") ? atoi(getenv("W")) : 0;
std::int64_t Fit::gain(const Sphere& ball) const {
  std::int64_t samples = 0;
  double sum = 0;
  visit_rows(spacing_, ball, window_, [&](std::int32_t j, std::int32_t k, Run run) {
    const std::size_t row = offset(j, k);
    const std::int8_t* values = value_.data() + row - window_.begin[0];
    const std::uint16_t* counts = count_.data() + row - window_.begin[0];
    std::int32_t in_row = 0;
    for (std::int32_t i = run.begin; i < run.end; ++i)
      in_row += counts[i] == 0 ? 16 * values[i] : values[i] < 0 ? -W : 0;
    sum += in_row / 16.0;
    samples += run.end - run.begin;
  });
  if (open_) return (std::int64_t)sum;
  // Samples of the ball beyond the window, by its volume: only how bad is in question.
  bool within = true;
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    within &= ball.centre[a] - ball.radius >= spacing_[a] * (window_.begin[axis] - 1) &&
              ball.centre[a] + ball.radius <= spacing_[a] * window_.end[axis];
  }
  if (within) return (std::int64_t)sum;
  const double volume = 4 * std::numbers::pi / 3 * ball.radius * ball.radius * ball.radius;
  return (std::int64_t)sum -
         std::max<std::int64_t>(static_cast<std::int64_t>(volume / (spacing_.x * spacing_.y * spacing_.z)) - samples,
                                0);
}

int Fit::value_near(Vec3 p, const Sphere* own, bool all_out) const {
  const auto i = static_cast<std::int32_t>(std::floor(p.x / spacing_.x + 0.5));
  const auto j = static_cast<std::int32_t>(std::floor(p.y / spacing_.y + 0.5));
  const auto k = static_cast<std::int32_t>(std::floor(p.z / spacing_.z + 0.5));
  if (i < window_.begin[0] || j < window_.begin[1] || k < window_.begin[2] || i >= window_.end[0] ||
      j >= window_.end[1] || k >= window_.end[2]) {
    return open_ ? 0 : -1;
  }
  const std::size_t at = offset(j, k) + static_cast<std::size_t>(i - window_.begin[0]);
  if (all_out && value_[at] < 0) return -1;
  int n = count_[at];
  if (own)
    n -= squared_norm(Vec3{i * spacing_.x, j * spacing_.y, k * spacing_.z} - own->centre) <= own->radius * own->radius;
  return n == 0 ? value_[at] : 0;
}

Sphere Fit::fitted(const Sphere& ball, bool laid, double ridge) const {
  const double voxel = std::cbrt(spacing_.x * spacing_.y * spacing_.z), step = 0.5 * smallest_spacing();
  const double farthest = std::max(4 * voxel, 0.5 * ball.radius);
  const int count = static_cast<int>(std::clamp(3 * std::pow(ball.radius / voxel, 2), 60.0, 400.0));
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  double total = 0;
  for (int d = 0; d < count; ++d) {
    const Vec3 u = direction(d, count);
    const int value = value_near(ball.centre + ball.radius * u, laid ? &ball : nullptr, false);
    if (value == 0) continue;
    double beyond = 0;
    const double most = value == inside ? farthest : std::min(farthest, ball.radius);
    while (beyond < most &&
           value_near(ball.centre + (ball.radius + value * beyond) * u, laid ? &ball : nullptr, laid) == value)
      beyond += step;
    const double error = value * (beyond - 0.5 * step);
    const double weight = 1 / (voxel + std::abs(error));
    const Eigen::Vector4d row(1, u.x, u.y, u.z);
    normal += weight * row * row.transpose();
    right += weight * error * row;
    total += weight;
  }
  if (total == 0) return ball;
  normal.diagonal().array() += ridge * count / voxel;
  const Eigen::Vector4d x = normal.ldlt().solve(right);
  return {ball.centre + Vec3{x(1), x(2), x(3)}, std::max(ball.radius + x(0), step)};
}

}  // namespace spherule::detail
