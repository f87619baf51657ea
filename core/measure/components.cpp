// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/components.h"

#include <algorithm>

#include "core/base/check.h"
#include "core/base/disjoint_sets.h"
#include "core/base/poll.h"
#include "core/measure/power.h"
#include "core/trees/ball_tree.h"

namespace spherule {

namespace {

// Of every sphere, the first sphere of its component.
std::vector<std::uint32_t> first_of_overlapping(std::span<const Sphere> balls, const Context& context) {
  const detail::BallTree tree(balls, context);
  detail::Untaken untaken(tree);
  constexpr std::uint32_t kNone = 0xffffffffU;
  std::vector<std::uint32_t> first(balls.size(), kNone), reached;
  Poll poll(context, 1 << 7);
  for (std::uint32_t b = 0; b < balls.size(); ++b) {
    if (first[b] != kNone) continue;
    first[b] = b;
    reached.assign(1, b);
    while (!reached.empty()) {
      const Sphere ball = balls[reached.back()];
      reached.pop_back();
      poll();
      untaken.take_overlapping(ball, [&](std::uint32_t other) {
        poll();
        if (first[other] == b) return true;
        if (!meet(ball, balls[other])) return false;
        first[other] = b;
        reached.push_back(other);
        return true;
      });
    }
  }
  return first;
}

std::vector<std::uint32_t> first_of_touching(const Solid& solid, const Context& context) {
  const auto cells = std::span(solid.cells).first(solid.inside_count);
  Poll poll(context);
  DisjointSets corners(solid.boundary.points.size());
  for (const Tetrahedron& t : cells) {
    poll(8);
    for (const std::uint32_t v : t) corners.unite(t[0], v);
  }
  std::vector<std::uint32_t> first_at(solid.boundary.points.size(), no_cell), first(cells.size());
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    poll(2);
    std::uint32_t& cell = first_at[corners.find(cells[c][0])];
    cell = std::min(cell, c);
    first[c] = cell;
  }
  return first;
}

}  // namespace

std::vector<std::uint32_t> first_of_component(const SphereModel& model, const Context& context) {
  return model.solid ? first_of_touching(*model.solid, context) : first_of_overlapping(model.spheres, context);
}

std::vector<Component> components(const SphereModel& model, std::span<const BallPart> parts, const Context& context) {
  SPHERULE_CHECK(parts.size() == model.spheres.size());
  const auto first = first_of_component(model, context);
  std::vector<Component> result;
  std::vector<std::uint32_t> index(first.size());
  Poll poll(context);
  for (std::uint32_t s = 0; s < first.size(); ++s) {
    poll(8);
    if (first[s] == s) {
      index[s] = static_cast<std::uint32_t>(result.size());
      result.push_back({.spheres = 0, .first_sphere = s, .volume_mm3 = 0, .area_mm2 = 0, .bounds = {}});
    }
    Component& component = result[index[first[s]]];
    ++component.spheres;
    component.volume_mm3 += parts[s].volume_mm3;
    component.area_mm2 += parts[s].area_mm2;
    if (model.solid) {
      const BoundaryPoints& boundary = model.solid->boundary;
      for (const std::uint32_t v : model.solid->cells[s]) {
        component.bounds.include(boundary.lattice.to_patient(boundary.points[v]));
      }
    } else {
      component.bounds.include(model.spheres[s]);
    }
  }
  std::ranges::stable_sort(result, std::ranges::greater{}, &Component::volume_mm3);
  return result;
}

}  // namespace spherule
