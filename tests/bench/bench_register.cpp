// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registration of real objects under random similarity transforms: how often right, how exact, how fast.
// Usage: bench_register table FILE.csv [transforms of each object] [voxels along the longest side of the fine volume]
//                       [first transform]
//        bench_register speed [repetitions]
//        bench_register different         every object against every other one
//        bench_register figure FILE.png   the paper's Figure 9: a brain at 16³ and, transformed, at 64³
#include <array>
#include <cstdio>
#include <cstdlib>
#include <ctime>
#include <fstream>
#include <iostream>
#include <map>
#include <memory>
#include <sstream>

#include "core/register/picture.h"
#include "core/register/register.h"
#include "tests/bench/registration_pairs.h"

namespace spherule::bench {
namespace {

struct Condition {
  const char* name;
  double ratio, noise, cropped;
};

constexpr double kNoise = 0.1;  // of the difference between inside and outside
constexpr std::array<Condition, 6> kConditions{{{"1:1", 1, 0, 0},
                                                {"2:1", 2, 0, 0},
                                                {"4:1", 4, 0, 0},
                                                {"1:1 noise 10 %", 1, kNoise, 0},
                                                {"1:1 cropped 10 %", 1, 0, 0.1},
                                                {"2:1 noise and crop", 2, kNoise, 0.1}}};

struct Outcome {
  double degrees = 0, scale = 0, voxels = 0, seconds = 0;  // scale: relative error, with its sign
  bool poor = false;
  std::size_t others = 0;
  bool right() const { return degrees < 5 && std::abs(scale) < 0.05 && voxels < 2; }
};

double part(std::vector<double> values, double share) {
  std::ranges::sort(values);
  return values[std::min(values.size() - 1, static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

void print(const std::string& name, const std::vector<Outcome>& all) {
  std::vector<double> degrees, scale, sign, voxels, seconds;
  std::size_t right = 0, poor = 0;
  for (const Outcome& o : all) {
    right += o.right();
    poor += o.poor;
    degrees.push_back(o.degrees), scale.push_back(100 * std::abs(o.scale)), sign.push_back(100 * o.scale);
    voxels.push_back(o.voxels), seconds.push_back(o.seconds);
  }
  std::printf(
      "| %-30s | %4zu of %-4zu | %6.1f %% | %7.3f | %7.3f | %7.3f | %7.3f | %+7.3f | %6.3f | %6.3f | %5.2f | %5.2f | "
      "%3zu |\n",
      name.c_str(), right, all.size(), 100.0 * static_cast<double>(right) / static_cast<double>(all.size()),
      part(degrees, 0.5), part(degrees, 0.95), part(scale, 0.5), part(scale, 0.95), part(sign, 0.5), part(voxels, 0.5),
      part(voxels, 0.95), part(seconds, 0.5), part(seconds, 0.95), poor);
}

void print_head() {
  std::printf("| %-30s | %12s | %8s | %7s | %7s | %7s | %7s | %7s | %6s | %6s | %5s | %5s | %3s |\n", "", "right", "",
              "degrees", "95 %", "scale %", "95 %", "signed", "voxels", "95 %", "s", "95 %", "poor");
}

// A real object with the models that others are laid on.
struct Subject {
  RealObject object;
  double voxel;
  AffineMap upright;  // from the fixed volume's frame to the object's
  SphereModel fixed, fixed_noisy;

  Subject(const Scan& scan, int fine) : object(scan, SPHERULE_SHARED_DATA) {
    const Vec3 size = object.box.max - object.box.min;
    voxel = std::max({size.x, size.y, size.z}) / fine;
    upright.shift = object.box.min;
    fixed = model_of(object, taken(object, {.to_object = upright, .voxel = voxel, .seed = 7})).model;
    fixed_noisy =
        model_of(object, taken(object, {.to_object = upright, .voxel = voxel, .noise = kNoise, .seed = 8})).model;
  }
};

Outcome measure(const Subject& subject, const Condition& condition, const AffineMap& pose, std::uint64_t seed,
                unsigned threads) {
  const RealObject& object = subject.object;
  const Taking taking{.to_object = pose,
                      .voxel = subject.voxel * condition.ratio,
                      .noise = condition.noise,
                      .cropped = condition.cropped,
                      .seed = seed};
  const SphereModel moving = model_of(object, taken(object, taking, threads), threads).model;
  Registration found;
  Outcome o;
  o.seconds = seconds([&] {
    found = register_models(condition.noise > 0 ? subject.fixed_noisy : subject.fixed, moving, {},
                            {.threads = threads, .cancel = {}, .progress = {}});
  });
  const AffineMap truth = composed(inverse(subject.upright), pose), map = found.moving_to_fixed;
  const Vec3 centre = inverse(pose)(object.centre);
  o.degrees = angle_between(nearest_rotation(truth.linear), nearest_rotation(map.linear));
  o.scale = scale_of(map) / scale_of(truth) - 1;
  o.voxels = norm(map(centre) - truth(centre)) / subject.voxel;
  o.poor = found.poor;
  o.others = found.others.size();
  return o;
}

// Rows are written as they come; those that the file already has are not measured again.
void run(int transforms, int fine, int first, const std::string& file) {
  std::map<std::string, Outcome> rows;
  std::ifstream before(file);
  for (std::string line; std::getline(before, line);) {
    std::ranges::replace(line, ',', '\t');
    std::istringstream fields(line);
    std::string transform, object, condition;
    Outcome o;
    std::getline(fields, transform, '\t'), std::getline(fields, object, '\t'), std::getline(fields, condition, '\t');
    if (fields >> o.degrees >> o.scale >> o.voxels >> o.seconds >> o.poor >> o.others)
      rows[transform + "," + object + "," + condition] = o;
  }
  std::ofstream out(file, std::ios::app);
  if (before.bad() || rows.empty()) out << "transform,object,condition,degrees,scale,voxels,seconds,poor,others\n";
  std::map<std::string, std::vector<Outcome>> of_condition, of_object;
  std::vector<std::unique_ptr<const Subject>> subjects;
  for (const Scan& scan : registration_scans()) subjects.push_back(std::make_unique<const Subject>(scan, fine));
  phantoms::Random random(2026);
  for (int t = 0; t < transforms; ++t) {
    for (const auto& subject : subjects) {
      const AffineMap pose = random_pose(subject->object, random);
      for (const Condition& condition : kConditions) {
        const std::uint64_t seed = random.bits();
        const std::string key = std::to_string(t) + "," + subject->object.name + "," + condition.name;
        auto row = rows.find(key);
        if (row == rows.end()) {
          if (t < first) continue;
          row = rows.emplace(key, measure(*subject, condition, pose, seed, 1)).first;
          const Outcome& o = row->second;
          out << key << ',' << o.degrees << ',' << o.scale << ',' << o.voxels << ',' << o.seconds << ',' << o.poor
              << ',' << o.others << std::endl;
        }
        of_condition[condition.name].push_back(row->second);
        of_object[subject->object.name + std::string(", ") + condition.name].push_back(row->second);
      }
    }
  }
  print_head();
  for (const Condition& condition : kConditions) print(condition.name, of_condition[condition.name]);
  for (const auto& [name, outcomes] : of_object) print(name, outcomes);
}

// Of one pair of each object, at 1:1: where the time goes, and the processor time of both threads together.
void run_speed(int repetitions, int fine) {
  phantoms::Random random(5);
  std::vector<double> medians, of_processor;
  std::printf("%-40s %9s %9s   %7s %7s %7s %7s   %7s   %9s\n", "ms, median", "fixed", "moving", "shapes", "search",
              "surfaces", "quality", "all", "processor");
  for (const Scan& scan : registration_scans()) {
    const Subject subject(scan, fine);
    const SphereModel moving =
        model_of(subject.object, taken(subject.object, {.to_object = random_pose(subject.object, random),
                                                        .voxel = subject.voxel,
                                                        .seed = random.bits()}))
            .model;
    std::array<std::vector<double>, 6> times;
    for (int r = 0; r < repetitions; ++r) {
      Registration found;
      const std::clock_t before = std::clock();
      times[4].push_back(1000 * seconds([&] {
                           found =
                               register_models(subject.fixed, moving, {}, {.threads = 2, .cancel = {}, .progress = {}});
                         }));
      times[5].push_back(1000.0 * static_cast<double>(std::clock() - before) / CLOCKS_PER_SEC);
      for (std::size_t s = 0; s < 4; ++s) times[s].push_back(1000 * found.timings[s].seconds);
    }
    std::printf("%-40s %9zu %9zu  ", subject.object.name.c_str(), subject.fixed.spheres.size(), moving.spheres.size());
    for (std::size_t s = 0; s < 6; ++s) std::printf("%s %7.1f", s >= 4 ? "  " : "", part(times[s], 0.5));
    std::printf("\n");
    std::fflush(stdout);
    medians.push_back(part(times[4], 0.5)), of_processor.push_back(part(times[5], 0.5));
  }
  std::printf("median of the objects: %.0f ms; %.0f ms of processor time\n", part(medians, 0.5),
              part(of_processor, 0.5));
}

// Every object against every other one: none may pass as a match.
void run_different(int fine) {
  const Context context{.threads = 2, .cancel = {}, .progress = {}};
  const bool verbose = std::getenv("VERBOSE") != nullptr;
  std::vector<SphereModel> models;
  std::vector<std::string> names;
  for (const Scan& scan : registration_scans()) {
    const RealObject object(scan, SPHERULE_SHARED_DATA);
    const Vec3 size = object.box.max - object.box.min;
    const double voxel = std::max({size.x, size.y, size.z}) / fine;
    models.push_back(model_of(object, taken(object, {.to_object = {{}, object.box.min}, .voxel = voxel})).model);
    names.push_back(object.name);
  }
  std::size_t pairs = 0, poor = 0;
  double best = 0;
  for (std::size_t f = 0; f < models.size(); ++f) {
    for (std::size_t m = 0; m < models.size(); ++m) {
      if (f == m) continue;
      const Registration found = register_models(models[f], models[m], {}, context);
      ++pairs;
      poor += found.poor;
      best = std::max(best, found.overlap.dice);
      if (verbose) {
        std::printf("  %s <- %s: agreement %.3f dice %.3f within %.3f %.3f matched %.3f p95/reach %.2f%s\n",
                    names[f].c_str(), names[m].c_str(), found.surfaces.agreement, found.overlap.dice,
                    found.surfaces.fixed_within, found.surfaces.moving_within, found.matched_share,
                    found.surfaces.p95_mm / found.reach_mm, found.poor ? "" : " NOT POOR");
      }
    }
  }
  std::printf("different objects: %zu of %zu pairs reported as poor; largest Dice %.3f\n", poor, pairs, best);
}

void run_figure(const char* file) {
  const RealObject object({"pet.nii", threshold(0.5), 0, {}}, SPHERULE_SHARED_DATA);
  const Vec3 size = object.box.max - object.box.min;
  const double longest = std::max({size.x, size.y, size.z});
  // In the fine volume's frame the brain is turned, moved and smaller.
  const Mat3 turn = rotation(Vec3{0.9, -1.3, 0.7});
  const AffineMap pose{scaled(1.3, turn), object.centre - 1.3 * (turn * Vec3{40, 25, -30})};
  Box turned;
  for (const Vec3 p : object.inside()) turned.include(inverse(pose)(p));
  const Vec3 across = turned.max - turned.min;
  const double fine = 1.3 * std::max({across.x, across.y, across.z}) / 58.5;
  // Grids have six samples more than the object is long.
  const Volume coarse = taken(object, {.to_object = {}, .voxel = longest / 10.5});
  const Volume large = taken(object, {.to_object = pose, .voxel = fine});
  const SphereModel fixed = model_of(object, large).model, moving = model_of(object, coarse).model;
  Registration found;
  const double time =
      seconds([&] { found = register_models(fixed, moving, {.k = 64}, {.threads = 2, .cancel = {}, .progress = {}}); });
  const AffineMap truth = inverse(pose);
  const auto print_map = [](const char* name, const AffineMap& m) {
    for (std::size_t r = 0; r < 3; ++r) {
      const Vec3 row = m.linear.rows[r];
      std::printf("%-7s %9.5f %9.5f %9.5f %10.4f\n", r == 0 ? name : "", row.x, row.y, row.z,
                  m.shift[static_cast<int>(r)]);
    }
  };
  std::printf(
      "moving %d x %d x %d, %zu spheres; fixed %d x %d x %d, %zu spheres; %zu and %zu spheres registered in %.2f s\n",
      coarse.grid.dims[0], coarse.grid.dims[1], coarse.grid.dims[2], moving.spheres.size(), large.grid.dims[0],
      large.grid.dims[1], large.grid.dims[2], fixed.spheres.size(), found.moving_spheres.size(),
      found.fixed_spheres.size(), time);
  print_map("true", truth);
  print_map("found", found.moving_to_fixed);
  std::printf("%.2f degrees, %.2f %% of scale, %.3f fine voxels at the centre; Dice %.3f\n",
              angle_between(nearest_rotation(truth.linear), nearest_rotation(found.moving_to_fixed.linear)),
              100 * std::abs(scale_of(found.moving_to_fixed) / scale_of(truth) - 1),
              norm(found.moving_to_fixed(object.centre) - truth(object.centre)) / (fine / 1.3), found.overlap.dice);
  const SphereModel few_fixed{.spheres = found.fixed_spheres, .solid = {}},
      few_moving{.spheres = found.moving_spheres, .solid = {}};
  RenderOptions options;
  options.width = 480, options.height = 420, options.background = Background::white;
  const std::string png = encode_png(before_and_after(few_fixed, few_moving, found.moving_to_fixed, options));
  std::ofstream(file, std::ios::binary) << png;
}

}  // namespace
}  // namespace spherule::bench

int main(int argc, char** argv) {
  try {
    const std::string what = argc > 1 ? argv[1] : "speed";
    const auto number = [&](int i, int otherwise) { return argc > i ? std::atoi(argv[i]) : otherwise; };
    if (what == "table" && argc > 2) {
      spherule::bench::run(number(3, 20), number(4, 64), number(5, 0), argv[2]);
    } else if (what == "speed") {
      spherule::bench::run_speed(number(2, 5), 88);
    } else if (what == "different") {
      spherule::bench::run_different(48);
    } else if (what == "figure" && argc > 2) {
      spherule::bench::run_figure(argv[2]);
    } else {
      std::cerr << "See the usage at the top of bench_register.cpp.\n";
      return 1;
    }
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
