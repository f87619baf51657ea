// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/compare/marching_cubes.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <limits>
#include <span>
#include <utility>

#include "core/base/check.h"
#include "core/base/int128.h"
#include "core/base/parallel.h"
#include "core/base/poll.h"
#include "core/predicates.h"

namespace spherule {

namespace {

// Corner c of a cell is its lowest sample moved by (c & 1, c >> 1 & 1, c >> 2). Edges 0 … 3 go along x, 4 … 7 along y,
// 8 … 11 along z, each from its lower corner on.
constexpr unsigned edge_between(unsigned p, unsigned q) {
  const unsigned low = p & q;
  switch (p ^ q) {
    case 1: return low >> 1;
    case 2: return 4 + ((low & 1) | (low >> 1 & 2));
    default: return 8 + low;
  }
}

// Counter-clockwise as seen from outside the cell.
constexpr std::array<std::array<unsigned, 4>, 6> kFaces{
    {{0, 4, 6, 2}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 2, 3, 1}, {4, 5, 7, 6}}};

constexpr unsigned kNone = 255;
// A crossing is named by its edge; the second surface of a range adds 12.
constexpr unsigned kCrossings = 24;
using Successors = std::array<unsigned, kCrossings>;

constexpr Successors no_successors() {
  Successors next{};
  next.fill(kNone);
  return next;
}

// Seen from outside, the cell's surface runs on a face from where the face's outline enters the object to where it
// leaves it: to the next such place, which cuts every inside arc of the outline off, or to the one before, which joins
// two inside arcs.
struct Outline {
  std::array<unsigned, 8> crossing{};
  unsigned count = 0;
  bool first_enters = false;

  void add(unsigned id, bool enters) {
    if (count == 0) first_enters = enters;
    crossing[count++] = id;
  }
  void link(Successors& next, bool joined) const {
    for (unsigned m = first_enters ? 0 : 1; m < count; m += 2) {
      next[crossing[m]] = crossing[(m + (joined ? count - 1 : 1)) % count];
    }
  }
};

Outline outline_of(const std::array<unsigned, 4>& face, unsigned inside, unsigned offset = 0) {
  Outline outline;
  for (unsigned m = 0; m < 4; ++m) {
    const unsigned p = face[m], q = face[(m + 1) % 4];
    const bool enters = (inside >> q) & 1;
    if (((inside >> p) & 1) != enters) outline.add(edge_between(p, q) + offset, enters);
  }
  return outline;
}

// The triangles of one cell.
struct Patch {
  unsigned count = 0;
  std::array<std::array<std::uint8_t, 3>, kCrossings> triangles{};
};

bool on_one_face(unsigned crossing, unsigned other) {
  return std::ranges::any_of(kFaces, [&](const auto& face) {
    const auto has = [&](unsigned edge) {
      for (unsigned m = 0; m < 4; ++m) {
        if (edge_between(face[m], face[(m + 1) % 4]) == edge % 12) return true;
      }
      return false;
    };
    return has(crossing) && has(other);
  });
}

// Cuts a loop, smallest name first, into triangles with as few diagonals in faces of the cell as can be: there the
// neighbour might cut along the same line. A loop and its reverse are cut alike, so an object and the rest have the
// same surface.
void triangulate(std::span<unsigned> loop, Patch& patch) {
  const auto n = static_cast<unsigned>(loop.size());
  const bool reversed = loop[n - 1] < loop[1];
  if (reversed) std::ranges::reverse(loop.subspan(1));
  std::array<std::array<unsigned, kCrossings>, kCrossings> cost{}, apex{};
  for (unsigned length = 2; length < n; ++length) {
    for (unsigned a = 0; a + length < n; ++a) {
      const unsigned b = a + length;
      cost[a][b] = kNone;
      for (unsigned c = a + 1; c < b; ++c) {
        if (const unsigned sum = cost[a][c] + cost[c][b]; sum < cost[a][b]) cost[a][b] = sum, apex[a][b] = c;
      }
      if (length + 1 < n && on_one_face(loop[a], loop[b])) ++cost[a][b];
    }
  }
  std::array<std::array<unsigned, 2>, kCrossings> todo{{{0, n - 1}}};
  for (unsigned left = 1; left > 0;) {
    const auto [a, b] = todo[--left];
    if (b - a < 2) continue;
    const unsigned c = apex[a][b];
    auto& triangle = patch.triangles[patch.count++];
    triangle = {static_cast<std::uint8_t>(loop[a]), static_cast<std::uint8_t>(loop[c]),
                static_cast<std::uint8_t>(loop[b])};
    if (reversed) std::swap(triangle[1], triangle[2]);
    todo[left++] = {a, c};
    todo[left++] = {c, b};
  }
}

Patch patch_of(Successors next) {
  Patch patch;
  for (unsigned first = 0; first < kCrossings; ++first) {
    std::array<unsigned, kCrossings> loop{};
    unsigned n = 0;
    for (unsigned at = first; next[at] != kNone;) {
      loop[n++] = at;
      at = std::exchange(next[at], kNone);
    }
    if (n > 2) triangulate(std::span(loop).first(n), patch);
  }
  return patch;
}

// All ways to cut a cell at one iso-value: by which corners are inside and, for every face that can be cut in two
// ways, whether its inside corners are joined.
class Cuts {
 public:
  Cuts() {
    for (unsigned inside = 0; inside < 256; ++inside) {
      first_[inside] = patches_.size();
      for (unsigned f = 0; f < 6; ++f) {
        if (outline_of(kFaces[f], inside).count == 4) ambiguous_[inside] |= 1U << f;
      }
      const auto count = static_cast<unsigned>(std::popcount(ambiguous_[inside]));
      for (unsigned joined = 0; joined < 1U << count; ++joined) {
        Successors next = no_successors();
        unsigned decided = 0;
        for (unsigned f = 0; f < 6; ++f) {
          const bool open = (ambiguous_[inside] >> f) & 1;
          outline_of(kFaces[f], inside).link(next, open && ((joined >> decided) & 1));
          decided += open;
        }
        patches_.push_back(patch_of(next));
      }
    }
  }

  // joined(f) decides face f.
  template <typename Joined>
  const Patch& find(unsigned inside, Joined joined) const {
    std::size_t at = 0;
    unsigned decision = 0;
    for (unsigned rest = ambiguous_[inside]; rest != 0; rest &= rest - 1) {
      at |= std::size_t{joined(static_cast<unsigned>(std::countr_zero(rest)))} << decision++;
    }
    return patches_[first_[inside] + at];
  }

 private:
  std::array<std::size_t, 256> first_{};
  std::array<unsigned, 256> ambiguous_{};
  std::vector<Patch> patches_;
};

const Cuts& cuts() {
  static const Cuts all;
  return all;
}

// ------------------------------------------------------------------------------------------------------------- cells

constexpr std::size_t kPlanesPerPiece = 4;

struct Vertex {
  std::uint32_t index;
  LatticePoint at;
};

// The cells of a grid with one outside sample beyond each end of every axis; indices here count from those. Under
// an open border the crossings of the outermost edges are not boundary points; they are put on the last samples, so
// that the outermost cells draw the cut.
class Cells {
 public:
  Cells(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples, const BoundaryPoints& boundary,
        const Context& context)
      : context_(context),
        volume_(volume),
        rule_(rule),
        boundary_(boundary),
        complement_(rule.side == Side::below),
        inside_(padded(samples.inside)),
        nx_(inside_.dims()[0]),
        ny_(inside_.dims()[1]),
        nz_(inside_.dims()[2]) {
    SPHERULE_CHECK(samples.inside.dims() == volume.grid.dims);
    if (rule.kind == ObjectRule::Kind::range) above_ = padded(samples.above);
    if (samples.not_finite.words_per_row() != 0) not_finite_ = padded(samples.not_finite);
    plane_start_.assign(static_cast<std::size_t>(nz_) + 1, 0);
    Poll poll(context);
    for (std::int32_t k = 0; k < nz_; ++k) {
      std::size_t n = 0;
      for_each_crossed(k, poll, [&](int, std::int32_t, std::int32_t, bool twice, bool is_point) {
        n += is_point ? 1 + twice : 0;
        cut_ends_ += !is_point;
      });
      plane_start_[static_cast<std::size_t>(k) + 1] = plane_start_[static_cast<std::size_t>(k)] + n;
    }
    SPHERULE_CHECK(plane_start_.back() == boundary.points.size());
  }

  std::size_t planes() const { return static_cast<std::size_t>(nz_) - 1; }
  // Crossings that an open border leaves out of the boundary points.
  std::uint64_t cut_ends() const { return cut_ends_; }

  // Calls triangle(a, b, c, in_grid) for cells in planes [begin, end), in ascending order of (z, y, x).
  template <typename Triangle>
  void visit(std::size_t begin, std::size_t end, Triangle triangle) const {
    Plane low(*this), high(*this);
    Poll poll(context_);
    high.fill(static_cast<std::int32_t>(begin), poll);
    for (auto k = static_cast<std::int32_t>(begin); k < static_cast<std::int32_t>(end); ++k) {
      std::swap(low, high);
      high.fill(k + 1, poll);
      for (std::int32_t j = 0; j + 1 < ny_; ++j) visit_row(j, k, low, high, poll, triangle);
    }
  }

 private:
  enum State : std::uint8_t { below, within, above, beyond };  // beyond: of the grid, or of finite numbers

  // For every crossed edge that starts in one plane: the index of its (first) boundary point.
  struct Plane {
    explicit Plane(const Cells& cells) : of(&cells) {
      for (auto& axis : first) axis.resize(static_cast<std::size_t>(cells.nx_) * static_cast<std::size_t>(cells.ny_));
    }
    void fill(std::int32_t k, Poll& poll) {
      auto next = static_cast<std::uint32_t>(of->plane_start_[static_cast<std::size_t>(k)]);
      of->for_each_crossed(k, poll, [&](int axis, std::int32_t i, std::int32_t j, bool twice, bool is_point) {
        first[static_cast<std::size_t>(axis)][of->at(i, j)] = next;
        next += is_point ? 1 + twice : 0;
      });
    }
    const Cells* of;
    std::array<std::vector<std::uint32_t>, 3> first;
  };

  std::size_t at(std::int32_t i, std::int32_t j) const {
    return static_cast<std::size_t>(j) * static_cast<std::size_t>(nx_) + static_cast<std::size_t>(i);
  }
  bool in_grid(std::int32_t i, std::int32_t j, std::int32_t k) const {
    return i > 0 && j > 0 && k > 0 && i + 1 < nx_ && j + 1 < ny_ && k + 1 < nz_;
  }

  static std::uint64_t moved_down(std::span<const std::uint64_t> row, std::size_t w) {
    return (row[w] >> 1) | (w + 1 < row.size() ? row[w + 1] << 63 : 0);
  }
  // Bits [first, last) of word w.
  static std::uint64_t span_mask(std::size_t w, std::int32_t first, std::int32_t last) {
    const auto from = std::clamp<std::int64_t>(first - static_cast<std::int64_t>(64 * w), 0, 64);
    const auto to = std::clamp<std::int64_t>(last - static_cast<std::int64_t>(64 * w), 0, 64);
    if (from >= to) return 0;
    return (to == 64 ? ~std::uint64_t{0} : (std::uint64_t{1} << to) - 1) & (~std::uint64_t{0} << from);
  }

  // Calls crossed(axis, i, j, twice, is_point) for the crossed edges that start in plane k, in the order of the
  // boundary points.
  template <typename Crossed>
  void for_each_crossed(std::int32_t k, Poll& poll, Crossed crossed) const {
    for (std::int32_t j = 0; j < ny_; ++j) {
      const auto row = inside_.row(j, k);
      for (int axis = 0; axis < 3; ++axis) {
        const std::int32_t j2 = j + (axis == 1), k2 = k + (axis == 2);
        if (j2 == ny_ || k2 == nz_) continue;
        const bool rows_in_grid = j > 0 && k > 0 && j2 + 1 < ny_ && k2 + 1 < nz_;
        poll(4 * row.size());
        for (std::size_t w = 0; w < row.size(); ++w) {
          const auto differences = [&](const SampleBits& bits) {
            return bits.row(j, k)[w] ^ (axis == 0 ? moved_down(bits.row(j, k), w) : bits.row(j2, k2)[w]);
          };
          const std::uint64_t once = differences(inside_);
          const std::uint64_t grid = rows_in_grid ? span_mask(w, 1, nx_ - 1 - (axis == 0)) : 0;
          std::uint64_t twice = is_range() ? differences(above_) & ~once & grid : 0;
          if (not_finite_.words_per_row() != 0) {
            const auto gaps = not_finite_.row(j, k);
            twice &= ~(gaps[w] | (axis == 0 ? moved_down(gaps, w) : not_finite_.row(j2, k2)[w]));
          }
          for (std::uint64_t rest = once | twice; rest != 0; rest &= rest - 1) {
            poll();
            const int bit = std::countr_zero(rest);
            const bool is_point = rule_.border == Border::closed || ((grid >> bit) & 1);
            crossed(axis, static_cast<std::int32_t>(64 * w) + bit, j, ((twice >> bit) & 1) != 0, is_point);
          }
        }
      }
    }
  }

  bool is_range() const { return above_.words_per_row() != 0; }

  template <typename Triangle>
  void visit_row(std::int32_t j, std::int32_t k, const Plane& low, const Plane& high, Poll& poll,
                 Triangle& triangle) const {
    poll(16 * inside_.words_per_row());
    const std::array<std::array<std::int32_t, 2>, 4> rows{{{j, k}, {j + 1, k}, {j, k + 1}, {j + 1, k + 1}}};
    const bool row_in_grid = j > 0 && k > 0 && j + 2 < ny_ && k + 2 < nz_;
    for (std::size_t w = 0; w < inside_.words_per_row(); ++w) {
      std::uint64_t active = 0;
      std::array<std::uint64_t, 8> bits{};
      const auto gather = [&](const SampleBits& from) {
        std::uint64_t any = 0, all = ~std::uint64_t{0};
        for (std::size_t r = 0; r < 4; ++r) {
          const auto row = from.row(rows[r][0], rows[r][1]);
          bits[2 * r] = row[w], bits[2 * r + 1] = moved_down(row, w);
          any |= bits[2 * r] | bits[2 * r + 1], all &= bits[2 * r] & bits[2 * r + 1];
        }
        return any & ~all;
      };
      if (is_range()) active |= gather(above_);
      active |= gather(inside_);
      active &= span_mask(w, 0, nx_ - 1);
      for (; active != 0; active &= active - 1) {
        const int bit = std::countr_zero(active);
        unsigned inside = 0;
        for (unsigned c = 0; c < 8; ++c) inside |= static_cast<unsigned>((bits[c] >> bit) & 1) << c;
        visit_cell({static_cast<std::int32_t>(64 * w) + bit, j, k}, inside, row_in_grid, low, high, triangle);
      }
    }
  }

  template <typename Triangle>
  void visit_cell(std::array<std::int32_t, 3> cell, unsigned inside, bool row_in_grid, const Plane& low,
                  const Plane& high, Triangle& triangle) const {
    const bool cell_in_grid = row_in_grid && cell[0] > 0 && cell[0] + 2 < nx_;
    std::array<State, 8> states{};
    if (is_range()) states = states_of(cell);
    const auto draw = [&](const Patch& patch, unsigned offset) {
      for (unsigned t = 0; t < patch.count; ++t) {
        const auto& [a, b, c] = patch.triangles[t];
        triangle(vertex(cell, a + offset, states, low, high), vertex(cell, b + offset, states, low, high),
                 vertex(cell, c + offset, states, low, high), cell_in_grid);
      }
    };
    if (!is_range() || !(holds(states, below) && holds(states, above))) {
      const Surface surface = is_range() && holds(states, above) ? upper() : lower();
      draw(cuts().find(inside, [&](unsigned f) { return joined(cell, inside, kFaces[f], surface); }), surface.offset);
    } else if (!holds(states, beyond)) {
      // Two surfaces that do not meet.
      for (const Surface& surface : {lower(), upper()}) {
        const unsigned side = side_of(states, surface);
        draw(cuts().find(side, [&](unsigned f) { return joined(cell, side, kFaces[f], surface); }), surface.offset);
      }
    } else {
      draw(border_patch(cell, states), 0);
    }
  }

  struct Surface {
    State other;  // of the samples that it parts from all others
    double iso;
    unsigned offset;  // of its crossings' names
  };
  Surface lower() const { return {below, rule_.lo, 0}; }
  Surface upper() const { return {above, rule_.hi, 12}; }

  static bool holds(const std::array<State, 8>& states, State state) {
    return std::ranges::find(states, state) != states.end();
  }

  State state_of(std::int32_t i, std::int32_t j, std::int32_t k) const {
    if (!in_grid(i, j, k)) return beyond;
    if (not_finite_.words_per_row() != 0 && not_finite_.test(i, j, k)) return beyond;
    if (above_.test(i, j, k)) return above;
    return inside_.test(i, j, k) != complement_ ? within : below;
  }
  std::array<State, 8> states_of(std::array<std::int32_t, 3> cell) const {
    std::array<State, 8> states{};
    for (int c = 0; c < 8; ++c) {
      states[static_cast<std::size_t>(c)] = state_of(cell[0] + (c & 1), cell[1] + (c >> 1 & 1), cell[2] + (c >> 2));
    }
    return states;
  }
  bool is_inside(State state) const { return state != beyond && (state == within) != complement_; }

  // The corners on the object's side of one of a range's surfaces.
  unsigned side_of(const std::array<State, 8>& states, const Surface& surface) const {
    unsigned inside = 0;
    for (unsigned c = 0; c < 8; ++c) inside |= ((states[c] == surface.other) == complement_ ? 1U : 0U) << c;
    return inside;
  }

  // Where a range meets a closed border, or samples that are not finite, and is jumped over beside them: faces that
  // reach there cut every inside arc of their outline off, any other face has both surfaces.
  Patch border_patch(std::array<std::int32_t, 3> cell, const std::array<State, 8>& states) const {
    Successors next = no_successors();
    for (const auto& face : kFaces) {
      if (std::ranges::none_of(face, [&](unsigned c) { return states[c] == beyond; })) {
        for (const Surface& surface : {lower(), upper()}) {
          const unsigned side = side_of(states, surface);
          const Outline outline = outline_of(face, side, surface.offset);
          outline.link(next, outline.count == 4 && joined(cell, side, face, surface));
        }
        continue;
      }
      Outline outline;
      for (unsigned m = 0; m < 4; ++m) {
        const unsigned p = face[m], q = face[(m + 1) % 4];
        const unsigned edge = edge_between(p, q);
        if (states[p] == beyond || states[q] == beyond) {
          if (is_inside(states[p]) != is_inside(states[q])) outline.add(edge, is_inside(states[q]));
        } else if (std::min(states[p], states[q]) == below && std::max(states[p], states[q]) == above) {
          const bool up = states[p] == below;
          outline.add(up ? edge : edge + 12, !complement_);
          outline.add(up ? edge + 12 : edge, complement_);
        } else if (states[p] != states[q]) {
          const bool upper = states[p] == above || states[q] == above;
          outline.add(upper ? edge + 12 : edge, is_inside(states[q]));
        }
      }
      outline.link(next, false);
    }
    return patch_of(next);
  }

  // Whether the corners on the object's side of an ambiguous face are joined: whether the bilinear interpolation of its
  // values is inside at its saddle; never where one of them is not finite. Such a face has no sample beyond the grid:
  // those come in pairs that share an edge.
  bool joined(std::array<std::int32_t, 3> cell, unsigned side, const std::array<unsigned, 4>& face,
              const Surface& surface) const {
    if (rule_.kind == ObjectRule::Kind::labels) return true;
    std::array<double, 4> v{};
    for (std::size_t m = 0; m < 4; ++m) {
      const auto c = static_cast<std::int32_t>(face[m]);
      v[m] = value_at(volume_, cell[0] - 1 + (c & 1), cell[1] - 1 + (c >> 1 & 1), cell[2] - 1 + (c >> 2)) - surface.iso;
    }
    if (std::ranges::any_of(v, [](double value) { return !std::isfinite(value); })) return false;
    // One diagonal is on the object's side; the saddle's height has the sign of the difference of the two products.
    double in = v[0] * v[2], out = v[1] * v[3];
    if (!((side >> face[0]) & 1)) std::swap(in, out);
    return complement_ ? in > out : in >= out;
  }

  Vertex vertex(std::array<std::int32_t, 3> cell, unsigned crossing, const std::array<State, 8>& states,
                const Plane& low, const Plane& high) const {
    const unsigned edge = crossing % 12, axis = edge / 4, side = edge % 4;
    const unsigned corner = axis == 0 ? side << 1 : axis == 1 ? (side & 1) | (side & 2) << 1 : side;
    const std::int32_t i = cell[0] + static_cast<std::int32_t>(corner & 1),
                       j = cell[1] + static_cast<std::int32_t>(corner >> 1 & 1),
                       k = cell[2] + static_cast<std::int32_t>(corner >> 2);
    if (rule_.border == Border::open) {
      const std::array<std::int32_t, 3> to{i + (axis == 0), j + (axis == 1), k + (axis == 2)};
      const bool from_in_grid = in_grid(i, j, k);
      if (!from_in_grid || !in_grid(to[0], to[1], to[2])) {
        const auto plane = [&](int a, std::int32_t from) {
          return boundary_.lattice.plane(a, (from_in_grid ? from : to[static_cast<std::size_t>(a)]) - 1);
        };
        return {std::numeric_limits<std::uint32_t>::max(), {plane(0, i), plane(1, j), plane(2, k)}};
      }
    }
    std::uint32_t index = (k == cell[2] ? low : high).first[axis][at(i, j)];
    if (is_range()) {
      // Of two crossings of an edge, that of the surface next to its lower corner comes first.
      const State from = states[corner], to = states[corner | 1U << axis];
      if ((from == below && to == above && crossing >= 12) || (from == above && to == below && crossing < 12)) ++index;
    }
    return {index, boundary_.points[index]};
  }

  const Context& context_;
  const Volume& volume_;
  const ObjectRule& rule_;
  const BoundaryPoints& boundary_;
  bool complement_;
  SampleBits inside_, above_, not_finite_;  // the last is empty unless a range has such samples
  std::int32_t nx_, ny_, nz_;
  std::vector<std::size_t> plane_start_;
  std::uint64_t cut_ends_ = 0;
};

constexpr const char* kStage = "marching cubes";

}  // namespace

Mesh marching_cubes(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                    const BoundaryPoints& boundary, const Context& context) {
  const Cells cells(volume, rule, samples, boundary, context);
  std::vector<std::vector<std::array<std::uint32_t, 3>>> parts((cells.planes() + kPlanesPerPiece - 1) /
                                                               kPlanesPerPiece);
  // Left-handed axes turn every triangle round.
  const bool mirrored = determinant(volume.grid.direction) < 0;
  parallel_for(context, kStage, cells.planes(), kPlanesPerPiece, [&](std::size_t begin, std::size_t end) {
    auto& part = parts[begin / kPlanesPerPiece];
    cells.visit(begin, end, [&](const Vertex& a, const Vertex& b, const Vertex& c, bool in_grid) {
      if (rule.border == Border::open && !in_grid) return;
      part.push_back({a.index, mirrored ? c.index : b.index, mirrored ? b.index : c.index});
    });
  });
  Mesh mesh;
  std::size_t count = 0;
  for (const auto& part : parts) count += part.size();
  mesh.triangles.reserve(count);
  for (auto& part : parts) {
    mesh.triangles.insert(mesh.triangles.end(), part.begin(), part.end());
    part = {};
  }
  mesh.vertices.reserve(boundary.points.size());
  for (const LatticePoint p : boundary.points) mesh.vertices.push_back(boundary.lattice.to_patient(p));
  return mesh;
}

MarchingCubesMeasures measure_marching_cubes(const Volume& volume, const ObjectRule& rule, const InsideSamples& samples,
                                             const BoundaryPoints& boundary, const Context& context) {
  using exact::operator-;
  const Cells cells(volume, rule, samples, boundary, context);
  struct Part {
    Int128 six_volumes = 0;
    double two_areas = 0;
    std::uint64_t triangles = 0, all_triangles = 0;
  };
  std::vector<Part> parts((cells.planes() + kPlanesPerPiece - 1) / kPlanesPerPiece);
  parallel_for(context, kStage, cells.planes(), kPlanesPerPiece, [&](std::size_t begin, std::size_t end) {
    Part& part = parts[begin / kPlanesPerPiece];
    cells.visit(begin, end, [&](const Vertex& a, const Vertex& b, const Vertex& c, bool in_grid) {
      const auto normal = exact::cross(b.at - a.at, c.at - a.at);
      // The flow of (x, 0, 0) through the triangle. Below 2^26 · 2^49 each, and there are fewer than 2^34.
      part.six_volumes += Int128{std::int64_t{a.at.x} + b.at.x + c.at.x} * normal.x;
      ++part.all_triangles;
      if (rule.border == Border::open && !in_grid) return;
      ++part.triangles;
      part.two_areas +=
          norm({static_cast<double>(normal.x), static_cast<double>(normal.y), static_cast<double>(normal.z)});
    });
  });
  Int128 six_volumes = 0;
  double two_areas = 0;
  std::uint64_t all_triangles = 0;
  MarchingCubesMeasures measures;
  for (const Part& part : parts) {
    six_volumes += part.six_volumes;
    two_areas += part.two_areas;
    measures.triangles += part.triangles;
    all_triangles += part.all_triangles;
  }
  const double unit = boundary.lattice.unit_mm;
  measures.volume_mm3 = static_cast<double>(six_volumes) / 6 * unit * unit * unit;
  measures.area_mm2 = two_areas / 2 * unit * unit;
  // A closed surface of loops that span discs: every vertex is met by one ring of them. A loop of n edges, each shared
  // by two loops, makes n - 2 triangles, so V - E + F = V - triangles / 2; a solid has half of its surface's.
  const auto vertices = static_cast<std::int64_t>(boundary.points.size() + cells.cut_ends());
  const std::int64_t twice_surface = 2 * vertices - static_cast<std::int64_t>(all_triangles);
  SPHERULE_CHECK(twice_surface % 4 == 0);
  measures.euler_characteristic = twice_surface / 4;
  return measures;
}

}  // namespace spherule
