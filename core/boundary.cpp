// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/boundary.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <numeric>

#include "core/base/check.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/crossings.h"

namespace spherule {

namespace {

constexpr std::size_t kRowsPerPiece = 64;

// The crossed grid edges, 64 at a time. Row (j, k) owns the edges that start in it: along x inside the row, along y to
// row (j + 1, k), along z to row (j, k + 1). With a closed border the rows start at -1 and everything beyond the grid
// is outside.
class CrossedEdges {
 public:
  CrossedEdges(const InsideSamples& samples, Border border)
      : inside_(samples.inside),
        above_(samples.above),
        not_finite_(samples.not_finite),
        closed_(border == Border::closed),
        first_(closed_ ? -1 : 0),
        outside_(samples.inside.words_per_row(), 0) {}

  std::size_t row_count() const { return extent(1) * extent(2); }

  // Calls words(axis, i, j, k, once, twice): bit b stands for the edge from sample (i + b, j, k) to the next one along
  // axis; `once` edges have ends that differ, `twice` edges jump over a range.
  template <typename Words>
  void visit_row(std::size_t row, Words words) const {
    const auto j = static_cast<std::int32_t>(row % extent(1)) + first_;
    const auto k = static_cast<std::int32_t>(row / extent(1)) + first_;
    if (j >= 0 && k >= 0) along_row(j, k, words);
    if (k >= 0) between_rows(1, j, k, j + 1, k, words);
    if (j >= 0) between_rows(2, j, k, j, k + 1, words);
  }

 private:
  std::size_t extent(std::size_t axis) const { return static_cast<std::size_t>(inside_.dims()[axis] - first_); }
  bool has_range() const { return above_.words_per_row() != 0; }
  // The samples of a word without a finite value, and the edges along the row that touch one.
  std::uint64_t gaps(std::int32_t j, std::int32_t k, std::size_t w) const {
    return w < not_finite_.words_per_row() ? not_finite_.row(j, k)[w] : 0;
  }
  std::uint64_t edges_at_gaps(std::int32_t j, std::int32_t k, std::size_t w) const {
    return gaps(j, k, w) | gaps(j, k, w) >> 1 | gaps(j, k, w + 1) << 63;
  }
  bool in_grid(std::int32_t j, std::int32_t k) const {
    return j >= 0 && k >= 0 && j < inside_.dims()[1] && k < inside_.dims()[2];
  }
  std::span<const std::uint64_t> row_of(const SampleBits& bits, std::int32_t j, std::int32_t k) const {
    return in_grid(j, k) ? bits.row(j, k) : std::span<const std::uint64_t>(outside_);
  }

  // A row against itself moved by one sample. The bit past the end is 0: outside, as a closed border wants it.
  static std::uint64_t changes(std::span<const std::uint64_t> row, std::size_t w) {
    const std::uint64_t carry = w + 1 < row.size() ? row[w + 1] << 63 : 0;
    return row[w] ^ ((row[w] >> 1) | carry);
  }

  template <typename Words>
  void along_row(std::int32_t j, std::int32_t k, Words& words) const {
    const auto inside = inside_.row(j, k);
    if (closed_ && (inside[0] & 1)) words(0, -1, j, k, std::uint64_t{1}, std::uint64_t{0});
    for (std::size_t w = 0; w < inside.size(); ++w) {
      const std::size_t left = static_cast<std::size_t>(inside_.dims()[0]) - 64 * w;
      const std::uint64_t within = left > 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << (left - 1)) - 1;
      const std::uint64_t differ = changes(inside, w);
      const std::uint64_t once = closed_ ? differ : differ & within;
      const std::uint64_t twice =
          has_range() ? changes(above_.row(j, k), w) & ~differ & within & ~edges_at_gaps(j, k, w) : 0;
      if (once | twice) words(0, static_cast<std::int32_t>(64 * w), j, k, once, twice);
    }
  }

  template <typename Words>
  void between_rows(int axis, std::int32_t j, std::int32_t k, std::int32_t j2, std::int32_t k2, Words& words) const {
    const bool within = in_grid(j, k) && in_grid(j2, k2);
    if (!closed_ && !within) return;
    const auto a = row_of(inside_, j, k), b = row_of(inside_, j2, k2);
    for (std::size_t w = 0; w < a.size(); ++w) {
      const std::uint64_t once = a[w] ^ b[w];
      const std::uint64_t twice = within && has_range() ? (above_.row(j, k)[w] ^ above_.row(j2, k2)[w]) & ~once &
                                                              ~(gaps(j, k, w) | gaps(j2, k2, w))
                                                        : 0;
      if (once | twice) words(axis, static_cast<std::int32_t>(64 * w), j, k, once, twice);
    }
  }

  const SampleBits& inside_;
  const SampleBits& above_;
  const SampleBits& not_finite_;
  bool closed_;
  std::int32_t first_;
  std::vector<std::uint64_t> outside_;
};

// Where the line from value a at coordinate pa to value b at pb takes the value `iso`, which lies in [a, b] or [b, a];
// at least one unit from either end.
std::int32_t crossing_coordinate(double a, double b, double iso, std::int32_t pa, std::int32_t pb) {
  double t = (iso - a) / (b - a);
  if (!std::isfinite(b - a)) t = (iso / 2 - a / 2) / (b / 2 - a / 2);
  return std::clamp(pa + static_cast<std::int32_t>(std::lround(t * (pb - pa))), pa + 1, pb - 1);
}

class CrossingPlacer {
 public:
  CrossingPlacer(const Volume& volume, const ObjectRule& rule, const Lattice& lattice)
      : volume_(volume), rule_(rule), lattice_(lattice) {}

  // One crossing, on the edge from sample (i, j, k) to the next one along axis.
  LatticePoint once(int axis, std::array<std::int32_t, 3> from) const {
    const auto [pa, pb] = ends(axis, from);
    const auto n = volume_.grid.dims[static_cast<std::size_t>(axis)];
    const auto at = from[static_cast<std::size_t>(axis)];
    // Labels have no values in between, samples beyond the border and those that are not finite have none: half way.
    const LatticePoint half_way = place(axis, from, pa + (pb - pa) / 2);
    if (rule_.kind == ObjectRule::Kind::labels || at < 0 || at + 1 >= n) return half_way;
    const auto [a, b] = values(axis, from);
    if (!std::isfinite(a) || !std::isfinite(b)) return half_way;
    double iso = rule_.lo;
    if (rule_.kind == ObjectRule::Kind::range && std::max(a, b) > rule_.hi) iso = rule_.hi;
    return place(axis, from, crossing_coordinate(a, b, iso, pa, pb));
  }

  // Both crossings of an edge that jumps over the range, kept at least a unit apart.
  std::array<LatticePoint, 2> twice(int axis, std::array<std::int32_t, 3> from) const {
    const auto [pa, pb] = ends(axis, from);
    const auto [a, b] = values(axis, from);
    std::int32_t p = crossing_coordinate(a, b, a < b ? rule_.lo : rule_.hi, pa, pb);
    std::int32_t q = crossing_coordinate(a, b, a < b ? rule_.hi : rule_.lo, pa, pb);
    if (p == q) (q + 1 < pb ? q : p) += q + 1 < pb ? 1 : -1;
    return {place(axis, from, p), place(axis, from, q)};
  }

 private:
  std::array<std::int32_t, 2> ends(int axis, std::array<std::int32_t, 3> from) const {
    const auto at = from[static_cast<std::size_t>(axis)];
    return {lattice_.plane(axis, at), lattice_.plane(axis, at + 1)};
  }
  std::array<double, 2> values(int axis, std::array<std::int32_t, 3> from) const {
    auto to = from;
    ++to[static_cast<std::size_t>(axis)];
    return {value_at(volume_, from[0], from[1], from[2]), value_at(volume_, to[0], to[1], to[2])};
  }
  LatticePoint place(int axis, std::array<std::int32_t, 3> from, std::int32_t coordinate) const {
    return {axis == 0 ? coordinate : lattice_.plane(0, from[0]), axis == 1 ? coordinate : lattice_.plane(1, from[1]),
            axis == 2 ? coordinate : lattice_.plane(2, from[2])};
  }

  const Volume& volume_;
  const ObjectRule& rule_;
  const Lattice& lattice_;
};

// An inside sample in the outermost layer: the object may go on beyond the scan.
bool touches_border(const SampleBits& inside) {
  const auto [nx, ny, nz] = inside.dims();
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      const auto row = inside.row(j, k);
      const bool whole_row = j == 0 || k == 0 || j + 1 == ny || k + 1 == nz;
      if (whole_row ? std::ranges::any_of(row, [](std::uint64_t w) { return w != 0; })
                    : inside.test(0, j, k) || inside.test(nx - 1, j, k))
        return true;
    }
  }
  return false;
}

[[maybe_unused]] bool all_different(std::vector<LatticePoint> points) {
  std::ranges::sort(points);
  return std::ranges::adjacent_find(points) == points.end();
}

// Where the crossings of each piece of rows begin, and how many there are.
std::vector<std::size_t> first_of_pieces(const CrossedEdges& edges, const Context& context) {
  const std::size_t rows = edges.row_count();
  std::vector<std::size_t> start((rows + kRowsPerPiece - 1) / kRowsPerPiece + 1, 0);
  parallel_for(context, {}, rows, kRowsPerPiece, [&](std::size_t begin, std::size_t end) {
    std::size_t n = 0;
    for (std::size_t r = begin; r < end; ++r) {
      edges.visit_row(r, [&](int, std::int32_t, std::int32_t, std::int32_t, std::uint64_t once, std::uint64_t twice) {
        n += static_cast<std::size_t>(std::popcount(once) + 2 * std::popcount(twice));
      });
    }
    start[begin / kRowsPerPiece + 1] = n;
  });
  std::partial_sum(start.begin(), start.end(), start.begin());
  return start;
}

}  // namespace

std::size_t count_boundary_points(const InsideSamples& samples, Border border, const Context& context) {
  return first_of_pieces(CrossedEdges(samples, border), context).back();
}

BoundaryPoints extract_boundary(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                                std::size_t max_points, const Context& context) {
  SPHERULE_CHECK(samples.inside.dims() == volume.grid.dims);
  BoundaryPoints boundary{
      .lattice = make_lattice(volume.grid), .points = {}, .touches_border = touches_border(samples.inside)};
  const CrossedEdges edges(samples, rule.border);
  const std::size_t rows = edges.row_count();
  const std::vector<std::size_t> start = first_of_pieces(edges, context);
  const std::size_t crossings = start.back();
  if (crossings > max_points) {
    throw Error(ErrorCode::too_large, "The object's surface has " + std::to_string(crossings) +
                                          " boundary points, more than the limit of " + std::to_string(max_points) +
                                          "; choose another threshold or a coarser volume.");
  }

  boundary.points.resize(crossings);
  const CrossingPlacer placer(volume, rule, boundary.lattice);
  parallel_for(context, "boundary", rows, kRowsPerPiece, [&](std::size_t begin, std::size_t end) {
    const std::size_t piece = begin / kRowsPerPiece;
    auto out = boundary.points.begin() + static_cast<std::ptrdiff_t>(start[piece]);
    Poll poll(context);
    for (std::size_t r = begin; r < end; ++r) {
      edges.visit_row(
          r, [&](int axis, std::int32_t i, std::int32_t j, std::int32_t k, std::uint64_t once, std::uint64_t twice) {
            for (std::uint64_t rest = once | twice; rest != 0; rest &= rest - 1) {
              poll(4);
              const int bit = std::countr_zero(rest);
              const std::array<std::int32_t, 3> from{i + bit, j, k};
              if ((twice >> bit) & 1) {
                out = std::ranges::copy(placer.twice(axis, from), out).out;
              } else {
                *out++ = placer.once(axis, from);
              }
            }
          });
    }
    SPHERULE_DCHECK(out == boundary.points.begin() + static_cast<std::ptrdiff_t>(start[piece + 1]));
  });

  SPHERULE_AUDIT(all_different(boundary.points));
  return boundary;
}

}  // namespace spherule
