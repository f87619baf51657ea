// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/distance.h"

#include <algorithm>
#include <cmath>
#include <limits>

#include "core/base/parallel.h"
#include "core/base/poll.h"

namespace spherule::detail {

namespace {

constexpr double kInfinite = std::numeric_limits<double>::infinity();

// Replaces f by the lower envelope of the parabolas f[i] + (step · (q - i))² at q = 0, 1 ….
class Envelope {
 public:
  explicit Envelope(std::size_t n) : f(n), at_(n), from_(n + 1) {}

  std::vector<double> f;

  void transform(double step) {
    const double square = step * step;
    std::size_t count = 0;
    for (std::size_t i = 0; i < f.size(); ++i) {
      if (f[i] == kInfinite) continue;
      const auto x = static_cast<double>(i);
      double start = -kInfinite;
      while (count > 0) {
        const auto last = static_cast<double>(at_[count - 1]);
        start = ((f[i] + square * x * x) - (f[at_[count - 1]] + square * last * last)) / (2 * square * (x - last));
        if (start > from_[count - 1]) break;
        --count;
      }
      at_[count] = i;
      from_[count] = count == 0 ? -kInfinite : start;
      ++count;
    }
    if (count == 0) return;
    result_.resize(f.size());
    from_[count] = kInfinite;
    std::size_t k = 0;
    for (std::size_t q = 0; q < f.size(); ++q) {
      while (from_[k + 1] < static_cast<double>(q)) ++k;
      const double d = step * (static_cast<double>(q) - static_cast<double>(at_[k]));
      result_[q] = f[at_[k]] + d * d;
    }
    f.swap(result_);
  }

 private:
  std::vector<std::size_t> at_;
  std::vector<double> from_, result_;
};

}  // namespace

std::vector<float> squared_distances(const SampleBits& set, Vec3 spacing, const Context& context) {
  const auto nx = static_cast<std::size_t>(set.dims()[0]), ny = static_cast<std::size_t>(set.dims()[1]),
             nz = static_cast<std::size_t>(set.dims()[2]);
  std::vector<float> squared(nx * ny * nz);
  parallel_for(context, {}, nz, 1, [&](std::size_t k, std::size_t) {
    Envelope row(nx), column(ny);
    Poll poll(context);
    for (std::size_t j = 0; j < ny; ++j) {
      poll(4 * nx);
      const auto bits = set.row(static_cast<std::int32_t>(j), static_cast<std::int32_t>(k));
      for (std::size_t i = 0; i < nx; ++i) row.f[i] = bits[i / 64] >> (i % 64) & 1 ? 0 : kInfinite;
      row.transform(spacing.x);
      for (std::size_t i = 0; i < nx; ++i) squared[(k * ny + j) * nx + i] = static_cast<float>(row.f[i]);
    }
    for (std::size_t i = 0; i < nx; ++i) {
      poll(4 * ny);
      for (std::size_t j = 0; j < ny; ++j) column.f[j] = squared[(k * ny + j) * nx + i];
      column.transform(spacing.y);
      for (std::size_t j = 0; j < ny; ++j) squared[(k * ny + j) * nx + i] = static_cast<float>(column.f[j]);
    }
  });
  parallel_for(context, {}, ny, 1, [&](std::size_t j, std::size_t) {
    Envelope column(nz);
    Poll poll(context);
    for (std::size_t i = 0; i < nx; ++i) {
      poll(4 * nz);
      for (std::size_t k = 0; k < nz; ++k) column.f[k] = squared[(k * ny + j) * nx + i];
      column.transform(spacing.z);
      for (std::size_t k = 0; k < nz; ++k) squared[(k * ny + j) * nx + i] = static_cast<float>(column.f[k]);
    }
  });
  return squared;
}

}  // namespace spherule::detail
