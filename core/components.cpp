// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/components.h"

#include <algorithm>
#include <cmath>

#include "core/base/check.h"
#include "core/base/disjoint_sets.h"
#include "core/box_tree.h"

namespace spherule {

namespace {

__extension__ using Float128 = __float128;

// Whether the balls have a point in common.
bool meet(const Sphere& a, const Sphere& b) {
  const Vec3 d = a.centre - b.centre;
  const double reach = a.radius + b.radius, distance = squared_norm(d), limit = reach * reach;
  // Both sides are off by less than 8 roundings of coordinates and radii.
  const double size = std::max({std::abs(a.centre.x), std::abs(a.centre.y), std::abs(a.centre.z), std::abs(b.centre.x),
                                std::abs(b.centre.y), std::abs(b.centre.z), reach});
  if (std::abs(distance - limit) > 0x1p-48 * size * size) return distance < limit;
  const auto square = [](double u, double v) {
    const Float128 difference = Float128{u} - Float128{v};
    return difference * difference;
  };
  const Float128 exact_reach = Float128{a.radius} + Float128{b.radius};
  return square(a.centre.x, b.centre.x) + square(a.centre.y, b.centre.y) + square(a.centre.z, b.centre.z) <=
         exact_reach * exact_reach;
}

// Of every sphere, the first sphere of its component.
std::vector<std::uint32_t> first_of_overlapping(std::span<const Sphere> balls, const Context& context) {
  constexpr std::size_t kPoll = 1 << 12;
  std::vector<Box> boxes(balls.size());
  for (std::size_t b = 0; b < balls.size(); ++b) {
    boxes[b].include(balls[b]);
    // A box rounded inwards would miss a ball that touches.
    for (int a = 0; a < 3; ++a) {
      boxes[b].min[a] = std::nextafter(boxes[b].min[a], -HUGE_VAL);
      boxes[b].max[a] = std::nextafter(boxes[b].max[a], HUGE_VAL);
    }
  }
  const BoxTree tree(boxes);
  DisjointSets sets(balls.size());
  for (std::size_t n = 0; n < balls.size(); ++n) {
    if (n % kPoll == 0) context.throw_if_cancelled();
    const std::uint32_t b = tree.order()[n];
    tree.for_each_overlap(boxes[b], [&](std::size_t place) {
      const std::uint32_t other = tree.order()[place];
      if (other < b && sets.find(other) != sets.find(b) && meet(balls[b], balls[other])) sets.unite(b, other);
    });
  }
  std::vector<std::uint32_t> first(balls.size());
  for (std::uint32_t b = 0; b < balls.size(); ++b) first[b] = sets.find(b);
  return first;
}

std::vector<std::uint32_t> first_of_touching(const Solid& solid) {
  const auto cells = std::span(solid.cells).first(solid.inside_count);
  DisjointSets corners(solid.boundary.points.size());
  for (const Tetrahedron& t : cells) {
    for (const std::uint32_t v : t) corners.unite(t[0], v);
  }
  std::vector<std::uint32_t> first_at(solid.boundary.points.size(), no_cell), first(cells.size());
  for (std::uint32_t c = 0; c < cells.size(); ++c) {
    std::uint32_t& cell = first_at[corners.find(cells[c][0])];
    cell = std::min(cell, c);
    first[c] = cell;
  }
  return first;
}

}  // namespace

std::vector<std::uint32_t> first_of_component(const SphereModel& model, const Context& context) {
  return model.solid ? first_of_touching(*model.solid) : first_of_overlapping(model.spheres, context);
}

std::vector<Component> components(const SphereModel& model, std::span<const BallPart> parts, const Context& context) {
  SPHERULE_CHECK(parts.size() == model.spheres.size());
  const auto first = first_of_component(model, context);
  std::vector<Component> result;
  std::vector<std::uint32_t> index(first.size());
  for (std::uint32_t s = 0; s < first.size(); ++s) {
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
