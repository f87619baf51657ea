// SPDX-License-Identifier: GPL-3.0-or-later
//
// Registration of real objects under random similarity transforms: how often right, how exact, how fast.
// Usage: bench_register [transforms of each object] [voxels along the longest side of the fine volume]
#include <cstdio>
#include <cstdlib>
#include <iostream>

#include "core/register/register.h"
#include "tests/bench/registration_pairs.h"

namespace spherule::bench {
namespace {

struct Condition {
  const char* name;
  double ratio, noise, cropped;
};

struct Outcome {
  double degrees = 0, scale = 0, voxels = 0, seconds = 0;
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

void run(int transforms, int fine) {
  const std::vector<Condition> conditions{{"1:1", 1, 0, 0},
                                          {"2:1", 2, 0, 0},
                                          {"4:1", 4, 0, 0},
                                          {"1:1, noise 10 %", 1, 0.1, 0},
                                          {"1:1, cropped 10 %", 1, 0, 0.1},
                                          {"2:1, noise and crop", 2, 0.1, 0.1}};
  std::vector<std::vector<Outcome>> outcomes(conditions.size());
  const Context context{.threads = 2, .cancel = {}, .progress = {}};
  const bool verbose = std::getenv("VERBOSE") != nullptr;
  phantoms::Random random(2026);
  for (const Scan& scan : registration_scans()) {
    const RealObject object(scan, SPHERULE_SHARED_DATA);
    const Vec3 size = object.box.max - object.box.min;
    const double voxel = std::max({size.x, size.y, size.z}) / fine;
    const AffineMap upright{{}, object.box.min};
    const SphereModel fixed = model_of(object, taken(object, {.to_object = upright, .voxel = voxel, .seed = 7})).model;
    const SphereModel fixed_noisy =
        model_of(object, taken(object, {.to_object = upright, .voxel = voxel, .noise = 0.1, .seed = 8})).model;
    for (int t = 0; t < transforms; ++t) {
      const AffineMap pose = random_pose(object, random);
      for (std::size_t c = 0; c < conditions.size(); ++c) {
        const Condition& condition = conditions[c];
        const SphereModel moving = model_of(object, taken(object, {.to_object = pose,
                                                                   .voxel = voxel * condition.ratio,
                                                                   .noise = condition.noise,
                                                                   .cropped = condition.cropped,
                                                                   .seed = random.bits()}))
                                       .model;
        Registration found;
        Outcome o;
        o.seconds =
            seconds([&] { found = register_models(condition.noise > 0 ? fixed_noisy : fixed, moving, {}, context); });
        // From the moving volume's frame to the fixed one's.
        const AffineMap truth = composed(inverse(upright), pose);
        const auto turn = [](const AffineMap& m) { return nearest_rotation(m.linear); };
        const Vec3 centre = inverse(pose)(object.centre);
        const auto judge = [&](const AffineMap& map) {
          o.degrees = angle_between(turn(truth), turn(map));
          o.scale = std::abs(scale_of(map) / scale_of(truth) - 1);
          o.voxels = norm(map(centre) - truth(centre)) / voxel;
        };
        judge(found.moving_to_fixed);
        outcomes[c].push_back(o);
        if (verbose && (!o.right() || std::getenv("ALL") != nullptr)) {
          std::printf(
              "  %s %s #%d: %.2f deg, %.2f %%, %.2f voxels; agreement %.3f dice %.3f within %.3f %.3f matched %.3f p95 "
              "%.3f; %zu others;",
              object.name.c_str(), condition.name, t, o.degrees, 100 * o.scale, o.voxels, found.surfaces.agreement,
              found.overlap.dice, found.surfaces.fixed_within, found.surfaces.moving_within, found.matched_share,
              found.surfaces.p95_mm / voxel, found.others.size());
          const SurfaceDistance at_truth =
              surface_distance(shape_of(fixed, 64).surface, shape_of(moving, 64).surface, truth, 3000, found.reach_mm);
          std::printf(" truth %.3f%s", at_truth.agreement, found.poor ? " POOR" : "");
          for (const auto& stage : found.timings) std::printf(" %s %.3f", stage.stage.c_str(), stage.seconds);
          std::printf("\n");
          std::fflush(stdout);
        }
      }
    }
    if (verbose) {
      std::printf("%s: %zu spheres\n", object.name.c_str(), fixed.spheres.size());
      for (std::size_t c = 0; c < conditions.size(); ++c) {
        print(conditions[c].name, {outcomes[c].end() - transforms, outcomes[c].end()});
      }
    }
  }
  std::printf("%-22s %9s %8s  %15s  %15s  %15s  %13s\n", "", "right", "", "degrees", "scale %", "voxels", "seconds");
  std::printf("%-22s %9s %8s  %7s %7s  %7s %7s  %7s %7s  %6s %6s\n", "", "", "", "median", "95 %", "median", "95 %",
              "median", "95 %", "median", "95 %");
  for (std::size_t c = 0; c < conditions.size(); ++c) print(conditions[c].name, outcomes[c]);
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

}  // namespace
}  // namespace spherule::bench

int main(int argc, char** argv) {
  try {
    if (argc > 1 && argv[1] == std::string("different")) {
      spherule::bench::run_different(48);
      return 0;
    }
    spherule::bench::run(argc > 1 ? std::atoi(argv[1]) : 20, argc > 2 ? std::atoi(argv[2]) : 88);
  } catch (const std::exception& error) {
    std::cerr << error.what() << "\n";
    return 1;
  }
}
