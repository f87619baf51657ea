// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/sampled/object.h"

#include <algorithm>
#include <atomic>
#include <bit>
#include <string_view>

#include "core/base/check.h"
#include "core/base/elementary.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/sampled/rows.h"

namespace spherule {

using detail::Run;
using detail::Window;

namespace {

constexpr std::size_t kSlices = 4;  // in one piece of parallel work

Window whole(const Grid& grid) { return {{0, 0, 0}, grid.dims}; }

std::vector<Sphere> in_grid(std::span<const Sphere> balls, const Grid& grid) {
  std::vector<Sphere> result;
  for (const Sphere& ball : balls) result.push_back(detail::to_grid(grid, ball));
  return result;
}

// Rows of bits for one slice of a window.
class SliceBits {
 public:
  explicit SliceBits(const Window& window)
      : window_(window),
        words_((static_cast<std::size_t>(window.size(0)) + 63) / 64),
        bits_(words_ * static_cast<std::size_t>(window.size(1))) {}

  void clear() { std::ranges::fill(bits_, 0U); }
  std::span<std::uint64_t> row(std::int32_t j) {
    return std::span(bits_).subspan(static_cast<std::size_t>(j - window_.begin[1]) * words_, words_);
  }
  void set(std::int32_t j, Run run) {
    const auto bits = row(j);
    detail::visit_words(static_cast<std::size_t>(run.begin - window_.begin[0]),
                        static_cast<std::size_t>(run.end - window_.begin[0]),
                        [&](std::size_t w, std::uint64_t mask) { bits[w] |= mask; });
  }

 private:
  const Window& window_;
  std::size_t words_;
  std::vector<std::uint64_t> bits_;
};

// Calls visit(k, covered) for every slice of the window, from several threads, where bit i of a covered row is the
// window's sample i. `balls` in grid mm.
template <typename Visit>
void visit_covered(std::span<const Sphere> balls, Vec3 spacing, const Window& window, std::string_view stage,
                   const Context& context, Visit&& visit) {
  const auto slices = static_cast<std::size_t>(window.size(2));
  parallel_for(context, stage, slices, kSlices, [&](std::size_t first, std::size_t last) {
    Poll poll(context);
    std::vector<SliceBits> covered(last - first, SliceBits(window));
    Window slab = window;
    slab.begin[2] = window.begin[2] + static_cast<std::int32_t>(first);
    slab.end[2] = window.begin[2] + static_cast<std::int32_t>(last);
    for (const Sphere& ball : balls) {
      poll(4);
      detail::visit_rows(spacing, ball, slab, [&](std::int32_t j, std::int32_t k, Run run) {
        poll(4);
        covered[static_cast<std::size_t>(k - slab.begin[2])].set(j, run);
      });
    }
    for (std::size_t s = 0; s < covered.size(); ++s) visit(slab.begin[2] + static_cast<std::int32_t>(s), covered[s]);
  });
}

// Bits [begin, begin + 64) of a row of the grid, for any begin; 0 beyond it.
std::uint64_t word_at(std::span<const std::uint64_t> row, std::int64_t begin) {
  const auto word = [&](std::int64_t w) {
    return w >= 0 && w < static_cast<std::int64_t>(row.size()) ? row[static_cast<std::size_t>(w)] : 0;
  };
  const std::int64_t w = begin >= 0 ? begin / 64 : -((-begin + 63) / 64);
  const auto shift = static_cast<unsigned>(begin - 64 * w);
  return shift == 0 ? word(w) : word(w) >> shift | word(w + 1) << (64 - shift);
}

// Adds one covered row to the counts.
void count_row(std::span<const std::uint64_t> covered, const SampledObject& object, const Window& window,
               std::int32_t j, std::int32_t k, Overlap& overlap) {
  const Grid& grid = object.grid;
  const bool in_grid = j >= 0 && j < grid.dims[1] && k >= 0 && k < grid.dims[2];
  if (!in_grid && object.border == Border::open) return;
  for (std::size_t w = 0; w < covered.size(); ++w) {
    if (covered[w] == 0) continue;
    const std::int64_t begin = window.begin[0] + 64 * static_cast<std::int64_t>(w);
    std::uint64_t counted = covered[w];
    if (object.border == Border::open) {
      for (int b = 0; b < 64; ++b) {
        if (begin + b < 0 || begin + b >= grid.dims[0]) counted &= ~(std::uint64_t{1} << b);
      }
    }
    const std::uint64_t inside = in_grid ? word_at(object.inside.row(j, k), begin) : 0;
    overlap.covered += static_cast<std::uint64_t>(std::popcount(counted & inside));
    overlap.spilled += static_cast<std::uint64_t>(std::popcount(counted & ~inside));
  }
}

// Calls visit(i, j, k) for every outside sample in the ball (grid mm), also beyond a closed border, until it returns
// false.
template <typename Visit>
void visit_outside(const Sphere& ball, const SampledObject& object, Poll& poll, Visit&& visit) {
  const Grid& grid = object.grid;
  const Window window =
      object.border == Border::open ? whole(grid) : detail::window_of(grid.spacing, std::span(&ball, 1));
  bool more = true;
  detail::visit_rows(grid.spacing, ball, window, [&](std::int32_t j, std::int32_t k, Run run) {
    const bool in_grid = j >= 0 && j < grid.dims[1] && k >= 0 && k < grid.dims[2];
    poll(4);
    for (std::int64_t begin = run.begin; more && begin < run.end; begin += 64) {
      std::uint64_t outside = in_grid ? ~word_at(object.inside.row(j, k), begin) : ~std::uint64_t{0};
      if (run.end - begin < 64) outside &= ~(~std::uint64_t{0} << (run.end - begin));
      for (; more && outside != 0; outside &= outside - 1) {
        poll();
        more = visit(static_cast<std::int32_t>(begin) + std::countr_zero(outside), j, k);
      }
    }
  });
}

Vec3 sample_at(const Grid& grid, std::int32_t i, std::int32_t j, std::int32_t k) {
  return {i * grid.spacing.x, j * grid.spacing.y, k * grid.spacing.z};
}

}  // namespace

Window detail::window_of(Vec3 spacing, std::span<const Sphere> balls) {
  constexpr std::int32_t limit = 200'000'000;
  Box box;
  for (const Sphere& ball : balls) box.include(ball);
  Window window;
  if (box.empty()) return window;
  for (int a = 0; a < 3; ++a) {
    const Run run = samples_within(1 / spacing[a], 0.5 * (box.min[a] + box.max[a]),
                                   0.5 * (box.max[a] - box.min[a]) + spacing[a], -limit, limit);
    window.begin[static_cast<std::size_t>(a)] = run.begin;
    window.end[static_cast<std::size_t>(a)] = run.end;
  }
  return window;
}

SampleBits detail::held_samples(std::span<const Sphere> balls, Vec3 spacing, const Window& window,
                                const Context& context) {
  SampleBits held({window.size(0), window.size(1), window.size(2)});
  visit_covered(balls, spacing, window, {}, context, [&](std::int32_t k, SliceBits& slice) {
    for (std::int32_t j = window.begin[1]; j < window.end[1]; ++j) {
      std::ranges::copy(slice.row(j), held.row(j - window.begin[1], k - window.begin[2]).begin());
    }
  });
  return held;
}

SampledObject sample_union(std::span<const Sphere> balls, std::size_t samples, const Context& context) {
  SPHERULE_CHECK(!balls.empty());
  Box box;
  for (const Sphere& ball : balls) box.include(ball);
  Vec3 size = box.max - box.min;
  const double longest = std::max({size.x, size.y, size.z, 1e-6});
  // A set in a plane or a line still gets a few samples across.
  for (int a = 0; a < 3; ++a) size[a] = std::max(size[a], 1e-3 * longest);
  const double step = elementary::cbrt(size.x * size.y * size.z / static_cast<double>(samples));
  Grid grid;
  grid.spacing = {step, step, step};
  grid.origin = box.min - Vec3{step / 2, step / 2, step / 2};
  for (int a = 0; a < 3; ++a) grid.dims[static_cast<std::size_t>(a)] = static_cast<std::int32_t>(size[a] / step) + 2;
  return sample_union(balls, grid, context);
}

SampledObject sample_union(std::span<const Sphere> balls, const Grid& grid, const Context& context) {
  return {.grid = grid, .inside = detail::held_samples(in_grid(balls, grid), grid.spacing, whole(grid), context)};
}

SampledObject subsampled(const SampledObject& object, std::array<std::int32_t, 3> steps, const Context& context) {
  SampledObject result{.grid = object.grid, .inside = {}, .border = object.border};
  for (std::size_t a = 0; a < 3; ++a) {
    SPHERULE_CHECK(steps[a] >= 1);
    result.grid.dims[a] = (object.grid.dims[a] + steps[a] - 1) / steps[a];
    result.grid.spacing[static_cast<int>(a)] *= steps[a];
  }
  result.inside = SampleBits(result.grid.dims);
  Poll poll(context);
  for (std::int32_t k = 0; k < result.grid.dims[2]; ++k) {
    for (std::int32_t j = 0; j < result.grid.dims[1]; ++j) {
      poll(static_cast<std::uint64_t>(result.grid.dims[0]));
      const auto row = result.inside.row(j, k);
      for (std::int32_t i = 0; i < result.grid.dims[0]; ++i) {
        if (object.inside.test(i * steps[0], j * steps[1], k * steps[2])) {
          row[static_cast<std::size_t>(i) / 64] |= std::uint64_t{1} << (i % 64);
        }
      }
    }
  }
  return result;
}

Overlap measure_overlap(std::span<const Sphere> balls, const SampledObject& object, const Context& context) {
  Overlap overlap{.inside = object.inside.count()};
  const std::vector<Sphere> local = in_grid(balls, object.grid);
  const Window window = detail::window_of(object.grid.spacing, local);
  std::vector<Overlap> slices(static_cast<std::size_t>(window.size(2)));
  visit_covered(local, object.grid.spacing, window, "overlap", context, [&](std::int32_t k, SliceBits& slice) {
    Overlap& counts = slices[static_cast<std::size_t>(k - window.begin[2])];
    for (std::int32_t j = window.begin[1]; j < window.end[1]; ++j)
      count_row(slice.row(j), object, window, j, k, counts);
  });
  for (const Overlap& slice : slices) {
    overlap.covered += slice.covered;
    overlap.spilled += slice.spilled;
  }
  return overlap;
}

bool never_spills(std::span<const Sphere> balls, const SampledObject& object, const Context& context) {
  std::atomic<bool> spills{false};
  parallel_for(context, {}, balls.size(), 64, [&](std::size_t begin, std::size_t end) {
    Poll poll(context);
    for (std::size_t b = begin; b < end && !spills; ++b) {
      Sphere ball = detail::to_grid(object.grid, balls[b]);
      ball.radius += detail::rounding_bound(object.grid, balls[b]);
      visit_outside(ball, object, poll, [&](std::int32_t, std::int32_t, std::int32_t) {
        spills = true;
        return false;
      });
    }
  });
  return !spills;
}

std::vector<std::array<std::int32_t, 3>> not_covered(std::span<const Sphere> balls, const SampledObject& object,
                                                     const Context& context) {
  std::vector<Sphere> safe;
  for (const Sphere& ball : balls) {
    Sphere local = detail::to_grid(object.grid, ball);
    local.radius -= detail::rounding_bound(object.grid, ball);
    if (local.radius > 0) safe.push_back(local);
  }
  std::vector<std::vector<std::array<std::int32_t, 3>>> missing(static_cast<std::size_t>(object.grid.dims[2]));
  visit_covered(safe, object.grid.spacing, whole(object.grid), {}, context, [&](std::int32_t k, SliceBits& slice) {
    for (std::int32_t j = 0; j < object.grid.dims[1]; ++j) {
      const auto have = slice.row(j);
      const auto want = object.inside.row(j, k);
      for (std::size_t w = 0; w < want.size(); ++w) {
        for (std::uint64_t bits = want[w] & ~have[w]; bits != 0; bits &= bits - 1) {
          missing[static_cast<std::size_t>(k)].push_back(
              {static_cast<std::int32_t>(64 * w) + std::countr_zero(bits), j, k});
        }
      }
    }
  });
  std::vector<std::array<std::int32_t, 3>> all;
  for (const auto& slice : missing) all.insert(all.end(), slice.begin(), slice.end());
  return all;
}

bool covers_all(std::span<const Sphere> balls, const SampledObject& object, const Context& context) {
  return not_covered(balls, object, context).empty();
}

Sphere cut_to_object(const Sphere& ball, const SampledObject& object, const Context& context) {
  context.throw_if_cancelled();  // it is called for thousands of balls, each of them short
  Poll poll(context);
  const double bound = detail::rounding_bound(object.grid, ball);
  Sphere local = detail::to_grid(object.grid, ball);
  local.radius += 2 * bound;
  double least = local.radius;
  visit_outside(local, object, poll, [&](std::int32_t i, std::int32_t j, std::int32_t k) {
    least = std::min(least, norm(sample_at(object.grid, i, j, k) - local.centre));
    return true;
  });
  return {ball.centre, std::max(least - 2 * bound, 0.0)};
}

double radius_to_reach(Vec3 centre, double radius, std::array<std::int32_t, 3> sample, const SampledObject& object) {
  const double far =
      norm(sample_at(object.grid, sample[0], sample[1], sample[2]) - detail::to_grid(object.grid, centre));
  return std::max(radius, far + 2 * detail::rounding_bound(object.grid, {centre, far}));
}

}  // namespace spherule
