// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/frame.h"

#include <algorithm>
#include <bit>
#include <cmath>

#include "core/base/elementary.h"
#include "core/base/poll.h"

namespace spherule::detail {

namespace {

constexpr std::int32_t kMargin = 12;

}  // namespace

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

Frame::Frame(const SampledObject& object, const Context& context)
    : spacing(object.grid.spacing),
      voxel(elementary::cbrt(object.sample_mm3())),
      window(window_of(object.inside)),
      border_open(object.border == Border::open) {
  const Window own = window;
  for (std::size_t a = 0; a < 3; ++a) {
    window.begin[a] -= kMargin;
    window.end[a] += kMargin;
    if (border_open) {
      window.begin[a] = std::max(window.begin[a], 0);
      window.end[a] = std::min(window.end[a], object.grid.dims[a]);
    }
  }
  value.assign(static_cast<std::size_t>(window.size(0)) * static_cast<std::size_t>(window.size(1)) *
                   static_cast<std::size_t>(window.size(2)),
               -1);
  Poll poll(context);
  for (std::int32_t k = own.begin[2]; k < own.end[2]; ++k) {
    for (std::int32_t j = own.begin[1]; j < own.end[1]; ++j) {
      poll(static_cast<std::uint64_t>(own.size(0)));
      for (std::int32_t i = own.begin[0]; i < own.end[0]; ++i) {
        if (object.inside.test(i, j, k)) value[at(i, j, k)] = 1;
      }
    }
  }
}

}  // namespace spherule::detail
