// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/simplify/cover.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <functional>
#include <unordered_map>

#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/sampled/rows.h"

namespace spherule::detail {

namespace {

constexpr double kClose = 0.3;          // of a radius: centres of candidates are at least so far apart
constexpr std::size_t kPerSphere = 32;  // candidates for each sphere wanted
constexpr std::size_t kFewest = 4096;

std::uint64_t hash(std::uint64_t level, std::int64_t x, std::int64_t y, std::int64_t z) {
  std::uint64_t h = level;
  for (const std::int64_t v : {x, y, z}) h = (h ^ static_cast<std::uint64_t>(v)) * 0x9e3779b97f4a7c15U, h ^= h >> 29;
  return h;
}

// Balls by place, in cells that fit their size.
class Places {
 public:
  explicit Places(std::span<const Sphere> balls) : balls_(balls) {}

  // Whether a ball put here, no smaller than this one but not twice its class either, is close to it.
  bool has_close(const Sphere& ball) const {
    const double reach = kClose * ball.radius;
    const int own = level(ball);
    for (const int l : {own, own + 1}) {
      const double edge = cell(l);
      const auto at = [&](int axis, int step) {
        return static_cast<std::int64_t>(std::floor(ball.centre[axis] / edge)) + step;
      };
      for (int n = 0; n < 27; ++n) {
        const auto [begin, end] = places_.equal_range(
            hash(static_cast<std::uint64_t>(l), at(0, n % 3 - 1), at(1, n / 3 % 3 - 1), at(2, n / 9 - 1)));
        for (auto place = begin; place != end; ++place) {
          if (squared_norm(balls_[place->second].centre - ball.centre) <= reach * reach) return true;
        }
      }
    }
    return false;
  }
  void put(std::uint32_t i) {
    const Sphere& ball = balls_[i];
    const double edge = cell(level(ball));
    const auto at = [&](int axis) { return static_cast<std::int64_t>(std::floor(ball.centre[axis] / edge)); };
    places_.emplace(hash(static_cast<std::uint64_t>(level(ball)), at(0), at(1), at(2)), i);
  }

 private:
  static int level(const Sphere& ball) { return std::ilogb(ball.radius); }
  static double cell(int level) { return kClose * std::ldexp(2.0, level); }

  std::span<const Sphere> balls_;
  std::unordered_multimap<std::uint64_t, std::uint32_t> places_;
};

// The object's samples that no chosen ball holds yet.
class Uncovered {
 public:
  explicit Uncovered(const SampledObject& object) : spacing_(object.grid.spacing), bits_(object.inside) {}

  std::uint64_t in(const Sphere& ball, Poll& poll) const {
    std::uint64_t count = 0;
    visit_rows(spacing_, ball, window(), [&](std::int32_t j, std::int32_t k, Run run) {
      poll(2);
      const auto row = bits_.row(j, k);
      visit_words(static_cast<std::size_t>(run.begin), static_cast<std::size_t>(run.end),
                  [&](std::size_t w, std::uint64_t mask) {
                    count += static_cast<std::uint64_t>(std::popcount(row[w] & mask));
                  });
    });
    return count;
  }
  void cover(const Sphere& ball) {
    visit_rows(spacing_, ball, window(), [&](std::int32_t j, std::int32_t k, Run run) {
      const auto row = bits_.row(j, k);
      visit_words(static_cast<std::size_t>(run.begin), static_cast<std::size_t>(run.end),
                  [&](std::size_t w, std::uint64_t mask) { row[w] &= ~mask; });
    });
  }

 private:
  Window window() const { return {{0, 0, 0}, bits_.dims()}; }

  Vec3 spacing_;
  SampleBits bits_;
};

}  // namespace

Cover greedy_cover(std::span<const Sphere> candidates, const SampledObject& object, std::size_t k,
                   const Context& context) {
  struct Entry {
    std::uint64_t gain;  // at most this: what it was when last looked at
    std::uint32_t candidate;
    bool operator<(const Entry& other) const {
      return gain != other.gain ? gain < other.gain : candidate > other.candidate;
    }
  };
  std::vector<Sphere> balls;
  for (const Sphere& c : candidates) balls.push_back(to_grid(object.grid, c));
  Uncovered uncovered(object);
  std::vector<Entry> heap(balls.size());
  parallel_for(context, {}, balls.size(), 64, [&](std::size_t begin, std::size_t end) {
    Poll poll(context);
    for (std::size_t i = begin; i < end; ++i) heap[i] = {uncovered.in(balls[i], poll), static_cast<std::uint32_t>(i)};
  });
  std::make_heap(heap.begin(), heap.end());

  Cover cover;
  std::uint64_t covered = 0;
  Poll poll(context);
  while (!heap.empty() && cover.order.size() < k) {
    poll(16);
    std::pop_heap(heap.begin(), heap.end());
    Entry& last = heap.back();
    last.gain = uncovered.in(balls[last.candidate], poll);
    if (last.gain == 0) {
      heap.pop_back();
    } else if (heap.size() > 1 && last < heap.front()) {
      std::push_heap(heap.begin(), heap.end());
    } else {
      uncovered.cover(balls[last.candidate]);
      covered += last.gain;
      cover.order.push_back(last.candidate);
      cover.covered.push_back(covered);
      heap.pop_back();
    }
  }
  // Submodularity: any k candidates cover at most what is covered and, each, what it would still add.
  std::vector<std::uint64_t> gains(heap.size());
  parallel_for(context, {}, heap.size(), 64, [&](std::size_t begin, std::size_t end) {
    Poll adding(context);
    for (std::size_t i = begin; i < end; ++i) gains[i] = uncovered.in(balls[heap[i].candidate], adding);
  });
  std::ranges::sort(gains, std::greater<>());
  gains.resize(std::min(gains.size(), cover.order.size()));
  cover.bound = covered;
  for (const std::uint64_t gain : gains) cover.bound += gain;
  cover.bound = std::min(cover.bound, object.inside.count());
  return cover;
}

std::vector<Sphere> thinned(std::vector<Sphere> balls, std::size_t k, const Context& context) {
  Poll poll(context);
  std::erase_if(balls, [](const Sphere& ball) { return !(ball.radius > 0); });
  std::stable_sort(balls.begin(), balls.end(),
                   Polled(poll, [](const Sphere& a, const Sphere& b) { return a.radius > b.radius; }));
  const std::size_t most = std::max(kPerSphere * k, kFewest);
  std::vector<Sphere> kept;
  Places places(balls);
  for (std::uint32_t i = 0; i < balls.size() && kept.size() < most; ++i) {
    poll(512);
    if (places.has_close(balls[i])) continue;
    places.put(i);
    kept.push_back(balls[i]);
  }
  return kept.size() < 4 * k ? balls : kept;
}

std::vector<Sphere> poles(const SphereModel& model, const Context& context) {
  if (!model.solid) return model.spheres;
  const Solid& solid = *model.solid;
  std::vector<std::uint32_t> pole(solid.boundary.points.size(), no_cell);
  Poll poll(context);
  for (std::uint32_t c = 0; c < solid.inside_count; ++c) {
    poll(8);
    for (const std::uint32_t v : solid.cells[c]) {
      if (pole[v] == no_cell || model.spheres[c].radius > model.spheres[pole[v]].radius) pole[v] = c;
    }
  }
  std::sort(pole.begin(), pole.end(), Polled(poll, std::less<>()));
  pole.erase(std::ranges::unique(pole).begin(), pole.end());
  std::vector<Sphere> balls;
  for (const std::uint32_t c : pole) {
    if (c != no_cell) balls.push_back(model.spheres[c]);
  }
  return balls;
}

}  // namespace spherule::detail
