// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/measure/thickness.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstddef>
#include <functional>
#include <numeric>
#include <utility>

#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/measure/ball_cell.h"

namespace spherule {

namespace {

// The lattice's axes (rows of a rotation, a unit quaternion's): oblique to planes along the frame's axes, where objects
// are cut by the border of their volume and a lattice parallel to it would count whole layers too many or too few.
Mat3 lattice_axes() {
  constexpr double w = 0.7853, x = 0.2718, y = 0.1414, z = 0.5381, scale = 1 / (w * w + x * x + y * y + z * z);
  return {{scale * Vec3{w * w + x * x - y * y - z * z, 2 * (x * y - w * z), 2 * (x * z + w * y)},
           scale * Vec3{2 * (x * y + w * z), w * w - x * x + y * y - z * z, 2 * (y * z - w * x)},
           scale * Vec3{2 * (x * z - w * y), 2 * (y * z + w * x), w * w - x * x - y * y + z * z}}};
}

constexpr std::int64_t kLeaf = 64;
constexpr std::size_t kTasks = 256;

// Lengths in lattice steps, measured from lattice point (0, 0, 0).
struct LatticeBall {
  Vec3 centre;
  double radius;
};

// Lattice points low … low + size - 1, and the balls that reach them, largest first.
struct Block {
  std::array<std::int64_t, 3> low, size;
  std::vector<std::uint32_t> balls;

  bool is_leaf() const { return *std::ranges::max_element(size) <= kLeaf; }
};

// Halves along the longest side, at a multiple of a leaf from its low end. A ball that reaches both is in both.
std::array<Block, 2> halves(const Block& block, std::span<const LatticeBall> balls, Poll& poll) {
  const auto longest = std::ranges::max_element(block.size) - block.size.begin();
  const auto axis = static_cast<std::size_t>(longest);
  const std::int64_t first = (block.size[axis] + 2 * kLeaf - 1) / (2 * kLeaf) * kLeaf;
  std::array<Block, 2> parts{Block{block.low, block.size, {}}, Block{block.low, block.size, {}}};
  parts[0].size[axis] = first;
  parts[1].low[axis] += first;
  parts[1].size[axis] -= first;
  const auto last_before = static_cast<double>(parts[1].low[axis] - 1), first_after = last_before + 1;
  for (const std::uint32_t b : block.balls) {
    poll(2);
    const double centre = balls[b].centre[static_cast<int>(longest)], radius = balls[b].radius;
    if (centre - radius <= last_before) parts[0].balls.push_back(b);
    if (centre + radius >= first_after) parts[1].balls.push_back(b);
  }
  return parts;
}

// Lattice points of [from, to] that are in [0, size), as a half-open range.
std::array<int, 2> points_within(double from, double to, int size) {
  if (to < 0 || from > size - 1) return {0, 0};
  from = std::max(from, 0.0);
  const int floor = static_cast<int>(from);
  return {floor + (floor < from), static_cast<int>(std::min(to, size - 1.0)) + 1};
}

// A box around the part of the union that belongs to one ball, in lattice steps.
struct Reach {
  std::array<float, 3> low, high;
};

// Gives every point of a leaf to the first ball that holds it.
class Leaf {
 public:
  Leaf(const Block& block, std::span<const LatticeBall> balls, Poll& poll)
      : block_(block),
        poll_(poll),
        balls_(balls),
        size_{static_cast<int>(block.size[0]), static_cast<int>(block.size[1]), static_cast<int>(block.size[2])} {}

  // Without reaches every point is open until a ball holds it. With them, only those of the union are: found in each
  // ball's own part alone, they end the search through all balls that only nearly hold what is beyond the surface.
  void paint(std::span<const Reach> reaches, std::vector<std::uint64_t>& painted) {
    if (reaches.empty()) {
      for (int k = 0; k < size_[2]; ++k) {
        for (int j = 0; j < size_[1]; ++j) row(j, k) = ones(0, size_[0]);
      }
    } else {
      for (const std::uint32_t b : block_.balls) poll_(16), open_part(balls_[b], reaches[b]);
    }
    for (int k = 0; k < size_[2]; ++k) {
      for (int j = 0; j < size_[1]; ++j) open_rows_[at(k)] |= std::uint64_t{row(j, k) != 0} << j;
      open_planes_ |= std::uint64_t{open_rows_[at(k)] != 0} << k;
    }
    for (const std::uint32_t b : block_.balls) {
      if (open_planes_ == 0) return;
      poll_(16);
      if (const std::uint64_t gained = take(balls_[b]); gained > 0) {
        std::atomic_ref<std::uint64_t>(painted[b]).fetch_add(gained, std::memory_order_relaxed);
      }
    }
  }

 private:
  using Range = std::array<int, 2>;  // half-open

  static std::size_t at(int index) { return static_cast<std::size_t>(index); }
  std::uint64_t& row(int j, int k) { return open_[at(k)][at(j)]; }
  // Bits [from, to), some.
  static std::uint64_t ones(int from, int to) { return (~std::uint64_t{0} >> (64 - (to - from))) << from; }
  static std::uint64_t ones(Range range) { return range[0] < range[1] ? ones(range[0], range[1]) : 0; }

  // Points within `half` of the centre along one axis.
  Range within(double centre, double half, std::size_t axis) const {
    return points_within(centre - half, centre + half, size_[axis]);
  }
  Vec3 centre_of(const LatticeBall& ball) const {
    return ball.centre - Vec3{static_cast<double>(block_.low[0]), static_cast<double>(block_.low[1]),
                              static_cast<double>(block_.low[2])};
  }
  static double squared(double x) { return x * x; }

  void open_part(const LatticeBall& ball, const Reach& reach) {
    std::array<Range, 3> box;
    for (std::size_t a = 0; a < 3; ++a) {
      const auto low = static_cast<double>(block_.low[a]);
      box[a] = points_within(reach.low[a] - low, reach.high[a] - low, size_[a]);
    }
    const Vec3 c = centre_of(ball);
    for (int k = box[2][0]; k < box[2][1]; ++k) {
      poll_(64);
      const double disk = squared(ball.radius) - squared(k - c.z);
      for (int j = box[1][0]; j < box[1][1]; ++j) {
        const double chord = disk - squared(j - c.y);
        if (chord < 0) continue;
        const auto [from, to] = within(c.x, std::sqrt(chord), 0);
        row(j, k) |= ones(Range{std::max(from, box[0][0]), std::min(to, box[0][1])});
      }
    }
  }

  std::uint64_t take(const LatticeBall& ball) {
    std::uint64_t gained = 0;
    const Vec3 c = centre_of(ball);
    for (std::uint64_t planes = open_planes_ & ones(within(c.z, ball.radius, 2)); planes != 0; planes &= planes - 1) {
      poll_(64);
      const int k = std::countr_zero(planes);
      const double disk = squared(ball.radius) - squared(k - c.z);
      if (disk < 0) continue;
      std::uint64_t& rows_left = open_rows_[at(k)];
      for (std::uint64_t rows = rows_left & ones(within(c.y, std::sqrt(disk), 1)); rows != 0; rows &= rows - 1) {
        const int j = std::countr_zero(rows);
        const double chord = disk - squared(j - c.y);
        if (chord < 0) continue;
        std::uint64_t& open = row(j, k);
        const std::uint64_t gain = open & ones(within(c.x, std::sqrt(chord), 0));
        if (gain == 0) continue;
        gained += static_cast<std::uint64_t>(std::popcount(gain));
        open &= ~gain;
        if (open == 0) rows_left &= ~(std::uint64_t{1} << j);
      }
      if (rows_left == 0) open_planes_ &= ~(std::uint64_t{1} << k);
    }
    return gained;
  }

  const Block& block_;
  Poll& poll_;
  std::span<const LatticeBall> balls_;
  std::array<int, 3> size_;
  // Points still open, and where there are any.
  std::array<std::array<std::uint64_t, kLeaf>, kLeaf> open_{};
  std::array<std::uint64_t, kLeaf> open_rows_{};
  std::uint64_t open_planes_ = 0;
};

struct Canvas {
  std::span<const LatticeBall> balls;
  std::span<const Reach> reaches;       // empty, or of each ball
  std::vector<std::uint64_t>& painted;  // points by ball
};

void paint_all(const Block& block, const Canvas& canvas, Poll& poll) {
  if (block.balls.empty()) return;
  if (block.is_leaf()) {
    Leaf(block, canvas.balls, poll).paint(canvas.reaches, canvas.painted);
    return;
  }
  for (const Block& part : halves(block, canvas.balls, poll)) paint_all(part, canvas, poll);
}

// Blocks for the threads, the same for any number of them.
std::vector<Block> tasks_of(Block whole, std::span<const LatticeBall> balls, Poll& poll) {
  std::vector<Block> tasks;
  tasks.push_back(std::move(whole));
  while (tasks.size() < kTasks) {
    std::vector<Block> finer;
    bool split = false;
    for (Block& task : tasks) {
      if (task.is_leaf()) {
        finer.push_back(std::move(task));
        continue;
      }
      split = true;
      for (Block& part : halves(task, balls, poll)) {
        if (!part.balls.empty()) finer.push_back(std::move(part));
      }
    }
    tasks = std::move(finer);
    if (!split) break;
  }
  return tasks;
}

// From LPS mm to lattice steps.
struct ToLattice {
  Mat3 axes;
  Vec3 origin;  // LPS turned by axes
  double step;

  Vec3 operator()(Vec3 p) const { return (1 / step) * (axes * p - origin) - Vec3{0.5, 0.5, 0.5}; }
};

// Of every ball of a raw model, in `order`: around its tetrahedron and, beyond the facets that no other inside
// tetrahedron shares, its caps. That holds its power cell's part of the union (core/measure/union.cpp says why).
std::vector<Reach> reaches_of(const SphereModel& model, std::span<const std::uint32_t> order,
                              const ToLattice& to_lattice, const Context& context) {
  const Solid& solid = *model.solid;
  const auto cells = std::span(solid.cells).first(solid.inside_count);
  Context quiet = context;
  quiet.progress = nullptr;
  const auto across = neighbours(cells, solid.boundary.points.size(), quiet);
  std::vector<Vec3> points;
  points.reserve(solid.boundary.points.size());
  for (const LatticePoint p : solid.boundary.points) points.push_back(to_lattice(solid.boundary.lattice.to_patient(p)));
  // In the order of the cells, which is that of memory.
  std::vector<std::uint32_t> rank(order.size());
  Poll poll(context);
  for (std::uint32_t n = 0; n < order.size(); ++n) poll(2), rank[order[n]] = n;
  std::vector<Reach> reaches(order.size());
  parallel_for(quiet, {}, cells.size(), 1 << 12, [&](std::size_t begin, std::size_t end) {
    for (std::size_t c = begin; c < end; ++c) {
      Box box;
      for (const std::uint32_t v : cells[c]) box.include(points[v]);
      for (std::size_t i = 0; i < 4; ++i) {
        if (across[c][i] != no_cell) continue;
        const Vec3 centre = to_lattice(model.spheres[c].centre), corner = points[cells[c][i]];
        const double radius = model.spheres[c].radius / to_lattice.step;
        const Vec3 a = points[cells[c][(i + 1) % 4]];
        Vec3 normal = normalised(cross(points[cells[c][(i + 2) % 4]] - a, points[cells[c][(i + 3) % 4]] - a));
        if (dot(normal, corner - a) > 0) normal = -normal;
        const Box cap = cap_box(radius, normal, std::clamp(dot(normal, a - centre), -radius, radius));
        box.include(cap.min + centre), box.include(cap.max + centre);
      }
      Reach& reach = reaches[rank[c]];
      for (int a = 0; a < 3; ++a) {
        // More than rounding can move, to float too, on lattices of up to 2^14 steps.
        constexpr double kMargin = 0x1p-9;
        reach.low[static_cast<std::size_t>(a)] = static_cast<float>(box.min[a] - kMargin);
        reach.high[static_cast<std::size_t>(a)] = static_cast<float>(box.max[a] + kMargin);
      }
    }
  });
  return reaches;
}

std::vector<std::uint32_t> largest_first(std::span<const Sphere> balls, Poll& poll) {
  std::vector<std::pair<double, std::uint32_t>> keys;
  keys.reserve(balls.size());
  for (std::uint32_t b = 0; b < balls.size(); ++b) keys.emplace_back(-balls[b].radius, b);
  std::sort(keys.begin(), keys.end(), Polled(poll, std::less<>()));
  std::vector<std::uint32_t> order;
  order.reserve(keys.size());
  for (const auto& [key, b] : keys) order.push_back(b);
  return order;
}

// What each ball got of the lattice, largest ball first.
struct Painted {
  std::vector<std::uint32_t> order;
  std::vector<std::uint64_t> points;  // in that order
  double step = 0;
};

// `raw` may be null: the model that the balls are of.
Painted painted(std::span<const Sphere> balls, const SphereModel* raw, double volume_mm3, std::uint64_t samples,
                const Context& context) {
  Poll poll(context);
  Painted result{.order = largest_first(balls, poll), .points = std::vector<std::uint64_t>(balls.size(), 0)};
  const Mat3 axes = lattice_axes();
  Box box;
  for (const Sphere& ball : balls) box.include(Sphere{axes * ball.centre, ball.radius});
  const Vec3 extent = box.max - box.min;
  // Far apart, few balls would need more lattice points along an axis than can be counted.
  constexpr double kMostSteps = 1 << 30;
  result.step = std::max(elementary::cbrt(volume_mm3 / static_cast<double>(samples)),
                         std::max({extent.x, extent.y, extent.z}) / kMostSteps);
  const ToLattice to_lattice{axes, box.min, result.step};
  std::vector<LatticeBall> on_lattice;
  on_lattice.reserve(balls.size());
  for (const std::uint32_t b : result.order) {
    poll(4);
    on_lattice.push_back({to_lattice(balls[b].centre), balls[b].radius / result.step});
  }
  std::vector<Reach> reaches;
  if (raw != nullptr) reaches = reaches_of(*raw, result.order, to_lattice, context);
  Block whole;
  whole.low = {0, 0, 0};
  for (int a = 0; a < 3; ++a) {
    whole.size[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::floor(extent[a] / result.step)) + 1;
  }
  whole.balls.resize(balls.size());
  std::iota(whole.balls.begin(), whole.balls.end(), 0U);

  const std::vector<Block> tasks = tasks_of(std::move(whole), on_lattice, poll);
  const Canvas canvas{on_lattice, reaches, result.points};
  parallel_for(context, "thickness", tasks.size(), 1, [&](std::size_t begin, std::size_t end) {
    Poll painting(context);
    for (std::size_t t = begin; t < end; ++t) paint_all(tasks[t], canvas, painting);
  });
  return result;
}

LocalThickness thickness_of(std::span<const Sphere> balls, const SphereModel* raw, double volume_mm3,
                            std::size_t buckets, std::uint64_t samples, const Context& context) {
  if (buckets < 1 || buckets > 65536) {
    throw Error(ErrorCode::invalid_argument, "The number of buckets must be within 1 and 65536.",
                {{"buckets", "must be 1 to 65536"}});
  }
  LocalThickness result;
  result.volumes_mm3.assign(buckets, 0);
  if (balls.empty() || !(volume_mm3 > 0)) return result;
  const Painted lattice = painted(balls, raw, volume_mm3, samples, context);

  result.spacing_mm = lattice.step;
  const double cell = lattice.step * lattice.step * lattice.step;
  // Calls visit(thickness, points) for every ball that got any, the smallest first.
  const auto for_each = [&](auto visit) {
    for (std::size_t i = lattice.points.size(); i-- > 0;) {
      if (lattice.points[i] > 0) visit(2 * balls[lattice.order[i]].radius, lattice.points[i]);
    }
  };
  double sum = 0;
  for_each([&](double thickness, std::uint64_t points) {
    if (result.samples == 0) result.min_mm = thickness;
    result.max_mm = thickness;
    result.samples += points;
    sum += static_cast<double>(points) * thickness;
  });
  if (result.samples == 0) return result;
  result.sampled_volume_mm3 = cell * static_cast<double>(result.samples);
  result.mean_mm = sum / static_cast<double>(result.samples);
  double squares = 0;
  std::uint64_t below = 0;
  std::size_t percentile = 0;
  const double width = (result.max_mm - result.min_mm) / static_cast<double>(buckets);
  for_each([&](double thickness, std::uint64_t points) {
    const double distance = thickness - result.mean_mm;
    squares += static_cast<double>(points) * distance * distance;
    const auto bucket = width > 0 ? static_cast<std::size_t>((thickness - result.min_mm) / width) : 0;
    result.volumes_mm3[std::min(bucket, buckets - 1)] += cell * static_cast<double>(points);
    below += points;
    while (percentile < LocalThickness::percents.size() &&
           100 * below >= static_cast<std::uint64_t>(LocalThickness::percents[percentile]) * result.samples) {
      result.percentiles_mm[percentile++] = thickness;
    }
  });
  result.sd_mm = std::sqrt(squares / static_cast<double>(result.samples));
  return result;
}

}  // namespace

LocalThickness local_thickness(std::span<const Sphere> balls, double volume_mm3, std::size_t buckets,
                               std::uint64_t samples, const Context& context) {
  return thickness_of(balls, nullptr, volume_mm3, buckets, samples, context);
}

LocalThickness local_thickness(const SphereModel& model, double volume_mm3, std::size_t buckets, std::uint64_t samples,
                               const Context& context) {
  return thickness_of(model.spheres, model.solid ? &model : nullptr, volume_mm3, buckets, samples, context);
}

}  // namespace spherule
