// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the methods of simplification reach: overlap and Hausdorff distance on real objects, how well simplified models
// move with their object, and seconds. Prints Markdown tables.
// Usage: bench_simplify [quality | search | cylinder PICTURE.png | stability | speed]; all but the picture without a
// word.
#include <array>
#include <cstdio>
#include <ctime>
#include <fstream>
#include <limits>
#include <numbers>
#include <random>

#include "core/pipeline.h"
#include "core/read/read.h"
#include "core/render/image.h"
#include "core/render/render.h"
#include "core/simplify/best.h"
#include "core/simplify/cover.h"
#include "core/simplify/evaluate.h"
#include "core/simplify/fit.h"
#include "core/simplify/prune.h"
#include "core/simplify/sphericity.h"
#include "core/simplify/splitting.h"
#include "core/simplify/together.h"
#include "tests/bench/scans.h"
#include "tests/phantoms.h"

using namespace spherule;

namespace {

const Context kContext{.threads = 2, .cancel = {}, .progress = {}};

enum class Method : std::uint8_t { sphericity, largest, median, average, prune, best };
constexpr std::array kMethods{Method::sphericity, Method::largest, Method::median,
                              Method::average,    Method::prune,   Method::best};
constexpr std::array kNames{"sphericity", "sphericity, largest", "median", "average", "prune", "best"};

// With the defaults that the program has, but the representative where it is named.
Simplification simplified(Method method, const SphereModel& model, const SampledObject& object, std::uint32_t k) {
  k = std::min(k, static_cast<std::uint32_t>(model.spheres.size()));
  switch (method) {
    case Method::sphericity: return cluster_by_sphericity(model, {.limit = k}, kContext);
    case Method::largest:
      return cluster_by_sphericity(model, {.limit = k, .representative = Representative::largest}, kContext);
    case Method::median: return split_spheres(model, {.at = SplittingOptions::At::median, .k = k}, kContext);
    case Method::average: return split_spheres(model, {.at = SplittingOptions::At::average, .k = k}, kContext);
    case Method::prune: {
      PruneOptions options;
      options.k = k;
      return prune_spheres(model, options, kContext);
    }
    case Method::best: break;
  }
  BestOptions options;
  options.k = k;
  return best_spheres(model, object, options, kContext).simplification;
}

struct Object {
  std::string name;
  Volume volume;
  ObjectRule rule;
};

struct Built {
  SphereModel model;
  SampledObject object;
};

Built build(const Volume& volume, const ObjectRule& rule) {
  return {build_model(volume, rule, {}, kContext).model,
          {.grid = volume.grid, .inside = classify_samples(volume, rule).inside, .border = rule.border}};
}

std::vector<Sphere> few(Method method, const Built& built, std::uint32_t k) {
  return spheres_at(simplified(method, built.model, built.object, k), k);
}

const std::filesystem::path kData = SPHERULE_SHARED_DATA;

bool have(const bench::Scan& scan) {
  if (std::filesystem::exists(kData / scan.file)) return true;
  std::printf("(%s is not there)\n", scan.file.c_str());
  return false;
}

const RawLayout kEngine{.dims = {256, 256, 128}, .type = VoxelType::uint8, .spacing = {1, 1, 1}, .origin = {}};

// ---------------------------------------------------------------------------------------------------------- quality

void quality_of(const std::string& name, const Volume& volume, const ObjectRule& rule) {
  const Built built = build(volume, rule);
  const Reference reference = reference_of(built.model, kContext);
  constexpr std::array<std::uint32_t, 4> levels{16, 64, 256, 1024};
  std::array<std::string, levels.size()> rows;
  for (std::size_t l = 0; l < levels.size(); ++l) rows[l] = "| " + name + " | " + std::to_string(levels[l]) + " |";
  for (const Method method : kMethods) {
    for (std::size_t l = 0; l < levels.size(); ++l) {
      const auto achieved = evaluate(few(method, built, levels[l]), built.object, reference, kContext);
      std::array<char, 64> text{};
      std::snprintf(text.data(), text.size(), " %.3f / %.1f |", achieved.iou,
                    achieved.hausdorff ? 100 * achieved.hausdorff->of_diagonal : 100.0);
      rows[l] += text.data();
    }
  }
  for (const std::string& row : rows) std::printf("%s\n", row.c_str());
  std::fflush(stdout);
}

void quality() {
  std::printf("IoU / Hausdorff distance in %% of the object's diagonal\n\n| object | k |");
  for (const char* name : kNames) std::printf(" %s |", name);
  std::printf("\n| --- | ---: |");
  for (std::size_t i = 0; i < kNames.size(); ++i) std::printf(" ---: |");
  std::printf("\n");
  const Grid cube = phantoms::cubic_grid(64, 64);
  quality_of("ball (phantom)", phantoms::sample(phantoms::ball({0.3, -0.2, 0.1}, 24), cube), phantoms::threshold(0));
  quality_of("torus (phantom)", phantoms::sample(phantoms::torus({0.3, -0.2, 0.1}, 18, 8), cube),
             phantoms::threshold(0));
  quality_of("cube (phantom)", phantoms::sample(phantoms::cube({0.3, -0.2, 0.1}, 20), cube), phantoms::threshold(0));
  const std::vector<std::pair<const char*, bench::Scan>> objects = {
      {"liver", {"abdomen-ct-small-labels.nii.gz", bench::label(5), 0, {}}},
      {"kidney", {"abdomen-ct-small-labels.nii.gz", bench::label(2), 0, {}}},
      {"spleen", {"abdomen-ct-small-labels.nii.gz", bench::label(1), 0, {}}},
      {"head (MR)", {"mr-small.mhd", bench::threshold(30), 0, {}}},
      {"head (CT)", {"ct-head.mhd", bench::threshold(500), 0, {}}},
      {"head (PET)", {"pet.nii", bench::threshold(0.3, Border::open), 0, {}}},
      {"brain (PET)", {"pet.nii", bench::threshold(0.5), 0, {}}},
      {"brain (SPECT)", {"spect.nii", bench::threshold(1000), 0, {}}},
      {"brain (MR)", {"stroke-t1.nii.gz", bench::threshold(60), 0, {}}},
      {"skull (CT)", {"ct-head.mhd", bench::threshold(1150), 0, {}}},
      {"bone (CT)", {"abdomen-ct.nii.gz", bench::threshold(200), 0, {}}},
      {"engine", {"engine.raw", bench::threshold(80), 0, kEngine}},
      {"bonsai", {"bonsai.nii.gz", bench::threshold(80), 0, {}}},
  };
  for (const auto& [name, scan] : objects) {
    if (have(scan)) quality_of(name, bench::read(scan, kData), scan.rule);
  }
  std::printf("\n");
}

// ----------------------------------------------------------------------------------------------------------- search

// What time without end would give: from candidates chosen at random, all balls climb together; then, again and again,
// some of those that are worth least are put where others add most, all climb, and what overlaps more stays.
double searched(const Built& built, std::uint32_t k, std::uint64_t seed, int rounds) {
  constexpr int kLong = 300, kShort = 60;
  std::mt19937_64 random(seed);
  std::vector<Sphere> candidates = detail::thinned(detail::poles(built.model), k);
  for (Sphere& c : candidates) c = detail::to_grid(built.object.grid, c);
  const auto any = [&](std::size_t count) { return static_cast<std::size_t>(random() % count); };
  const auto iou = [&](std::vector<Sphere> balls) {
    for (Sphere& ball : balls) ball.centre = built.object.grid.to_patient(ball.centre);
    return measure_overlap(balls, built.object, kContext).iou();
  };
  std::vector<Sphere> balls;
  while (balls.size() < k) balls.push_back(candidates[any(candidates.size())]);
  balls = detail::moved_together(std::move(balls), built.object, kLong, kContext);
  double reached = iou(balls);
  for (int round = 0; round < rounds; ++round) {
    std::vector<Sphere> other = balls;
    detail::Fit fit(built.object);
    for (const Sphere& ball : other) fit.add(ball);
    std::vector<std::pair<std::int64_t, std::size_t>> worth;
    for (std::size_t i = 0; i < other.size(); ++i) {
      fit.remove(other[i]);
      worth.emplace_back(fit.gain(other[i]), i);
      fit.add(other[i]);
    }
    std::ranges::sort(worth);
    for (std::size_t moves = 1 + any(1 + k / 16); moves > 0; --moves) {
      Sphere& ball = other[worth[any(std::max<std::size_t>(1, k / 3))].second];
      fit.remove(ball);
      std::int64_t most = std::numeric_limits<std::int64_t>::min();
      for (std::size_t tries = 0; tries < candidates.size() / 4; ++tries) {
        const Sphere& candidate = candidates[any(candidates.size())];
        const std::int64_t gain = fit.gain(candidate);
        if (gain > most) most = gain, ball = candidate;
      }
      fit.add(ball);
    }
    other = detail::moved_together(std::move(other), built.object, kShort, kContext);
    if (const double now = iou(other); now > reached) reached = now, balls = std::move(other);
  }
  return reached;
}

void search() {
  constexpr std::uint32_t k = 64;
  constexpr int starts = 6, rounds = 40;
  std::printf(
      "Overlap with 64 spheres: best, and a search from %d random starts of %d rounds each\n\n"
      "| object | best | seconds | search: least | median | most | seconds of one |\n"
      "| --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
      starts, rounds);
  const std::vector<std::pair<const char*, bench::Scan>> objects = {
      {"liver", {"abdomen-ct-small-labels.nii.gz", bench::label(5), 0, {}}},
      {"head (MR)", {"mr-small.mhd", bench::threshold(30), 0, {}}},
      {"brain (SPECT)", {"spect.nii", bench::threshold(1000), 0, {}}},
  };
  for (const auto& [name, scan] : objects) {
    if (!have(scan)) continue;
    const Built built = build(bench::read(scan, kData), scan.rule);
    std::vector<Sphere> best;
    const double seconds = bench::seconds([&] { best = few(Method::best, built, k); });
    std::vector<double> reached, times;
    for (int start = 0; start < starts; ++start) {
      times.push_back(bench::seconds(
          [&] { reached.push_back(searched(built, k, static_cast<std::uint64_t>(start + 1), rounds)); }));
    }
    std::printf("| %s | %.4f | %.1f | %.4f | %.4f | %.4f | %.1f |\n", name,
                measure_overlap(best, built.object, kContext).iou(), seconds, *std::ranges::min_element(reached),
                bench::median(reached), *std::ranges::max_element(reached), bench::median(times));
    std::fflush(stdout);
  }
  std::printf("\n");
}

// ------------------------------------------------------------------------------------------- moving with the object

/// x -> scale · turn · x + shift.
struct Similarity {
  double scale = 1;
  Mat3 turn;
  Vec3 shift;

  Vec3 operator()(Vec3 x) const { return scale * (turn * x) + shift; }
  Vec3 back(Vec3 x) const { return transposed(turn) * ((1 / scale) * (x - shift)); }
  Sphere operator()(const Sphere& s) const { return {(*this)(s.centre), scale * s.radius}; }
};

Mat3 rotation(Vec3 axis, double degrees) {
  const Vec3 u = normalised(axis);
  const double a = degrees * std::numbers::pi / 180, c = std::cos(a), s = std::sin(a);
  Mat3 m;
  for (int i = 0; i < 3; ++i) {
    for (int j = 0; j < 3; ++j) m.rows[static_cast<std::size_t>(i)][j] = (1 - c) * u[i] * u[j] + (i == j ? c : 0);
  }
  m.rows[0].y -= s * u.z, m.rows[0].z += s * u.y, m.rows[1].x += s * u.z;
  m.rows[1].z -= s * u.x, m.rows[2].x -= s * u.y, m.rows[2].y += s * u.x;
  return m;
}

// The object under a similarity, which has its own scan.
phantoms::Field moved(const phantoms::Field& field, const Similarity& by) {
  return [=](Vec3 p) { return field(by.back(p)); };
}

// The assignment of rows to columns (as many) of the least sum. H. Kuhn, The Hungarian method (1955), by shortest
// augmenting paths.
std::vector<std::size_t> assignment(const std::vector<std::vector<double>>& cost) {
  const std::size_t n = cost.size();
  std::vector<double> u(n + 1), v(n + 1);
  std::vector<std::size_t> row_of(n + 1), before(n + 1);
  for (std::size_t i = 1; i <= n; ++i) {
    std::vector<double> least(n + 1, std::numeric_limits<double>::infinity());
    std::vector<bool> used(n + 1);
    std::size_t column = 0;
    row_of[0] = i;
    do {
      used[column] = true;
      double delta = std::numeric_limits<double>::infinity();
      std::size_t next = 0;
      for (std::size_t j = 1; j <= n; ++j) {
        if (used[j]) continue;
        const double reduced = cost[row_of[column] - 1][j - 1] - u[row_of[column]] - v[j];
        if (reduced < least[j]) least[j] = reduced, before[j] = column;
        if (least[j] < delta) delta = least[j], next = j;
      }
      for (std::size_t j = 0; j <= n; ++j) {
        if (used[j]) {
          u[row_of[j]] += delta, v[j] -= delta;
        } else {
          least[j] -= delta;
        }
      }
      column = next;
    } while (row_of[column] != 0);
    for (; column != 0; column = before[column]) row_of[column] = row_of[before[column]];
  }
  std::vector<std::size_t> column_of(n);
  for (std::size_t j = 1; j <= n; ++j) column_of[row_of[j] - 1] = j - 1;
  return column_of;
}

double overlap_of(const std::vector<Sphere>& a, const std::vector<Sphere>& b) {
  const SampledObject object = sample_union(a, std::size_t{1} << 21, kContext);
  return measure_overlap(b, object, kContext).iou();
}

/// How one set differs from another that ought to be the same.
struct Difference {
  double mean = 0, median = 0, largest = 0;  ///< distance of matched centres, in parts of `size`
  double overlap = 0;                        ///< IoU of the two unions
  std::vector<std::size_t> match;
};

Difference difference(std::vector<Sphere> a, std::vector<Sphere> b, double size) {
  const std::size_t n = std::min(a.size(), b.size());  // methods may give fewer than asked for
  Difference result;
  result.overlap = overlap_of(a, b);
  a.resize(n), b.resize(n);
  std::vector<std::vector<double>> cost(n, std::vector<double>(n));
  for (std::size_t i = 0; i < n; ++i) {
    for (std::size_t j = 0; j < n; ++j) cost[i][j] = norm(a[i].centre - b[j].centre);
  }
  result.match = assignment(cost);
  std::vector<double> distances;
  for (std::size_t i = 0; i < n; ++i) {
    distances.push_back(cost[i][result.match[i]] / size);
    result.mean += distances.back() / static_cast<double>(n);
  }
  result.median = bench::median(distances);
  result.largest = *std::ranges::max_element(distances);
  return result;
}

// Pictures of one size on top of each other.
Image stacked(const std::vector<Image>& images) {
  Image all = images.front();
  for (std::size_t i = 1; i < images.size(); ++i) {
    all.height += images[i].height;
    all.rgba.insert(all.rgba.end(), images[i].rgba.begin(), images[i].rgba.end());
  }
  return all;
}

// Ranjan and Fournier (1994), figure 8.
void cylinder(const char* picture) {
  constexpr double radius = 8, half = 24, size = 2 * half;
  const phantoms::Field field = phantoms::capped_cylinder({0.2, -0.1, 0.3}, radius, half);
  const Similarity move{.scale = 1.2, .turn = rotation({1, 0, 0}, 15), .shift = {5.3, -3.7, 2.9}};
  const Grid grid = phantoms::cubic_grid(96, 96);
  const Built still = build(phantoms::sample(field, grid), phantoms::threshold(0));
  const Built turned = build(phantoms::sample(moved(field, move), grid), phantoms::threshold(0));
  std::printf(
      "A cylinder of radius %.0f and length %.0f voxels (%zu raw spheres), and the same one moved, turned by 15 "
      "degrees "
      "and scaled by 1.2 (%zu); centres in %% of the length\n\n"
      "| method | k | centres: mean | median | most | ratio of radii | IoU |\n"
      "| --- | ---: | ---: | ---: | ---: | ---: | ---: |\n",
      radius, size, still.model.spheres.size(), turned.model.spheres.size());
  std::vector<Image> rows;
  for (const Method method : {Method::median, Method::average, Method::best}) {
    for (const std::uint32_t k : {4U, 6U, 8U, 16U}) {
      const std::vector<Sphere> a = few(method, still, k), b = few(method, turned, k);
      std::vector<Sphere> expected;
      for (const Sphere& s : a) expected.push_back(move(s));
      const Difference d = difference(expected, b, move.scale * size);
      double ratio = 0;
      for (std::size_t i = 0; i < d.match.size(); ++i) {
        ratio += b[d.match[i]].radius / a[i].radius / static_cast<double>(d.match.size());
      }
      std::printf("| %s | %u | %.2f | %.2f | %.2f | %.3f | %.3f |\n", kNames[static_cast<std::size_t>(method)], k,
                  100 * d.mean, 100 * d.median, 100 * d.largest, ratio, d.overlap);
      if (picture == nullptr || k != 6 || method == Method::median) continue;
      // Balls that match have one colour.
      SphereModel first{.spheres = a, .solid = {}}, second;
      for (const std::size_t j : d.match) second.spheres.push_back(b[j]);
      RenderOptions options{.width = 300, .height = 360, .background = Background::white};
      options.views = {View::left};
      options.colour_by = ColourBy::cluster;
      options.shadows = false;
      const std::array subjects{Subject{.model = &first}, Subject{.model = &second}};
      rows.push_back(render(subjects, options, kContext).front());
    }
  }
  std::printf("\n");
  if (picture != nullptr) std::ofstream(picture, std::ios::binary) << encode_png(stacked(rows));
}

// ------------------------------------------------------------------------------------------------------- stability

// The values of a volume between its samples; those of the border beyond it.
phantoms::Field interpolated(const Volume& volume) {
  return [&volume](Vec3 p) {
    const Grid& g = volume.grid;
    const Vec3 d = p - g.origin;
    std::array<std::int32_t, 3> low{};
    Vec3 part;
    for (int a = 0; a < 3; ++a) {
      const auto axis = static_cast<std::size_t>(a);
      const double at = std::clamp(dot(g.direction.column(a), d) / g.spacing[a], 0.0, g.dims[axis] - 1.0);
      low[axis] = std::min(static_cast<std::int32_t>(at), g.dims[axis] - 2);
      part[a] = at - low[axis];
    }
    const auto values = corner_values(volume, low[0], low[1], low[2]);
    double sum = 0;
    for (unsigned c = 0; c < 8; ++c) {
      double weight = 1;
      for (int a = 0; a < 3; ++a) weight *= (c >> a & 1) != 0 ? part[a] : 1 - part[a];
      sum += weight * values[c];
    }
    return sum;
  };
}

void stability_of(const char* name, const phantoms::Field& field, const Grid& grid, double threshold, double noise) {
  constexpr std::uint32_t k = 64;
  const ObjectRule rule = phantoms::threshold(threshold);
  const Built still = build(phantoms::sample(field, grid), rule);
  const Box box = bounds(still.model);
  const double size = norm(box.max - box.min);
  const Vec3 middle = 0.5 * (box.min + box.max);

  struct Change {
    const char* name;
    Similarity by{};
    double noise = 0, coarser = 1;
  };
  const auto about_middle = [&](double degrees) {
    Similarity s{.scale = 1, .turn = rotation({1, 2, 3}, degrees), .shift = {}};
    s.shift = middle - s.turn * middle;
    return s;
  };
  const std::array changes{Change{.name = "noise", .noise = noise}, Change{.name = "turn 15°", .by = about_middle(15)},
                           Change{.name = "turn 90°", .by = about_middle(90)},
                           Change{.name = "shift ⅓ voxel", .by = {1, {}, {grid.spacing.x / 3, 0, 0}}},
                           Change{.name = "half resolution", .coarser = 2}};
  for (const Change& change : changes) {
    Grid other = grid;
    for (int a = 0; a < 3; ++a) {
      other.spacing[a] *= change.coarser;
      other.dims[static_cast<std::size_t>(a)] =
          static_cast<std::int32_t>(other.dims[static_cast<std::size_t>(a)] / change.coarser);
    }
    std::mt19937_64 random(1);
    const phantoms::Field changed = moved(field, change.by);
    const auto noisy = [&](Vec3 p) {
      // Twelve uniform numbers make a normal one.
      double sum = -6;
      for (int i = 0; i < 12; ++i) sum += static_cast<double>(random() >> 11) * 0x1p-53;
      return changed(p) + change.noise * sum;
    };
    const Built second = build(phantoms::sample(change.noise > 0 ? phantoms::Field(noisy) : changed, other), rule);
    std::printf("| %s | %s |", name, change.name);
    for (const Method method : kMethods) {
      std::vector<Sphere> expected;
      for (const Sphere& s : few(method, still, k)) expected.push_back(change.by(s));
      const Difference d = difference(expected, few(method, second, k), size);
      std::printf(" %.1f / %.3f |", 100 * d.mean, d.overlap);
    }
    std::printf("\n");
    std::fflush(stdout);
  }
}

void stability() {
  std::printf(
      "64 spheres of the object and of the changed object, changed back: mean distance of matched centres in %% of "
      "the diagonal / IoU of the two unions\n\n| object | change |");
  for (const char* method : kNames) std::printf(" %s |", method);
  std::printf("\n| --- | --- |");
  for (std::size_t i = 0; i < kNames.size(); ++i) std::printf(" ---: |");
  std::printf("\n");
  const phantoms::Field blobs = phantoms::either(
      phantoms::either(phantoms::ball({-9, 1, 2}, 11), phantoms::ball({8, -3, 1}, 9)), phantoms::ball({2, 10, -6}, 8));
  stability_of("three balls", blobs, phantoms::cubic_grid(64, 64), 0, 0.3);
  const bench::Scan brain{"spect.nii", bench::threshold(1000), 0, {}};
  if (have(brain)) {
    const Volume volume = bench::read(brain, kData);
    stability_of("brain (SPECT)", interpolated(volume), volume.grid, 1000, 30);
  }
  const bench::Scan head{"mr-small.mhd", bench::threshold(30), 0, {}};
  if (have(head)) {
    const Volume volume = bench::read(head, kData);
    stability_of("head (MR)", interpolated(volume), volume.grid, 30, 5);
  }
  std::printf("\n");
}

// ------------------------------------------------------------------------------------------------------------ speed

// Most memory since the last reset, MiB.
double peak_mib(bool reset) {
  if (reset) std::ofstream("/proc/self/clear_refs") << "5";
  std::ifstream status("/proc/self/status");
  for (std::string line; std::getline(status, line);) {
    if (line.rfind("VmHWM:", 0) == 0) return std::stod(line.substr(6)) / 1024;
  }
  return 0;
}

// Of all threads, so far.
double processor_seconds() { return static_cast<double>(std::clock()) / CLOCKS_PER_SEC; }

void speed() {
  std::printf(
      "To 256 spheres on 2 threads, medians of 3 runs\n\n| object | raw spheres | method | seconds | of processor time "
      "| "
      "bytes a raw sphere beside the model |\n| --- | ---: | --- | ---: | ---: | ---: |\n");
  for (const bench::Scan& scan : {bench::Scan{"spect.nii", bench::threshold(1000), 0, {}},
                                  bench::Scan{"embryo.nrrd", bench::threshold(40), 0, {}},
                                  bench::Scan{"stroke-t1.nii.gz", bench::threshold(60), 0, {}}}) {
    if (!have(scan)) continue;
    const Built built = build(bench::read(scan, kData), scan.rule);
    for (const Method method : kMethods) {
      const double before = peak_mib(true);
      std::vector<double> times, work;
      for (int run = 0; run < 3; ++run) {
        const double begun = processor_seconds();
        times.push_back(bench::seconds([&] { simplified(method, built.model, built.object, 256); }));
        work.push_back(processor_seconds() - begun);
      }
      std::printf("| %s | %zu | %s | %.2f | %.2f | %.0f |\n", bench::name_of(scan).c_str(), built.model.spheres.size(),
                  kNames[static_cast<std::size_t>(method)], bench::median(times), bench::median(work),
                  (peak_mib(false) - before) * 1048576 / static_cast<double>(built.model.spheres.size()));
      std::fflush(stdout);
    }
  }
  std::printf("\n");
}

}  // namespace

int main(int argc, char** argv) {
  const std::string_view what = argc > 1 ? argv[1] : "";
  if (what.empty() || what == "quality") quality();
  if (what.empty() || what == "search") search();
  if (what.empty() || what == "cylinder") cylinder(argc > 2 ? argv[2] : nullptr);
  if (what.empty() || what == "stability") stability();
  if (what.empty() || what == "speed") speed();
}
