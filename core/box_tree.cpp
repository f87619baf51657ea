// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/box_tree.h"

#include <algorithm>
#include <utility>

namespace spherule {

namespace {

// Every third bit of the result is a bit of the 21-bit number.
std::uint64_t spread(std::uint64_t v) {
  v = (v | v << 32) & 0x1f00000000ffffULL;
  v = (v | v << 16) & 0x1f0000ff0000ffULL;
  v = (v | v << 8) & 0x100f00f00f00f00fULL;
  v = (v | v << 4) & 0x10c30c30c30c30c3ULL;
  return (v | v << 2) & 0x1249249249249249ULL;
}

}  // namespace

BoxTree::BoxTree(std::span<const Box> boxes) {
  if (boxes.empty()) return;
  Box all;
  for (const Box& b : boxes) {
    all.include(b.min);
    all.include(b.max);
  }
  const Vec3 size = all.max - all.min;
  const double extent = std::max({size.x, size.y, size.z});
  const double scale = extent > 0 ? 0x1p20 / extent : 0;
  std::vector<std::pair<std::uint64_t, std::uint32_t>> keys(boxes.size());
  for (std::uint32_t i = 0; i < keys.size(); ++i) {
    const Vec3 middle = scale * (0.5 * (boxes[i].min + boxes[i].max) - all.min);
    keys[i] = {spread(static_cast<std::uint64_t>(middle.x)) | spread(static_cast<std::uint64_t>(middle.y)) << 1 |
                   spread(static_cast<std::uint64_t>(middle.z)) << 2,
               i};
  }
  std::sort(keys.begin(), keys.end());

  order_.reserve(keys.size());
  std::vector<Box> level;
  level.reserve(keys.size());
  for (const auto& [key, i] : keys) {
    order_.push_back(i);
    level.push_back(boxes[i]);
  }
  levels_.push_back(std::move(level));
  while (levels_.back().size() > kFan) {
    const std::vector<Box>& below = levels_.back();
    std::vector<Box> above((below.size() + kFan - 1) / kFan);
    for (std::size_t n = 0; n < below.size(); ++n) {
      above[n / kFan].include(below[n].min);
      above[n / kFan].include(below[n].max);
    }
    levels_.push_back(std::move(above));
  }
}

}  // namespace spherule
