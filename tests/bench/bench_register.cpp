// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registration of real objects under random similarity transforms: how often right, how exact, how fast.
// Usage: bench_register [transforms of each object] [voxels along the longest side of the fine volume]
//        bench_register different         every object against every other one
//        bench_register figure FILE.png   the paper's Figure 9: a brain at 16³ and, transformed, at 64³
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <iostream>
#include <memory>

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

struct Outcome {
  double degrees = 0, scale = 0, voxels = 0, seconds = 0;
  bool poor = false;
  std::size_t others = 0;
  bool right() const { return degrees < 5 && scale < 0.05 && voxels < 2; }
};

double part(std::vector<double> values, double share) {
  std::ranges::sort(values);
  return values[std::min(values.size() - 1, static_cast<std::size_t>(share * static_cast<double>(values.size())))];
}

void print(const char* name, const std::vector<Outcome>& all) {
  std::vector<double> degrees, scale, voxels, seconds;
  std::size_t right = 0;
  for (const Outcome& o : all) {
    right += o.right();
    degrees.push_back(o.degrees), scale.push_back(100 * o.scale), voxels.push_back(o.voxels);
    seconds.push_back(o.seconds);
  }
  std::printf("%-22s %4zu/%-4zu %6.1f %%  %7.3f %7.3f  %7.3f %7.3f  %7.3f %7.3f  %6.3f %6.3f\n", name, right,
              all.size(), 100.0 * static_cast<double>(right) / static_cast<double>(all.size()), part(degrees, 0.5),
              part(degrees, 0.95), part(scale, 0.5), part(scale, 0.95), part(voxels, 0.5), part(voxels, 0.95),
              part(seconds, 0.5), part(seconds, 0.95));
  std::fflush(stdout);
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

Outcome measure(const Subject& subject, const Condition& condition, const AffineMap& pose, std::uint64_t seed) {
  const RealObject& object = subject.object;
  const SphereModel moving = model_of(object, taken(object, {.to_object = pose,
                                                             .voxel = subject.voxel * condition.ratio,
                                                             .noise = condition.noise,
                                                             .cropped = condition.cropped,
                                                             .seed = seed}))
                                 .model;
  Registration found;
  Outcome o;
  o.seconds = seconds([&] {
    found = register_models(condition.noise > 0 ? subject.fixed_noisy : subject.fixed, moving, {},
                            {.threads = 2, .cancel = {}, .progress = {}});
  });
  const AffineMap truth = composed(inverse(subject.upright), pose), map = found.moving_to_fixed;
  const Vec3 centre = inverse(pose)(object.centre);
  o.degrees = angle_between(nearest_rotation(truth.linear), nearest_rotation(map.linear));
  o.scale = std::abs(scale_of(map) / scale_of(truth) - 1);
  o.voxels = norm(map(centre) - truth(centre)) / subject.voxel;
  o.poor = found.poor;
  o.others = found.others.size();
  if (std::getenv("VERBOSE") != nullptr && (!o.right() || o.poor || o.others > 0)) {
    std::printf("  %s %s: %.2f deg, %.2f %%, %.2f voxels; agreement %.3f dice %.3f within %.3f %.3f; %zu others%s\n",
                object.name.c_str(), condition.name, o.degrees, 100 * o.scale, o.voxels, found.surfaces.agreement,
                found.overlap.dice, found.surfaces.fixed_within, found.surfaces.moving_within, o.others,
                o.poor ? ", poor" : "");
  }
  return o;
}

void run(int transforms, int fine) {
  const std::vector<Condition> conditions{{"1:1", 1, 0, 0},
                                          {"2:1", 2, 0, 0},
                                          {"4:1", 4, 0, 0},
                                          {"1:1, noise 10 %", 1, kNoise, 0},
                                          {"1:1, cropped 10 %", 1, 0, 0.1},
                                          {"2:1, noise and crop", 2, kNoise, 0.1}};
  std::vector<std::vector<Outcome>> outcomes(conditions.size());
  std::vector<std::unique_ptr<const Subject>> subjects;
  for (const Scan& scan : registration_scans()) subjects.push_back(std::make_unique<const Subject>(scan, fine));
  const auto table = [&] {
    std::printf("%-22s %9s %8s  %15s  %15s  %15s  %13s\n", "", "right", "", "degrees", "scale %", "voxels", "seconds");
    std::printf("%-22s %9s %8s  %7s %7s  %7s %7s  %7s %7s  %6s %6s\n", "", "", "", "median", "95 %", "median", "95 %",
                "median", "95 %", "median", "95 %");
    for (std::size_t c = 0; c < conditions.size(); ++c) print(conditions[c].name, outcomes[c]);
  };
  phantoms::Random random(2026);
  for (int t = 0; t < transforms; ++t) {
    for (const auto& subject : subjects) {
      const AffineMap pose = random_pose(subject->object, random);
      for (std::size_t c = 0; c < conditions.size(); ++c)
        outcomes[c].push_back(measure(*subject, conditions[c], pose, random.bits()));
    }
    if (std::getenv("VERBOSE") != nullptr && t + 1 < transforms) table();
  }
  table();
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
    if (argc > 1 && argv[1] == std::string("different")) {
      spherule::bench::run_different(48);
      return 0;
    }
    if (argc > 2 && argv[1] == std::string("figure")) {
      spherule::bench::run_figure(argv[2]);
      return 0;
    }
    spherule::bench::run(argc > 1 ? std::atoi(argv[1]) : 20, argc > 2 ? std::atoi(argv[2]) : 88);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
