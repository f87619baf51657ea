// SPDX-License-Identifier: GPL-3.0-or-later
//
// Raw models. A point x of the union that lies in no inside cell is in a cap: in the ball of an inside cell that has a
// facet on the boundary, and beyond that facet. For let x be in the ball of inside cell s, and walk from a point of s
// to x. The powers of x with respect to the cells passed never grow (across a facet the Delaunay property makes the
// next ball the lower one beyond the facet's plane), so the last inside cell before the boundary holds x in its ball,
// and x is beyond the facet through which the walk left it.
//
// Other models. The surface within a box is made by the balls of least power there. Power differences are linear, so
// that one ball is nowhere below another in a box is one comparison.
#include "core/render/patches.h"

#include <algorithm>
#include <cmath>
#include <limits>
#include <span>

#include "core/base/check.h"
#include "core/base/parallel.h"

namespace spherule {
namespace {

// Joins the pieces in order, so that the result does not depend on who made which.
std::vector<Patch> joined(const std::vector<std::vector<Patch>>& pieces) {
  std::size_t total = 0;
  for (const auto& piece : pieces) total += piece.size();
  std::vector<Patch> all;
  all.reserve(total);
  for (const auto& piece : pieces) all.insert(all.end(), piece.begin(), piece.end());
  return all;
}

// The box of the ball's part with normal · x >= offset.
Box box_of_cap(const Sphere& ball, Vec3 normal, double offset) {
  const double height = offset - dot(normal, ball.centre);  // of the plane over the centre
  const double rim = std::sqrt(std::max(0.0, (ball.radius - height) * (ball.radius + height)));
  Box box;
  for (int a = 0; a < 3; ++a) {
    const double across = std::sqrt(std::max(0.0, 1 - normal[a] * normal[a]));
    for (const double side : {-1.0, 1.0}) {
      // The ball's own extreme point when it is in the cap, else the rim's.
      const double reach =
          side * normal[a] * ball.radius >= height ? ball.radius : height * side * normal[a] + rim * across;
      (side < 0 ? box.min : box.max)[a] = ball.centre[a] + side * reach;
    }
  }
  return box;
}

std::vector<Patch> patches_of_solid(const SphereModel& model, const Context& context) {
  const Solid& solid = *model.solid;
  Context quiet = context;  // the picture's progress is reported by whoever draws it
  quiet.progress = nullptr;
  // Among the inside cells alone: what is missing across a facet is outside or nothing.
  const auto across = neighbours(std::span(solid.cells).first(solid.inside_count), solid.boundary.points.size(), quiet);
  constexpr std::size_t kGrain = 1 << 15;
  std::vector<std::vector<Patch>> pieces((solid.inside_count + kGrain - 1) / kGrain);
  parallel_for(context, {}, solid.inside_count, kGrain, [&](std::size_t begin, std::size_t end) {
    std::vector<Patch>& patches = pieces[begin / kGrain];
    for (std::size_t cell = begin; cell < end; ++cell) {
      const Sphere& ball = model.spheres[cell];
      for (std::size_t i = 0; i < 4; ++i) {
        if (across[cell][i] != no_cell) continue;
        std::array<Vec3, 4> corner;
        for (std::size_t v = 0; v < 4; ++v)
          corner[v] = solid.boundary.lattice.to_patient(solid.boundary.points[solid.cells[cell][(i + v) % 4]]);
        Vec3 normal = normalised(cross(corner[2] - corner[1], corner[3] - corner[1]));
        if (dot(normal, corner[0] - corner[1]) > 0) normal = -normal;
        patches.push_back({box_of_cap(ball, normal, dot(normal, corner[1])), static_cast<std::uint32_t>(cell)});
      }
    }
  });
  return joined(pieces);
}

struct Cell {
  Vec3 centre;
  double half = 0;  // of the cube's side
  std::vector<std::uint32_t> balls;
};

constexpr std::size_t kFewBalls = 24;
constexpr int kMaxLevel = 11;
// What a part of the search may cost: patches, of about 160 bytes each with the tracer's, and balls looked at in each
// of its levels.
struct Budget {
  std::size_t patches = 0, looks = 0;

  // Of a cell with so many of all `total` balls.
  Budget share(std::size_t balls, std::size_t total) const {
    const double part = static_cast<double>(balls) / static_cast<double>(total);
    return {static_cast<std::size_t>(static_cast<double>(patches) * part),
            static_cast<std::size_t>(static_cast<double>(looks) * part)};
  }
};
Budget budget_of(std::size_t balls) {
  return {(std::size_t{1} << 18) + 8 * balls, (std::size_t{1} << 26) + 128 * balls};
}

Vec3 absolute(Vec3 v) { return {std::abs(v.x), std::abs(v.y), std::abs(v.z)}; }

// No more than the least of gradient · u where cell.centre + u is on the sphere and in the cell. There, with n the
// direction from the sphere's centre to the cell's and D their distance, n·u is (r² - D² - |u|²) / 2D, and |u|² at most
// 3 half².
double least_along(Vec3 gradient, const Sphere& s, const Cell& cell) {
  const auto least_in_cube = [&](Vec3 g) {
    const Vec3 all = absolute(g);
    return -cell.half * (all.x + all.y + all.z);
  };
  const Vec3 out = cell.centre - s.centre;
  const double distance = norm(out);
  if (distance <= 2 * cell.half) return least_in_cube(gradient);
  const Vec3 n = 1 / distance * out;
  const double most = (s.radius - distance) * (s.radius + distance) / (2 * distance),
               least = most - 3 * cell.half * cell.half / (2 * distance), along = dot(gradient, n);
  return std::max(least_in_cube(gradient), std::min(along * least, along * most) + least_in_cube(gradient - along * n));
}

// Keeps the balls that may make a part of the surface within the cell; none when a ball covers it.
void keep_exposed(std::span<const Sphere> spheres, Cell& cell) {
  double least = std::numeric_limits<double>::infinity();
  std::uint32_t lowest = 0;
  std::size_t kept = 0;
  for (const std::uint32_t i : cell.balls) {
    const Sphere& s = spheres[i];
    const Vec3 offset = absolute(s.centre - cell.centre);
    const double squared_radius = s.radius * s.radius;
    double nearest = 0, farthest = 0;
    for (int a = 0; a < 3; ++a) {
      const double inner = std::max(0.0, offset[a] - cell.half), outer = offset[a] + cell.half;
      nearest += inner * inner;
      farthest += outer * outer;
    }
    if (nearest > squared_radius) continue;
    if (farthest < squared_radius) {
      cell.balls.clear();
      return;
    }
    const double power = squared_norm(offset) - squared_radius;
    if (power < least) least = power, lowest = i;
    cell.balls[kept++] = i;
  }
  cell.balls.resize(kept);
  std::erase_if(cell.balls, [&](std::uint32_t i) {
    if (i == lowest) return false;
    const Sphere& s = spheres[i];
    const double above = squared_norm(s.centre - cell.centre) - s.radius * s.radius - least;
    return above + least_along(2.0 * (spheres[lowest].centre - s.centre), s, cell) >= 0;
  });
}

std::array<Cell, 8> split(std::span<const Sphere> spheres, const Cell& cell) {
  std::array<Cell, 8> children;
  const double half = cell.half / 2;
  for (std::size_t c = 0; c < 8; ++c) {
    const Vec3 step{c & 1 ? half : -half, c & 2 ? half : -half, c & 4 ? half : -half};
    children[c] = {cell.centre + step, half, cell.balls};
    keep_exposed(spheres, children[c]);
  }
  return children;
}

double area(const Box& box) {
  const Vec3 e = box.max - box.min;
  return e.x * e.y + e.y * e.z + e.z * e.x;
}

// Joins the patches of one ball where a ray is no likelier to meet the joined box than the parts: without this, a
// corner at which many balls meet would fill memory with small cells.
void join_from(std::size_t first, std::vector<Patch>& patches) {
  const auto begin = patches.begin() + static_cast<std::ptrdiff_t>(first);
  std::stable_sort(begin, patches.end(), [](const Patch& a, const Patch& b) { return a.ball < b.ball; });
  auto out = begin;
  for (auto run = begin; run != patches.end();) {
    Patch whole{{}, run->ball};
    double parts = 0;
    auto end = run;
    for (; end != patches.end() && end->ball == whole.ball; ++end) {
      whole.box.include(end->box.min), whole.box.include(end->box.max);
      parts += area(end->box);
    }
    if (area(whole.box) <= 1.5 * parts) {
      *out++ = whole;
      run = end;
    } else {
      while (run != end) *out++ = *run++;
    }
  }
  patches.erase(out, patches.end());
}

// Whether so many balls may be put into eight children each, which may hold them all.
bool may_split(std::size_t balls, std::size_t most) { return balls > kFewBalls && 8 * balls <= most; }

void take_whole(std::span<const Sphere> spheres, const Cell& cell, std::vector<Patch>& patches) {
  for (const std::uint32_t i : cell.balls) {
    const Sphere& s = spheres[i];
    Box box;
    for (int a = 0; a < 3; ++a) {
      box.min[a] = std::max(cell.centre[a] - cell.half, s.centre[a] - s.radius);
      box.max[a] = std::min(cell.centre[a] + cell.half, s.centre[a] + s.radius);
    }
    patches.push_back({box, i});
  }
}

// Makes no more patches than the budget has, unless the cell has more balls than that. Children share it by their
// balls, so that all of the surface is divided as finely: what can afford no more is left as it is.
void refine(std::span<const Sphere> spheres, const Cell& cell, int level, const Budget& budget,
            std::vector<Patch>& patches, const Context& context) {
  if (level >= kMaxLevel || !may_split(cell.balls.size(), budget.looks)) {
    take_whole(spheres, cell, patches);
    return;
  }
  context.throw_if_cancelled();
  const std::size_t first = patches.size();
  const std::array<Cell, 8> children = split(spheres, cell);
  std::size_t total = 0;
  for (const Cell& child : children) total += child.balls.size();
  for (const Cell& child : children) {
    if (!child.balls.empty())
      refine(spheres, child, level + 1, budget.share(child.balls.size(), total), patches, context);
  }
  join_from(first, patches);
  if (patches.size() - first <= std::max(budget.patches, cell.balls.size())) return;
  patches.resize(first);
  take_whole(spheres, cell, patches);
}

std::vector<Patch> patches_of_balls(std::span<const Sphere> spheres, const Context& context) {
  Box box;
  Cell root;
  for (std::size_t i = 0; i < spheres.size(); ++i) {
    if (!(spheres[i].radius > 0)) continue;
    box.include(spheres[i]);
    root.balls.push_back(static_cast<std::uint32_t>(i));
  }
  if (root.balls.empty()) return {};
  root.centre = 0.5 * (box.min + box.max);
  const Vec3 extent = box.max - box.min;
  root.half = 0.5 * std::max({extent.x, extent.y, extent.z});

  // The first levels breadth first, until there is enough work to share.
  constexpr std::size_t kEnoughCells = 512;
  const Budget budget = budget_of(root.balls.size());
  std::size_t total = root.balls.size();
  std::vector<Cell> cells{std::move(root)};
  int level = 0;
  while (cells.size() < kEnoughCells && level < 4 && may_split(total, budget.patches) &&
         std::ranges::any_of(cells, [](const Cell& c) { return c.balls.size() > kFewBalls; })) {
    std::vector<std::array<Cell, 8>> children(cells.size());
    parallel_for(context, {}, cells.size(), 1,
                 [&](std::size_t i, std::size_t) { children[i] = split(spheres, cells[i]); });
    cells.clear();
    for (auto& eight : children)
      for (Cell& child : eight)
        if (!child.balls.empty()) cells.push_back(std::move(child));
    ++level;
    total = 0;
    for (const Cell& cell : cells) total += cell.balls.size();
  }
  std::vector<std::vector<Patch>> pieces(cells.size());
  parallel_for(context, {}, cells.size(), 1, [&](std::size_t i, std::size_t) {
    refine(spheres, cells[i], level, budget.share(cells[i].balls.size(), total), pieces[i], context);
  });
  return joined(pieces);
}

}  // namespace

std::vector<Patch> visible_patches(const SphereModel& model, const Context& context) {
  SPHERULE_CHECK(model.spheres.size() < std::numeric_limits<std::uint32_t>::max());
  return model.solid ? patches_of_solid(model, context) : patches_of_balls(model.spheres, context);
}

}  // namespace spherule
