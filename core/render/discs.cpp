// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/discs.h"

#include <algorithm>
#include <cmath>
#include <numeric>

namespace spherule {
namespace {

constexpr std::size_t kFew = 6;
constexpr int kMostLevels = 13;

}  // namespace

Discs::Discs(std::vector<Disc> discs, const Context& context) : discs_(std::move(discs)), cells_(1) {
  if (discs_.empty()) return;
  Box box;
  for (const Disc& d : discs_) box.include(Sphere{{d.x, d.y, 0}, d.radius});
  x_ = 0.5 * (box.min.x + box.max.x), y_ = 0.5 * (box.min.y + box.max.y);
  half_ = 0.5 * std::max(box.max.x - box.min.x, box.max.y - box.min.y);
  std::vector<std::uint32_t> all(discs_.size());
  std::iota(all.begin(), all.end(), 0U);
  divide(0, x_, y_, half_, 0, std::move(all), context);
}

void Discs::divide(std::size_t cell, double x, double y, double half, int level, std::vector<std::uint32_t> candidates,
                   const Context& context) {
  context.throw_if_cancelled();
  std::size_t kept = 0;
  for (const std::uint32_t i : candidates) {
    const Disc& d = discs_[i];
    const double across = std::abs(d.x - x), along = std::abs(d.y - y);
    const double near_x = std::max(0.0, across - half), near_y = std::max(0.0, along - half);
    if (near_x * near_x + near_y * near_y > d.radius * d.radius) continue;
    if ((across + half) * (across + half) + (along + half) * (along + half) < d.radius * d.radius) {
      cells_[cell].kind = Cell::covered;
      return;
    }
    candidates[kept++] = i;
  }
  candidates.resize(kept);
  if (kept <= kFew || level == kMostLevels) {
    cells_[cell].first = static_cast<std::uint32_t>(members_.size());
    cells_[cell].count = static_cast<std::uint32_t>(kept);
    members_.insert(members_.end(), candidates.begin(), candidates.end());
    return;
  }
  const std::size_t first = cells_.size();
  cells_[cell].kind = Cell::split;
  cells_[cell].first = static_cast<std::uint32_t>(first);
  cells_.resize(first + 4);
  half /= 2;
  for (std::size_t c = 0; c < 4; ++c)
    divide(first + c, x + (c & 1 ? half : -half), y + (c & 2 ? half : -half), half, level + 1, candidates, context);
}

bool Discs::hold(double x, double y) const {
  if (discs_.empty() || std::abs(x - x_) > half_ || std::abs(y - y_) > half_) return false;
  double cx = x_, cy = y_, half = half_;
  const Cell* cell = cells_.data();
  while (cell->kind == Cell::split) {
    half /= 2;
    const std::size_t c = (x > cx ? 1U : 0U) + (y > cy ? 2U : 0U);
    cx += x > cx ? half : -half;
    cy += y > cy ? half : -half;
    cell = &cells_[cell->first + c];
  }
  if (cell->kind == Cell::covered) return true;
  return std::ranges::any_of(members_.begin() + cell->first, members_.begin() + cell->first + cell->count,
                             [&](std::uint32_t i) {
                               const double dx = discs_[i].x - x, dy = discs_[i].y - y;
                               return dx * dx + dy * dy <= discs_[i].radius * discs_[i].radius;
                             });
}

}  // namespace spherule
