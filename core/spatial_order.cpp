// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/spatial_order.h"

#include <algorithm>
#include <bit>
#include <utility>

#include "core/base/poll.h"

namespace spherule {

std::uint64_t along_hilbert_curve(std::array<std::uint32_t, 3> cell) {
  constexpr std::uint32_t kBits = 20;
  auto& [x, y, z] = cell;
  // Undoes the curve's turns from the coarsest cells to the finest …
  for (std::uint32_t bit = 1U << (kBits - 1); bit > 1; bit >>= 1) {
    const std::uint32_t below = bit - 1;
    for (std::uint32_t* axis : {&x, &y, &z}) {
      if (*axis & bit) {
        x ^= below;
      } else {
        const std::uint32_t swapped = (x ^ *axis) & below;
        x ^= swapped;
        *axis ^= swapped;
      }
    }
  }
  // … and its Gray code.
  y ^= x;
  z ^= y;
  std::uint32_t turned = 0;
  for (std::uint32_t bit = 1U << (kBits - 1); bit > 1; bit >>= 1) {
    if (z & bit) turned ^= bit - 1;
  }
  std::uint64_t place = 0;
  for (std::uint32_t b = kBits; b-- > 0;) {
    for (const std::uint32_t axis : {x, y, z}) place = place << 1 | ((axis ^ turned) >> b & 1);
  }
  return place;
}

std::uint64_t insertion_round(std::uint32_t point) {
  // The golden ratio's multiples are as good as random here; the upper half has mixed bits.
  std::uint64_t mixed = (point + std::uint64_t{1}) * 0x9e3779b97f4a7c15ULL;
  mixed = (mixed ^ mixed >> 32) * 0xd6e8feb86659fd93ULL;
  const int zeros = std::countl_zero(mixed | 1);
  return static_cast<std::uint64_t>(15 - std::min(zeros / 3, 15));
}

std::vector<std::uint32_t> insertion_order(std::span<const Vec3> points, const Context& context) {
  Poll poll(context);
  Box box;
  for (const Vec3 p : points) poll(), box.include(p);
  double edge = 0;
  for (int a = 0; a < 3; ++a) edge = std::max(edge, box.max[a] - box.min[a]);
  const double scale = edge > 0 ? 0xfffff / edge : 0;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(points.size());
  for (std::uint32_t i = 0; i < keys.size(); ++i) {
    poll(32);
    const Vec3 p = scale * (points[i] - box.min);
    const std::array cell{static_cast<std::uint32_t>(p.x), static_cast<std::uint32_t>(p.y),
                          static_cast<std::uint32_t>(p.z)};
    keys[i] = {insertion_round(i) << 60 | along_hilbert_curve(cell), i};
  }
  std::sort(keys.begin(), keys.end(), Polled(poll, [](const auto& a, const auto& b) { return a < b; }));
  std::vector<std::uint32_t> order;
  order.reserve(keys.size());
  for (const auto& [key, i] : keys) order.push_back(i);
  return order;
}

}  // namespace spherule
