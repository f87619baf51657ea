// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/trees/point_tree.h"

#include <algorithm>
#include <numeric>

namespace spherule::detail {

PointTree::PointTree(std::span<const Vec3> points)
    : points_(points.begin(), points.end()), order_(points.size()), axis_(points.size()) {
  std::iota(order_.begin(), order_.end(), 0U);
  build(0, points.size());
  for (std::size_t i = 0; i < order_.size(); ++i) points_[i] = points[order_[i]];
}

// While it is being built, points_ is as given and order_ leads to it.
void PointTree::build(std::size_t begin, std::size_t end) {
  if (end - begin <= kLeaf) return;
  Box box;
  for (std::size_t i = begin; i < end; ++i) box.include(points_[order_[i]]);
  const Vec3 size = box.max - box.min;
  const int axis = size.x >= size.y && size.x >= size.z ? 0 : size.y >= size.z ? 1 : 2;
  const std::size_t middle = (begin + end) / 2;
  const auto at = [&](std::size_t i) { return order_.begin() + static_cast<std::ptrdiff_t>(i); };
  std::nth_element(at(begin), at(middle), at(end), [&](std::uint32_t a, std::uint32_t b) {
    return points_[a][axis] != points_[b][axis] ? points_[a][axis] < points_[b][axis] : a < b;
  });
  axis_[middle] = static_cast<std::uint8_t>(axis);
  build(begin, middle);
  build(middle + 1, end);
}

PointTree::Near PointTree::nearest(Vec3 p, double within_squared) const {
  Near best{none, within_squared};
  search(0, points_.size(), p, best);
  if (best.index == none) return {};
  best.index = order_[best.index];
  return best;
}

void PointTree::search(std::size_t begin, std::size_t end, Vec3 p, Near& best) const {
  const auto look = [&](std::size_t i) {
    const double squared = squared_norm(points_[i] - p);
    if (squared < best.squared) best = {static_cast<std::uint32_t>(i), squared};
  };
  if (end - begin <= kLeaf) {
    for (std::size_t i = begin; i < end; ++i) look(i);
    return;
  }
  const std::size_t middle = (begin + end) / 2;
  const double beyond = p[axis_[middle]] - points_[middle][axis_[middle]];
  if (beyond < 0) {
    search(begin, middle, p, best);
  } else {
    search(middle + 1, end, p, best);
  }
  if (beyond * beyond >= best.squared) return;
  look(middle);
  if (beyond < 0) {
    search(middle + 1, end, p, best);
  } else {
    search(begin, middle, p, best);
  }
}

}  // namespace spherule::detail
