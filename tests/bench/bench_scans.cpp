// SPDX-License-Identifier: GPL-3.0-or-later
//
// The whole pipeline on every real scan: counts, volume against the voxels, density, the four criteria, seconds by
// stage, peak memory. Each scan runs in a process of its own, so that the peak is its own; the peak excludes the
// checks. Usage: bench_scans [threads]
#include <sys/resource.h>
#include <sys/wait.h>
#include <unistd.h>

#include <cstdio>

#include "core/measure/checks.h"
#include "core/measure/solid.h"
#include "core/pipeline.h"
#include "tests/bench/scans.h"

using namespace spherule;

namespace {

double peak_bytes() {
  rusage usage{};
  ::getrusage(RUSAGE_SELF, &usage);
  return 1024.0 * static_cast<double>(usage.ru_maxrss);
}

void row(const bench::Scan& scan, const std::filesystem::path& folder, const Context& context) {
  const Volume volume = bench::read(scan, folder);
  const BuiltModel built = build_model(volume, scan.rule, {}, context);
  const double peak = peak_bytes();
  const Solid& solid = *built.model.solid;
  const TetrahedraMeasures tetrahedra = measure_tetrahedra(solid, context);
  const InsideSamples samples = classify_samples(volume, scan.rule, context);
  const double voxels = measure_voxels(volume.grid, samples.inside).volume_mm3;
  const ModelChecks checks = check_model(built.model, samples.inside, scan.rule.border, context);
  double total = 0;
  for (const StageTime& stage : built.timings) total += stage.seconds;
  const auto points = static_cast<double>(solid.boundary.points.size());
  std::printf("| %s | %zu | %zu | %zu | %.5g | %.5g | %.5g | %+.1f %% | %.3g | %llu | ", bench::name_of(scan).c_str(),
              solid.boundary.points.size(), solid.cells.size(), built.model.spheres.size(), tetrahedra.volume_mm3,
              voxels, scan.readme_mm3, 100 * (tetrahedra.volume_mm3 / voxels - 1), checks.bounds.density_mm,
              static_cast<unsigned long long>(checks.criteria.violations()));
  for (const StageTime& stage : built.timings) std::printf("%.3f | ", stage.seconds);
  std::printf("%.1f %% | %.0f | %.0f |\n", 100 * built.timings.back().seconds / total, peak / 1048576, peak / points);
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  Context context;
  context.threads = argc > 1 ? static_cast<unsigned>(std::atoi(argv[1])) : 2;
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  std::printf(
      "| object | points | tetrahedra | spheres | V_T mm3 | voxels mm3 | README mm3 | V_T/voxels | density mm | "
      "violations | samples s | boundary s | "
      "delaunay s | spheres s | spheres share | peak MiB | bytes/point |\n|%s\n",
      "---|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|---:|");
  std::fflush(stdout);
  for (const bench::Scan& scan : bench::scans()) {
    if (!std::filesystem::exists(folder / scan.file)) continue;
    const pid_t child = ::fork();
    if (child == 0) {
      try {
        row(scan, folder, context);
      } catch (const std::exception& error) {
        std::printf("| %s | %s |\n", bench::name_of(scan).c_str(), error.what());
      }
      std::fflush(stdout);
      ::_exit(0);
    }
    int status = 0;
    ::waitpid(child, &status, 0);
  }
}
