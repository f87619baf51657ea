// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/fit.h"

#include <Eigen/Dense>
#include <algorithm>
#include <bit>
#include <cstring>
#include <numbers>

namespace spherule::detail {

namespace {

// Directions spread evenly over the sphere along a spiral (Á. González, Measurement of areas on a sphere using
// Fibonacci and latitude-longitude lattices, 2010).
Vec3 direction(int i, int count) {
  const double z = 1 - (2 * i + 1.0) / count, around = i * std::numbers::pi * (3 - std::sqrt(5.0));
  const double s = std::sqrt(1 - z * z);
  return {s * std::cos(around), s * std::sin(around), z};
}

// The sum of bytes of 0, 1 or 2, eight at a time. Reads up to seven bytes beyond.
std::uint64_t sum_of_bytes(const std::uint8_t* bytes, std::size_t count) {
  const auto word_at = [&](std::size_t i) {
    std::uint64_t word;
    std::memcpy(&word, bytes + i, sizeof word);
    return word;
  };
  const auto sum_of_lanes = [](std::uint64_t lanes) {
    const std::uint64_t pairs = (lanes & 0x00ff00ff00ff00ffU) + (lanes >> 8 & 0x00ff00ff00ff00ffU);
    return pairs * 0x0001000100010001U >> 48;
  };
  constexpr std::size_t most = 127 * 8;  // before a lane of the sum could overflow
  std::uint64_t sum = 0;
  for (std::size_t begin = 0; begin < count; begin += most) {
    const std::size_t end = std::min(count, begin + most);
    std::uint64_t lanes = 0;
    std::size_t i = begin;
    for (; i + 8 <= end; i += 8) lanes += word_at(i);
    sum += sum_of_lanes(lanes);
    if (i < end) sum += sum_of_lanes(word_at(i) & ~(~std::uint64_t{0} << 8 * (end - i)));
  }
  return sum;
}

// The smallest window with all inside samples; of no size for none.
Window window_of(const SampleBits& inside) {
  const auto [nx, ny, nz] = inside.dims();
  Window window{{nx, ny, nz}, {nx, ny, nz}};
  bool first = true;
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      const auto row = inside.row(j, k);
      for (std::size_t w = 0; w < row.size(); ++w) {
        if (row[w] == 0) continue;
        const auto low = static_cast<std::int32_t>(64 * w) + std::countr_zero(row[w]);
        const auto high = static_cast<std::int32_t>(64 * w) + 64 - std::countl_zero(row[w]);
        if (first) window = {{low, j, k}, {high, j + 1, k + 1}};
        first = false;
        window.begin = {std::min(window.begin[0], low), std::min(window.begin[1], j), std::min(window.begin[2], k)};
        window.end = {std::max(window.end[0], high), std::max(window.end[1], j + 1), std::max(window.end[2], k + 1)};
      }
    }
  }
  return window;
}

}  // namespace

Fit::Fit(const SampledObject& object)
    : spacing_(object.grid.spacing),
      voxel_(std::cbrt(object.sample_mm3())),
      window_(window_of(object.inside)),
      border_open_(object.border == Border::open) {
  const auto& dims = object.grid.dims;
  Window within = window_;
  for (std::size_t a = 0; a < 3; ++a) {
    window_.begin[a] -= kMargin;
    window_.end[a] += kMargin;
    if (border_open_) {
      window_.begin[a] = std::max(window_.begin[a], 0);
      window_.end[a] = std::min(window_.end[a], dims[a]);
    }
  }
  const std::size_t count = static_cast<std::size_t>(window_.size(0)) * static_cast<std::size_t>(window_.size(1)) *
                            static_cast<std::size_t>(window_.size(2));
  count_.assign(count, 0);
  value_.assign(count, 1 + kOutside);
  for (std::int32_t k = within.begin[2]; k < within.end[2]; ++k) {
    for (std::int32_t j = within.begin[1]; j < within.end[1]; ++j) {
      for (std::int32_t i = within.begin[0]; i < within.end[0]; ++i) {
        if (object.inside.test(i, j, k)) value_[at(i, j, k)] = 1 + kInside;
      }
    }
  }
  open_ = value_;
  open_.resize(count + sizeof(std::uint64_t), 1);
}

void Fit::change(const Sphere& ball, int by) {
  visit_rows(spacing_, ball, window_, [&](std::int32_t j, std::int32_t k, Run run) {
    const std::size_t row = at(run.begin, j, k), end = row + static_cast<std::size_t>(run.end - run.begin);
    for (std::size_t s = row; s < end; ++s) {
      count_[s] = static_cast<std::uint16_t>(count_[s] + by);
      open_[s] = count_[s] == 0 ? value_[s] : std::uint8_t{1};
    }
  });
}

std::int64_t Fit::gain(const Sphere& ball) const {
  std::int64_t sum = 0, samples = 0;
  visit_rows(spacing_, ball, window_, [&](std::int32_t j, std::int32_t k, Run run) {
    const auto length = static_cast<std::size_t>(run.end - run.begin);
    sum += static_cast<std::int64_t>(sum_of_bytes(open_.data() + at(run.begin, j, k), length)) -
           static_cast<std::int64_t>(length);
    samples += run.end - run.begin;
  });
  bool within = true;
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    within &= ball.centre[a] - ball.radius > spacing_[a] * (window_.begin[axis] - 1) &&
              ball.centre[a] + ball.radius < spacing_[a] * window_.end[axis];
  }
  if (border_open_ || within) return sum;
  // Beyond the window all is outside; how many samples the ball has there, its volume tells well enough.
  const double all = 4 * std::numbers::pi / 3 * std::pow(ball.radius / voxel_, 3);
  return sum - std::max<std::int64_t>(static_cast<std::int64_t>(all) - samples, 0);
}

// The value of the nearest sample while no ball holds it, else 0.
int Fit::open_near(Vec3 p) const {
  std::array<std::int32_t, 3> s{};
  for (int a = 0; a < 3; ++a) {
    const auto axis = static_cast<std::size_t>(a);
    const double index = std::floor(p[a] / spacing_[a] + 0.5);
    if (!(index >= window_.begin[axis] && index < window_.end[axis])) return border_open_ ? 0 : kOutside;
    s[axis] = static_cast<std::int32_t>(index);
  }
  return open_[at(s[0], s[1], s[2])] - 1;
}

Sphere Fit::fitted(const Sphere& ball) const {
  const double step = 0.5 * std::min({spacing_.x, spacing_.y, spacing_.z});
  const double farthest = std::max(4 * voxel_, 0.5 * ball.radius);
  const int count = static_cast<int>(std::clamp(3 * std::pow(ball.radius / voxel_, 2), 60.0, 400.0));
  // Weighted least squares for (dr, dx): the sphere's point in direction u should move by dr + u·dx, to where the
  // object ends. A weight of one over the distance makes the sum of squares the volume between.
  Eigen::Matrix4d normal = Eigen::Matrix4d::Zero();
  Eigen::Vector4d right = Eigen::Vector4d::Zero();
  for (int d = 0; d < count; ++d) {
    const Vec3 u = direction(d, count);
    const int value = open_near(ball.centre + ball.radius * u);
    if (value == 0) continue;
    // Out through what is still to be covered, or in through what should not have been.
    const double most = value == kInside ? farthest : std::min(farthest, ball.radius);
    double beyond = 0;
    while (beyond < most && open_near(ball.centre + (ball.radius + value * beyond) * u) == value) beyond += step;
    const double distance = value * (beyond - 0.5 * step), weight = 1 / (voxel_ + std::abs(distance));
    const Eigen::Vector4d row(1, u.x, u.y, u.z);
    normal += weight * row * row.transpose();
    right += weight * distance * row;
  }
  // What is hardly exposed should hardly move, along directions that nothing holds least of all.
  normal.diagonal().array() += 0.01 * count / voxel_;
  const Eigen::Vector4d x = normal.ldlt().solve(right);
  return {ball.centre + Vec3{x(1), x(2), x(3)}, std::max(ball.radius + x(0), step)};
}

}  // namespace spherule::detail
