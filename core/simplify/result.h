// SPDX-License-Identifier: GPL-3.0-or-later
//
// What every method of simplification returns: the few spheres, how each came from coarser ones, and which spheres of
// the model each stands for. One value holds every level of detail that the method went through.
#pragma once

#include <cstdint>
#include <limits>
#include <span>
#include <vector>

#include "core/base/geometry.h"

namespace spherule {

inline constexpr std::uint32_t no_parent = std::numeric_limits<std::uint32_t>::max();

/// A sphere and the levels that show it. Level k is the finest set of at most k spheres.
struct LevelSphere {
  Sphere sphere;                     ///< LPS mm
  std::uint32_t parent = no_parent;  ///< the sphere that it refines: an earlier one, or none
  std::uint32_t from = 1, to = 1;    ///< shown at levels from … to
  friend bool operator==(const LevelSphere&, const LevelSphere&) = default;
};

/// A multi-resolution order of spheres. Invariants (is_valid): `from` ascends; a parent comes before its children and
/// is shown up to the level before them at least (parent.from < from <= parent.to + 1); level k shows at most k
/// spheres, and the last level as many as it can; every sphere of the model is the member of at most one sphere of the
/// last level, and of no other. 40 bytes a sphere and 4 a member.
struct Simplification {
  std::vector<LevelSphere> spheres;
  /// Members of sphere i: members[member_begin[i]] up to members[member_begin[i + 1]], ascending indices into the
  /// model's spheres. Only spheres of the last level have any; those of a coarser one stand for their descendants'.
  std::vector<std::uint32_t> member_begin{0};
  std::vector<std::uint32_t> members;

  std::uint32_t last_level() const { return spheres.empty() ? 0 : spheres.back().to; }
  std::span<const std::uint32_t> members_of(std::uint32_t i) const {
    return std::span(members).subspan(member_begin[i], member_begin[i + 1] - member_begin[i]);
  }
  friend bool operator==(const Simplification&, const Simplification&) = default;
};

/// Whether the invariants hold for a model of `model_count` spheres. O(spheres + members).
bool is_valid(const Simplification& simplification, std::size_t model_count);

/// Indices of the spheres that level k shows, ascending. Any k >= 1: past the last level means the last. O(spheres).
std::vector<std::uint32_t> shown_at(const Simplification& simplification, std::uint32_t k);

/// The spheres of level k, in the order of shown_at.
std::vector<Sphere> spheres_at(const Simplification& simplification, std::uint32_t k);

/// Lists of members one after another: list i is items[begin[i]] up to items[begin[i + 1]], ascending.
struct MemberLists {
  std::vector<std::uint32_t> begin{0};
  std::vector<std::uint32_t> items;

  std::size_t count() const { return begin.size() - 1; }
  std::span<const std::uint32_t> of(std::size_t i) const {
    return std::span(items).subspan(begin[i], begin[i + 1] - begin[i]);
  }
};

/// The members of every sphere of level k, in the order of shown_at. O(spheres + members).
MemberLists members_at(const Simplification& simplification, std::uint32_t k);

/// One level of a tree of spheres.
struct TreeLevel {
  std::vector<Sphere> spheres;         ///< of that level, in the order of shown_at
  std::vector<std::uint32_t> parents;  ///< position in the level before, or no_parent (all of the first level)
};

/// The given levels (ascending) as a tree, for collision tests and levels of detail: every sphere of a level refines
/// one of the level before, unless it has no ancestor there. O(levels · spheres).
std::vector<TreeLevel> tree_of(const Simplification& simplification, std::span<const std::uint32_t> levels);

}  // namespace spherule
