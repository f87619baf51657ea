// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/thickness.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <cmath>
#include <cstddef>
#include <numeric>
#include <utility>

#include "core/base/parallel.h"

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
std::array<Block, 2> halves(const Block& block, std::span<const LatticeBall> balls) {
  const auto longest = std::ranges::max_element(block.size) - block.size.begin();
  const auto axis = static_cast<std::size_t>(longest);
  const std::int64_t first = (block.size[axis] + 2 * kLeaf - 1) / (2 * kLeaf) * kLeaf;
  std::array<Block, 2> parts{Block{block.low, block.size, {}}, Block{block.low, block.size, {}}};
  parts[0].size[axis] = first;
  parts[1].low[axis] += first;
  parts[1].size[axis] -= first;
  const auto last_before = static_cast<double>(parts[1].low[axis] - 1), first_after = last_before + 1;
  for (const std::uint32_t b : block.balls) {
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

// Gives every point of a leaf to the first ball that holds it.
void paint(const Block& leaf, std::span<const LatticeBall> balls, std::vector<std::uint64_t>& painted) {
  const auto nx = static_cast<int>(leaf.size[0]), ny = static_cast<int>(leaf.size[1]),
             nz = static_cast<int>(leaf.size[2]);
  std::array<std::array<std::uint64_t, kLeaf>, kLeaf> open;
  for (auto& plane : open) plane.fill(~std::uint64_t{0} >> (64 - nx));
  int left = nx * ny * nz;
  for (const std::uint32_t b : leaf.balls) {
    const LatticeBall& ball = balls[b];
    const double squared = ball.radius * ball.radius;
    const Vec3 c = ball.centre - Vec3{static_cast<double>(leaf.low[0]), static_cast<double>(leaf.low[1]),
                                      static_cast<double>(leaf.low[2])};
    int gained = 0;
    const auto [k0, k1] = points_within(c.z - ball.radius, c.z + ball.radius, nz);
    for (int k = k0; k < k1; ++k) {
      const double disk = squared - (k - c.z) * (k - c.z);
      const double reach = std::sqrt(std::max(disk, 0.0));
      const auto [j0, j1] = points_within(c.y - reach, c.y + reach, ny);
      for (int j = j0; j < j1; ++j) {
        std::uint64_t& row = open[static_cast<std::size_t>(k)][static_cast<std::size_t>(j)];
        if (row == 0) continue;
        const double chord = disk - (j - c.y) * (j - c.y);
        if (chord < 0) continue;
        const double half = std::sqrt(chord);
        const auto [i0, i1] = points_within(c.x - half, c.x + half, nx);
        if (i0 >= i1) continue;
        const std::uint64_t gain = row & (~std::uint64_t{0} >> (64 - (i1 - i0))) << i0;
        if (gain == 0) continue;
        gained += std::popcount(gain);
        row &= ~gain;
      }
    }
    if (gained == 0) continue;
    std::atomic_ref<std::uint64_t>(painted[b]).fetch_add(static_cast<std::uint64_t>(gained), std::memory_order_relaxed);
    left -= gained;
    if (left == 0) return;
  }
}

void paint_all(const Block& block, std::span<const LatticeBall> balls, std::vector<std::uint64_t>& painted,
               const Context& context) {
  if (block.balls.empty()) return;
  if (block.is_leaf()) {
    context.throw_if_cancelled();
    paint(block, balls, painted);
    return;
  }
  for (const Block& part : halves(block, balls)) paint_all(part, balls, painted, context);
}

// Blocks for the threads, the same for any number of them.
std::vector<Block> tasks_of(Block whole, std::span<const LatticeBall> balls) {
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
      for (Block& part : halves(task, balls)) {
        if (!part.balls.empty()) finer.push_back(std::move(part));
      }
    }
    tasks = std::move(finer);
    if (!split) break;
  }
  return tasks;
}

std::vector<std::uint32_t> largest_first(std::span<const Sphere> balls) {
  std::vector<std::pair<double, std::uint32_t>> keys;
  keys.reserve(balls.size());
  for (std::uint32_t b = 0; b < balls.size(); ++b) keys.emplace_back(-balls[b].radius, b);
  std::ranges::sort(keys);
  std::vector<std::uint32_t> order;
  order.reserve(keys.size());
  for (const auto& [key, b] : keys) order.push_back(b);
  return order;
}

}  // namespace

LocalThickness local_thickness(std::span<const Sphere> balls, double volume_mm3, std::size_t buckets,
                               std::uint64_t samples, const Context& context) {
  if (buckets < 1 || buckets > 65536) {
    throw Error(ErrorCode::invalid_argument, "The number of buckets must be within 1 and 65536.",
                {{"buckets", "must be 1 to 65536"}});
  }
  LocalThickness result;
  result.volumes_mm3.assign(buckets, 0);
  if (balls.empty() || !(volume_mm3 > 0)) return result;

  const std::vector<std::uint32_t> order = largest_first(balls);
  const Mat3 axes = lattice_axes();
  Box box;
  for (const Sphere& ball : balls) box.include(Sphere{axes * ball.centre, ball.radius});
  const Vec3 extent = box.max - box.min;
  // Far apart, few balls would need more lattice points along an axis than can be counted.
  constexpr double kMostSteps = 1 << 30;
  const double step = std::max(std::cbrt(volume_mm3 / static_cast<double>(samples)),
                               std::max({extent.x, extent.y, extent.z}) / kMostSteps);
  std::vector<LatticeBall> on_lattice;
  on_lattice.reserve(balls.size());
  for (const std::uint32_t b : order) {
    on_lattice.push_back(
        {(1 / step) * (axes * balls[b].centre - box.min) - Vec3{0.5, 0.5, 0.5}, balls[b].radius / step});
  }
  Block whole;
  whole.low = {0, 0, 0};
  for (int a = 0; a < 3; ++a) {
    whole.size[static_cast<std::size_t>(a)] = static_cast<std::int64_t>(std::floor(extent[a] / step)) + 1;
  }
  whole.balls.resize(balls.size());
  std::iota(whole.balls.begin(), whole.balls.end(), 0U);

  std::vector<std::uint64_t> painted(balls.size(), 0);
  const std::vector<Block> tasks = tasks_of(std::move(whole), on_lattice);
  parallel_for(context, "thickness", tasks.size(), 1, [&](std::size_t begin, std::size_t end) {
    for (std::size_t t = begin; t < end; ++t) paint_all(tasks[t], on_lattice, painted, context);
  });

  result.spacing_mm = step;
  const double cell = step * step * step;
  double sum = 0;
  for (std::size_t i = painted.size(); i-- > 0;) {
    if (painted[i] == 0) continue;
    const double thickness = 2 * balls[order[i]].radius;
    if (result.samples == 0) result.min_mm = thickness;
    result.max_mm = thickness;
    result.samples += painted[i];
    sum += static_cast<double>(painted[i]) * thickness;
  }
  result.sampled_volume_mm3 = cell * static_cast<double>(result.samples);
  if (result.samples == 0) return result;
  result.mean_mm = sum / static_cast<double>(result.samples);
  double squares = 0;
  std::uint64_t below = 0;
  std::size_t percentile = 0;
  const double width = (result.max_mm - result.min_mm) / static_cast<double>(buckets);
  for (std::size_t i = painted.size(); i-- > 0;) {
    if (painted[i] == 0) continue;
    const double thickness = 2 * balls[order[i]].radius, distance = thickness - result.mean_mm;
    squares += static_cast<double>(painted[i]) * distance * distance;
    const auto bucket = width > 0 ? static_cast<std::size_t>((thickness - result.min_mm) / width) : 0;
    result.volumes_mm3[std::min(bucket, buckets - 1)] += cell * static_cast<double>(painted[i]);
    below += painted[i];
    while (percentile < LocalThickness::percents.size() &&
           100 * below >= static_cast<std::uint64_t>(LocalThickness::percents[percentile]) * result.samples) {
      result.percentiles_mm[percentile++] = thickness;
    }
  }
  result.sd_mm = std::sqrt(squares / static_cast<double>(result.samples));
  return result;
}

}  // namespace spherule
