// SPDX-License-Identifier: GPL-3.0-or-later
//
// Connected components of unions of balls while balls leave: what sphericity clustering asks again and again. Private
// to core/simplify.
#pragma once

#include <array>
#include <cstdint>
#include <span>
#include <unordered_map>
#include <vector>

#include "core/base/context.h"
#include "core/base/poll.h"
#include "core/spheres.h"
#include "core/trees/ball_tree.h"

namespace spherule::detail {

/// Every ball belongs to one group; at first all to group 0. The graph behind has an edge for some pairs that overlap
/// (neighbouring cells of a raw model), and queries of the tree find what it misses: so components are exact while most
/// of the work is walking a sparse graph. Not thread safe.
class BallComponents {
 public:
  /// The model must outlive this.
  explicit BallComponents(const SphereModel& model, const Context& context);

  std::uint32_t group_of(std::uint32_t ball) const { return group_[ball]; }
  void move(std::uint32_t ball, std::uint32_t group) { group_[ball] = group; }

  /// The components of the union of the balls of one group, but for one of them (the main one), which is all that the
  /// others leave. `members` are the group's balls; `left` are balls that have just left it, when it was connected with
  /// them, else empty. With `left` the cost is near to that of the parts returned and of the surroundings of `left`.
  std::vector<std::vector<std::uint32_t>> parts_beside_main(std::uint32_t group, std::span<const std::uint32_t> members,
                                                            std::span<const std::uint32_t> left);

 private:
  struct Search {
    std::vector<std::uint32_t> found, todo;
  };
  static constexpr std::uint32_t kNone = 0xffffffffU;

  template <typename Visit>
  void visit_edges(std::uint32_t ball, Visit&& visit) const;
  void start(std::uint32_t ball);
  std::uint32_t root(std::uint32_t search);
  std::uint32_t unite(std::uint32_t a, std::uint32_t b);
  void walk(std::uint32_t search, std::uint32_t group, std::size_t steps);
  std::uint32_t walk_until_one_is_left(std::uint32_t group);
  void join_overlapping(std::uint32_t group, std::uint32_t& main);

  std::span<const Sphere> balls_;
  Poll poll_;
  BallTree tree_;
  Untaken untaken_;  // all, between calls
  std::vector<std::uint32_t> group_;
  std::vector<std::array<std::uint32_t, 4>> edges_;
  std::unordered_multimap<std::uint32_t, std::uint32_t> found_edges_;  // by the tree, both ways
  std::vector<std::uint32_t> search_of_;                               // of every ball found in the current call
  std::vector<Search> searches_;
  std::vector<std::uint32_t> parent_;  // of searches that were united
};

}  // namespace spherule::detail
