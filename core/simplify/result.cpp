// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/result.h"

#include <algorithm>
#include <cmath>

#include "core/base/check.h"

namespace spherule {

namespace {

// The ancestor of sphere i (itself included) that level k shows, or no_parent. A parent is shown up to the level before
// its children at least, so the first one that had begun by level k is still there.
std::uint32_t ancestor_at(const Simplification& s, std::uint32_t i, std::uint32_t k) {
  while (i != no_parent && s.spheres[i].from > k) i = s.spheres[i].parent;
  return i;
}

// Position of every sphere among those shown at level k; no_parent for the others.
std::vector<std::uint32_t> positions(std::size_t count, std::span<const std::uint32_t> shown) {
  std::vector<std::uint32_t> position(count, no_parent);
  for (std::uint32_t p = 0; p < shown.size(); ++p) position[shown[p]] = p;
  return position;
}

}  // namespace

bool is_valid(const Simplification& s, std::size_t model_count) {
  if (s.member_begin.size() != s.spheres.size() + 1 || s.member_begin.front() != 0 ||
      s.member_begin.back() != s.members.size() || !std::ranges::is_sorted(s.member_begin)) {
    return false;
  }
  const std::uint32_t last = s.last_level();
  if (last > s.spheres.size()) return false;
  std::vector<std::int64_t> change(static_cast<std::size_t>(last) + 2, 0);
  std::vector<std::uint8_t> taken(model_count, 0);
  for (std::uint32_t i = 0; i < s.spheres.size(); ++i) {
    const LevelSphere& l = s.spheres[i];
    const bool finite = std::isfinite(squared_norm(l.sphere.centre)) && std::isfinite(l.sphere.radius);
    if (!finite || l.sphere.radius < 0 || l.from < 1 || l.to < l.from || l.to > last) return false;
    if (i > 0 && s.spheres[i - 1].from > l.from) return false;
    if (l.parent != no_parent) {
      if (l.parent >= i) return false;
      const LevelSphere& parent = s.spheres[l.parent];
      if (parent.from >= l.from || l.from > parent.to + 1) return false;
    }
    ++change[l.from];
    --change[l.to + 1];
    if (l.to != last && !s.members_of(i).empty()) return false;
    std::int64_t before = -1;
    for (const std::uint32_t m : s.members_of(i)) {
      if (m >= model_count || taken[m] || m <= before) return false;
      taken[m] = 1;
      before = m;
    }
  }
  std::int64_t shown = 0;
  for (std::uint32_t k = 1; k <= last; ++k) {
    shown += change[k];
    if (shown < 1 || shown > k) return false;
  }
  return shown == last;
}

std::vector<std::uint32_t> shown_at(const Simplification& s, std::uint32_t k) {
  SPHERULE_CHECK(k >= 1);
  const std::uint32_t level = std::min(k, s.last_level());
  std::vector<std::uint32_t> shown;
  for (std::uint32_t i = 0; i < s.spheres.size() && s.spheres[i].from <= level; ++i) {
    if (level <= s.spheres[i].to) shown.push_back(i);
  }
  return shown;
}

std::vector<Sphere> spheres_at(const Simplification& s, std::uint32_t k) {
  std::vector<Sphere> spheres;
  for (const std::uint32_t i : shown_at(s, k)) spheres.push_back(s.spheres[i].sphere);
  return spheres;
}

MemberLists members_at(const Simplification& s, std::uint32_t k) {
  const std::uint32_t level = std::min(k, s.last_level());
  const auto shown = shown_at(s, k);
  const auto position = positions(s.spheres.size(), shown);
  std::vector<std::uint32_t> list_of(s.spheres.size(), no_parent);
  MemberLists lists;
  lists.begin.assign(shown.size() + 1, 0);
  for (std::uint32_t i = 0; i < s.spheres.size(); ++i) {
    const std::uint32_t ancestor = s.members_of(i).empty() ? no_parent : ancestor_at(s, i, level);
    if (ancestor == no_parent) continue;
    list_of[i] = position[ancestor];
    lists.begin[list_of[i] + 1] += static_cast<std::uint32_t>(s.members_of(i).size());
  }
  for (std::size_t p = 0; p < shown.size(); ++p) lists.begin[p + 1] += lists.begin[p];
  lists.items.resize(lists.begin.back());
  auto end = lists.begin;
  for (std::uint32_t i = 0; i < s.spheres.size(); ++i) {
    if (list_of[i] == no_parent) continue;
    for (const std::uint32_t m : s.members_of(i)) lists.items[end[list_of[i]]++] = m;
  }
  for (std::size_t p = 0; p < shown.size(); ++p) {
    std::sort(lists.items.begin() + lists.begin[p], lists.items.begin() + lists.begin[p + 1]);
  }
  return lists;
}

std::vector<TreeLevel> tree_of(const Simplification& s, std::span<const std::uint32_t> levels) {
  std::vector<TreeLevel> tree;
  std::vector<std::uint32_t> position_before;
  for (std::size_t l = 0; l < levels.size(); ++l) {
    SPHERULE_CHECK(l == 0 || levels[l - 1] < levels[l]);
    const auto shown = shown_at(s, levels[l]);
    TreeLevel level;
    for (const std::uint32_t i : shown) {
      level.spheres.push_back(s.spheres[i].sphere);
      const std::uint32_t ancestor = l == 0 ? no_parent : ancestor_at(s, i, levels[l - 1]);
      level.parents.push_back(ancestor == no_parent ? no_parent : position_before[ancestor]);
    }
    position_before = positions(s.spheres.size(), shown);
    tree.push_back(std::move(level));
  }
  return tree;
}

}  // namespace spherule
