// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/ball_components.h"

#include <algorithm>
#include <numeric>

namespace spherule::detail {

namespace {

// Cells that share a facet have balls that share its three corners. Other models link neighbours along the tree's curve
// where they overlap.
std::vector<std::array<std::uint32_t, 4>> sparse_edges(const SphereModel& model, const BallTree& tree,
                                                       const Context& context) {
  if (model.solid) {
    const Solid& solid = *model.solid;
    return neighbours(std::span(solid.cells).first(solid.inside_count), solid.boundary.points.size(), context);
  }
  const auto order = tree.order();
  std::vector<std::array<std::uint32_t, 4>> edges(order.size(), {no_cell, no_cell, no_cell, no_cell});
  for (std::size_t i = 0; i < order.size(); ++i) {
    for (std::size_t step = 1; step <= 2 && i + step < order.size(); ++step) {
      const std::uint32_t a = order[i], b = order[i + step];
      if (!overlap(model.spheres[a], model.spheres[b])) continue;
      edges[a][2 * step - 2] = b;
      edges[b][2 * step - 1] = a;
    }
  }
  return edges;
}

}  // namespace

BallComponents::BallComponents(const SphereModel& model, const Context& context)
    : balls_(model.spheres),
      poll_(context),
      tree_(balls_, context),
      untaken_(tree_),
      group_(balls_.size(), 0),
      edges_(sparse_edges(model, tree_, context)),
      search_of_(balls_.size(), kNone) {}

template <typename Visit>
void BallComponents::visit_edges(std::uint32_t ball, Visit&& visit) const {
  for (const std::uint32_t other : edges_[ball]) {
    if (other != no_cell) visit(other);
  }
  const auto [begin, end] = found_edges_.equal_range(ball);
  for (auto edge = begin; edge != end; ++edge) visit(edge->second);
}

void BallComponents::start(std::uint32_t ball) {
  search_of_[ball] = static_cast<std::uint32_t>(searches_.size());
  parent_.push_back(search_of_[ball]);
  searches_.push_back({{ball}, {ball}});
}

std::uint32_t BallComponents::root(std::uint32_t search) {
  while (parent_[search] != search) search = parent_[search] = parent_[parent_[search]];
  return search;
}

std::uint32_t BallComponents::unite(std::uint32_t a, std::uint32_t b) {
  if (searches_[a].found.size() < searches_[b].found.size()) std::swap(a, b);
  const auto append = [](auto& to, auto& from) {
    to.insert(to.end(), from.begin(), from.end());
    from = {};
  };
  append(searches_[a].found, searches_[b].found);
  append(searches_[a].todo, searches_[b].todo);
  parent_[b] = a;
  return a;
}

void BallComponents::walk(std::uint32_t search, std::uint32_t group, std::size_t steps) {
  for (; steps > 0 && !searches_[search].todo.empty(); --steps) {
    poll_(32);
    const std::uint32_t ball = searches_[search].todo.back();
    searches_[search].todo.pop_back();
    visit_edges(ball, [&](std::uint32_t other) {
      if (group_[other] != group) return;
      if (search_of_[other] == kNone) {
        search_of_[other] = search;
        searches_[search].found.push_back(other);
        searches_[search].todo.push_back(other);
      } else if (const std::uint32_t met = root(search_of_[other]); met != search) {
        search = unite(search, met);
      }
    });
  }
}

// All searches take turns until at most one has anything left to walk: that one is the main component, and the price
// was that of the others.
std::uint32_t BallComponents::walk_until_one_is_left(std::uint32_t group) {
  std::vector<std::uint32_t> active(searches_.size());
  std::iota(active.begin(), active.end(), 0U);
  for (std::size_t steps = 16; active.size() > 1; steps *= 2) {
    for (const std::uint32_t search : active) {
      if (parent_[search] == search) walk(search, group, steps);
    }
    std::erase_if(active, [&](std::uint32_t s) { return parent_[s] != s || searches_[s].todo.empty(); });
  }
  return active.empty() ? kNone : active.front();
}

// Unites the searches whose balls overlap though no edge joins them. A part looks for all that it touches, and so do
// all that it finds, until they turn out to be of the main one, which never needs to look. No ball is looked at twice
// but those of parts that are of the main one: what these took is put back, for others to find the main one by.
void BallComponents::join_overlapping(std::uint32_t group, std::uint32_t& main) {
  std::vector<std::uint32_t> parts;
  for (std::uint32_t s = 0; s < searches_.size(); ++s) {
    if (parent_[s] == s && s != main) parts.push_back(s);
  }
  std::ranges::stable_sort(parts, {}, [&](std::uint32_t s) { return searches_[s].found.size(); });
  std::vector<std::uint8_t> finished(searches_.size(), 0);
  std::vector<std::uint32_t> todo;
  for (const std::uint32_t part : parts) {
    const auto is_main = [&] { return root(part) == root(main); };
    if (is_main() || finished[root(part)]) continue;
    const std::size_t taken = untaken_.taken();
    todo = searches_[root(part)].found;
    while (!todo.empty() && !is_main()) {
      const std::uint32_t ball = todo.back();
      todo.pop_back();
      poll_(32);
      untaken_.take_overlapping(balls_[ball], [&](std::uint32_t other) {
        poll_();
        if (is_main()) return false;
        if (group_[other] != group) return true;
        const std::uint32_t met = search_of_[other] == kNone ? root(main) : root(search_of_[other]);
        if (met == root(part)) return true;
        found_edges_.emplace(ball, other);
        found_edges_.emplace(other, ball);
        if (met != root(main)) todo.insert(todo.end(), searches_[met].found.begin(), searches_[met].found.end());
        unite(met, root(part));
        return !is_main();
      });
    }
    if (is_main()) untaken_.put_back_to(taken);
    finished[root(part)] = 1;
  }
  untaken_.put_back_to(0);
  main = root(main);
}

std::vector<std::vector<std::uint32_t>> BallComponents::parts_beside_main(std::uint32_t group,
                                                                          std::span<const std::uint32_t> members,
                                                                          std::span<const std::uint32_t> left) {
  searches_.clear();
  parent_.clear();
  std::uint32_t main = kNone;
  if (left.empty()) {
    for (const std::uint32_t ball : members) {
      if (search_of_[ball] != kNone) continue;
      start(ball);
      walk(search_of_[ball], group, members.size());
    }
  } else {
    for (const std::uint32_t ball : left) {
      visit_edges(ball, [&](std::uint32_t other) {
        if (group_[other] == group && search_of_[other] == kNone) start(other);
      });
    }
    main = walk_until_one_is_left(group);
  }
  if (main == kNone) {
    for (std::uint32_t s = 0; s < searches_.size(); ++s) {
      if (parent_[s] == s && (main == kNone || searches_[s].found.size() > searches_[main].found.size())) main = s;
    }
  }
  std::vector<std::vector<std::uint32_t>> parts;
  if (main != kNone) join_overlapping(group, main);
  for (std::uint32_t s = 0; s < searches_.size(); ++s) {
    for (const std::uint32_t ball : searches_[s].found) search_of_[ball] = kNone;
    if (parent_[s] == s && s != main) parts.push_back(std::move(searches_[s].found));
  }
  return parts;
}

}  // namespace spherule::detail
