// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/blob_cells.h"

#include <algorithm>
#include <cmath>

#include "core/base/parallel.h"

namespace spherule {
namespace {

// Lists of so few fields are not worth a split.
constexpr std::size_t kFewFields = 8;
constexpr int kMostLevels = 16;
// Fields looked at in one level of splits, and cells: about 300 bytes each with their box.
std::size_t most_looks(std::size_t fields) { return (std::size_t{1} << 22) + 64 * fields; }
std::size_t most_cells(std::size_t fields) { return (std::size_t{1} << 17) + 8 * fields; }
// Sums that may be larger in a cube are not made polynomials: what these lose to rounding is this times 2⁻⁵³.
constexpr double kMostSum = 256;
// Bounds are closer than rounding may lose: an inside or outside cube is one beyond doubt.
constexpr double kDoubt = 1e-9;
constexpr double kGrown = 1 + 1e-9;  // of a cube

Vec3 times(const Symmetric& m, Vec3 v) {
  return {m[0] * v.x + m[3] * v.y + m[4] * v.z, m[3] * v.x + m[1] * v.y + m[5] * v.z,
          m[4] * v.x + m[5] * v.y + m[2] * v.z};
}

// The moments of fields of which BlobSum is made, which may be moved to another centre. With d from the centre to a
// field's, s its strength and a = squared_reach - |d|².
struct Moments {
  double s = 0, sa = 0, saa = 0;
  Vec3 sd, sad;
  Symmetric sdd{};

  void add(const BlobField& f, Vec3 centre) {
    const Vec3 d = f.centre - centre;
    const double a = f.squared_reach - squared_norm(d), weighted = f.strength * a;
    s += f.strength, sa += weighted, saa += weighted * a;
    sd = sd + f.strength * d, sad = sad + weighted * d;
    const Symmetric products{d.x * d.x, d.y * d.y, d.z * d.z, d.x * d.y, d.x * d.z, d.y * d.z};
    for (std::size_t i = 0; i < 6; ++i) sdd[i] += f.strength * products[i];
  }

  // About centre + by: d becomes d - by, and a becomes a + 2 d·by - |by|².
  Moments moved(Vec3 by) const {
    const double e = squared_norm(by);
    const Vec3 across = times(sdd, by);
    Moments m;
    m.s = s;
    m.sd = sd - s * by;
    m.sa = sa + 2 * dot(sd, by) - e * s;
    m.saa = saa + 4 * dot(across, by) + e * e * s + 4 * dot(sad, by) - 2 * e * sa - 4 * e * dot(sd, by);
    m.sad = sad + 2.0 * across - e * sd - m.sa * by;
    const Symmetric twice{2 * sd.x * by.x,           2 * sd.y * by.y,           2 * sd.z * by.z,
                          sd.x * by.y + sd.y * by.x, sd.x * by.z + sd.z * by.x, sd.y * by.z + sd.z * by.y};
    const Symmetric own{by.x * by.x, by.y * by.y, by.z * by.z, by.x * by.y, by.x * by.z, by.y * by.z};
    for (std::size_t i = 0; i < 6; ++i) m.sdd[i] = sdd[i] - twice[i] + s * own[i];
    return m;
  }

  BlobSum sum() const {
    BlobSum b{.constant = saa, .fourth = s, .linear = sad, .cube = sd, .square = {}};
    for (std::size_t i = 0; i < 6; ++i) b.square[i] = 4 * sdd[i] - (i < 3 ? 2 * sa : 0);
    return b;
  }
};

struct Bounds {
  double least = 0, most = 0;
};

double magnitude(Vec3 v) { return std::abs(v.x) + std::abs(v.y) + std::abs(v.z); }

// Of a sum in a cube about its centre.
Bounds bounds_of(const BlobSum& b, double half) {
  const double squared = 3 * half * half;
  double across = 0;
  for (std::size_t i = 0; i < 6; ++i) across += (i < 3 ? 1 : 2) * std::abs(b.square[i]);
  const double odd = 4 * half * (magnitude(b.linear) + squared * magnitude(b.cube)) + half * half * across;
  return {b.constant - odd, b.constant + odd + squared * squared * b.fourth};
}

// A cube on its way to become a cell.
struct Draft {
  Vec3 centre;
  double half = 0;
  std::int32_t node = 0;
  Moments whole{};                    // of the fields that reach all of it
  std::vector<std::uint32_t> some{};  // the others that reach it
};

enum class Verdict { outside, inside, surface };

// Squared distances of a cube's nearest and farthest place from a field's centre.
struct Distances {
  double nearest = 0, farthest = 0;
};
Distances squared_distances(const BlobField& f, Vec3 centre, double half) {
  Distances d;
  for (int a = 0; a < 3; ++a) {
    const double offset = std::abs(f.centre[a] - centre[a]);
    const double inner = std::max(0.0, offset - half), outer = offset + half;
    d.nearest += inner * inner, d.farthest += outer * outer;
  }
  return d;
}

// Leaves to the cube's list only fields that reach it, and in part.
Verdict judge(std::span<const BlobField> fields, Draft& cube) {
  const double half = kGrown * cube.half;
  Bounds sum = bounds_of(cube.whole.sum(), half);
  std::size_t kept = 0;
  for (const std::uint32_t i : cube.some) {
    const BlobField& f = fields[i];
    const auto [nearest, farthest] = squared_distances(f, cube.centre, half);
    const double most = f.squared_reach - nearest, least = std::max(0.0, f.squared_reach - farthest);
    if (!(most > 0)) continue;
    sum.most += f.strength * most * most, sum.least += f.strength * least * least;
    if (sum.least >= 1 + kDoubt) return Verdict::inside;
    cube.some[kept++] = i;
  }
  cube.some.resize(kept);
  if (sum.most < 1 - kDoubt) return Verdict::outside;
  if (sum.most > kMostSum) return Verdict::surface;
  std::erase_if(cube.some, [&](std::uint32_t i) {
    const BlobField& f = fields[i];
    if (squared_distances(f, cube.centre, half).farthest > f.squared_reach) return false;
    cube.whole.add(f, cube.centre);
    return true;
  });
  return Verdict::surface;
}

using Eighth = std::pair<Verdict, Draft>;

std::array<Eighth, 8> split(std::span<const BlobField> fields, const Draft& cube) {
  std::array<Eighth, 8> children;
  const double half = cube.half / 2;
  for (std::size_t c = 0; c < 8; ++c) {
    const Vec3 step{c & 1 ? half : -half, c & 2 ? half : -half, c & 4 ? half : -half};
    auto& [verdict, child] = children[c];
    child = {.centre = cube.centre + step, .half = half, .whole = cube.whole.moved(step), .some = cube.some};
    verdict = judge(fields, child);
  }
  return children;
}

class Builder {
 public:
  Builder(std::span<const BlobField> fields, const Context& context) : fields_(fields), context_(context) {}

  BlobCells build() {
    Draft root;
    Box box;
    for (std::uint32_t i = 0; i < fields_.size(); ++i) {
      if (!(fields_[i].squared_ball > 0)) continue;
      box.include(Sphere{fields_[i].centre, std::sqrt(fields_[i].squared_reach)});
      root.some.push_back(i);
    }
    if (root.some.empty()) return std::move(cells_);
    const Vec3 extent = box.max - box.min;
    cells_.centre = root.centre = 0.5 * (box.min + box.max);
    cells_.half = root.half = 0.5 * std::max({extent.x, extent.y, extent.z});
    cells_.nodes.push_back(BlobCells::outside);
    std::vector<Draft> cubes;
    take({judge(fields_, root), std::move(root)}, cubes);
    for (int level = 0; level < kMostLevels && !cubes.empty(); ++level) cubes = split_some(std::move(cubes));
    for (const Draft& cube : cubes) keep(cube);
    return std::move(cells_);
  }

 private:
  // Splits cubes, those with the shortest lists first, as far as the looks of one level go; keeps the others.
  std::vector<Draft> split_some(std::vector<Draft> cubes) {
    std::ranges::stable_sort(cubes, {}, [](const Draft& c) { return c.some.size(); });
    std::size_t count = 0;
    for (std::size_t looks = 0; count < cubes.size(); ++count) {
      looks += 8 * cubes[count].some.size();
      if (looks > most_looks(fields_.size()) ||
          cells_.cells.size() + cubes.size() + 7 * (count + 1) > most_cells(fields_.size()))
        break;
    }
    std::vector<Draft> next;
    constexpr std::size_t kAtOnce = 1024;
    std::vector<std::array<Eighth, 8>> children(std::min(kAtOnce, count));
    for (std::size_t begin = 0; begin < count; begin += kAtOnce) {
      const std::size_t some = std::min(kAtOnce, count - begin);
      parallel_for(context_, {}, some, 4, [&](std::size_t first, std::size_t end) {
        for (std::size_t i = first; i < end; ++i) {
          context_.throw_if_cancelled();
          children[i] = split(fields_, cubes[begin + i]);
        }
      });
      for (std::size_t i = 0; i < some; ++i) {
        const auto node = static_cast<std::int32_t>(cells_.nodes.size());
        cells_.nodes[static_cast<std::size_t>(cubes[begin + i].node)] = node;
        cells_.nodes.resize(cells_.nodes.size() + 8);
        for (std::int32_t c = 0; c < 8; ++c) {
          Eighth& child = children[i][static_cast<std::size_t>(c)];
          child.second.node = node + c;
          take(std::move(child), next);
        }
        cubes[begin + i] = {};
      }
    }
    for (std::size_t i = count; i < cubes.size(); ++i) keep(cubes[i]);
    return next;
  }

  void take(Eighth&& cube, std::vector<Draft>& open) {
    auto& [verdict, draft] = cube;
    cells_.nodes[static_cast<std::size_t>(draft.node)] =
        verdict == Verdict::inside ? BlobCells::inside : BlobCells::outside;
    if (verdict != Verdict::surface) return;
    if (draft.some.size() > kFewFields) {
      draft.some.shrink_to_fit();
      open.push_back(std::move(draft));
    } else {
      keep(draft);
    }
  }
  void keep(const Draft& cube) {
    cells_.nodes[static_cast<std::size_t>(cube.node)] =
        BlobCells::first_cell - static_cast<std::int32_t>(cells_.cells.size());
    cells_.cells.push_back({cube.centre, kGrown * cube.half, cube.whole.sum(),
                            static_cast<std::uint32_t>(cells_.listed.size()),
                            static_cast<std::uint32_t>(cube.some.size())});
    cells_.listed.insert(cells_.listed.end(), cube.some.begin(), cube.some.end());
  }

  std::span<const BlobField> fields_;
  const Context& context_;
  BlobCells cells_;
};

}  // namespace

double BlobSum::value(Vec3 u) const {
  const double squared = squared_norm(u);
  return constant + 4 * dot(linear, u) + dot(times(square, u), u) + squared * (fourth * squared - 4 * dot(cube, u));
}

Vec3 BlobSum::gradient(Vec3 u) const {
  const double squared = squared_norm(u);
  return 4.0 * linear + 2.0 * times(square, u) + (4 * fourth * squared - 8 * dot(cube, u)) * u - 4 * squared * cube;
}

Mat3 BlobSum::hessian(Vec3 u) const {
  const double squared = squared_norm(u), even = 4 * fourth * squared - 8 * dot(cube, u);
  Mat3 h{{Vec3{2 * square[0] + even, 2 * square[3], 2 * square[4]},
          Vec3{2 * square[3], 2 * square[1] + even, 2 * square[5]},
          Vec3{2 * square[4], 2 * square[5], 2 * square[2] + even}}};
  for (int r = 0; r < 3; ++r) {
    Vec3& row = h.rows[static_cast<std::size_t>(r)];
    row = row + 8 * fourth * u[r] * u - 8 * u[r] * cube - 8 * cube[r] * u;
  }
  return h;
}

// Where n fields sum up to 1, one of them is 1/n or more.
Box BlobCells::box(const BlobCell& cell, std::span<const BlobField> fields) const {
  const Vec3 corner{cell.half, cell.half, cell.half};
  const Box cube{cell.centre - corner, cell.centre + corner};
  if (cell.sum.fourth > 0) return cube;
  Box all;
  for (const std::uint32_t i : list(cell)) {
    const BlobField& f = fields[i];
    const double squared = f.squared_reach - std::sqrt((1 - kDoubt) / (cell.count * f.strength));
    if (squared > 0) all.include(Sphere{f.centre, kGrown * std::sqrt(squared)});
  }
  for (int a = 0; a < 3; ++a) {
    all.min[a] = std::max(all.min[a], cube.min[a]), all.max[a] = std::min(all.max[a], cube.max[a]);
    if (all.min[a] > all.max[a]) return {cell.centre, cell.centre};  // no surface here
  }
  return all;
}

BlobCells::Location BlobCells::locate(Vec3 point) const {
  Vec3 u = point - centre;
  if (nodes.empty() || !(std::max({std::abs(u.x), std::abs(u.y), std::abs(u.z)}) <= half)) return {};
  std::int32_t node = nodes[0];
  for (double quarter = half / 2; node >= 0; quarter /= 2) {
    const int child = (u.x > 0 ? 1 : 0) + (u.y > 0 ? 2 : 0) + (u.z > 0 ? 4 : 0);
    u = u - Vec3{u.x > 0 ? quarter : -quarter, u.y > 0 ? quarter : -quarter, u.z > 0 ? quarter : -quarter};
    node = nodes[static_cast<std::size_t>(node + child)];
  }
  if (node <= first_cell) return {.inside = false, .cell = static_cast<std::uint32_t>(first_cell - node)};
  return {.inside = node == inside, .cell = {}};
}

BlobCells blob_cells(std::span<const BlobField> fields, const Context& context) {
  return Builder(fields, context).build();
}

}  // namespace spherule
