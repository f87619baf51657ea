// SPDX-License-Identifier: GPL-3.0-or-later
//
// Measures of unions of balls, one thread unless said: ours; Voronota (areas and volumes of its cells) and freesasa
// (area only, two methods) as programs on the same balls; CGAL's regular triangulation alone, from which measures would
// only start; and the raw model of a head against its own tetrahedralization.
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Regular_triangulation_3.h>
#include <malloc.h>
#include <unistd.h>

#include <atomic>
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <new>
#include <random>

#include "core/measure/union.h"
#include "core/pipeline.h"
#include "tests/bench/scans.h"

using namespace spherule;

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Regular = CGAL::Regular_triangulation_3<Kernel>;

// Each ball overlaps about seven others, as in simplified models.
std::vector<Sphere> random_balls(std::size_t count) {
  std::mt19937_64 random(1);
  const auto unit = [&] { return static_cast<double>(random() >> 11) * 0x1p-53; };
  const double side = std::cbrt(static_cast<double>(count));
  std::vector<Sphere> balls(count);
  for (Sphere& b : balls) b = {{side * unit(), side * unit(), side * unit()}, 0.4 + 0.4 * unit()};
  return balls;
}

std::size_t triangulate(const std::vector<Sphere>& balls) {
  std::vector<Regular::Weighted_point> points;
  for (const Sphere& s : balls)
    points.emplace_back(Kernel::Point_3(s.centre.x, s.centre.y, s.centre.z), s.radius * s.radius);
  return Regular(points.begin(), points.end()).number_of_finite_cells();
}

void print_peers(const std::vector<Sphere>& balls, const UnionMeasures& ours) {
  const std::string base =
      (std::filesystem::temp_directory_path() / ("spherule-bench-" + std::to_string(::getpid()))).string();
  {
    std::ofstream file(base + ".balls");
    file.precision(17);
    for (const Sphere& s : balls)
      file << s.centre.x << ' ' << s.centre.y << ' ' << s.centre.z << ' ' << s.radius << '\n';
  }
  const double seconds = bench::seconds([&] {
    const std::string command = "voronota calculate-contacts --probe 0 --volumes-output " + base + ".volumes < " +
                                base + ".balls > " + base + ".contacts 2> /dev/null";
    if (std::system(command.c_str()) != 0) std::printf("    (Voronota failed)\n");
  });
  double area = 0, volume = 0;
  std::ifstream contacts(base + ".contacts"), volumes(base + ".volumes");
  for (std::string a, b, value; contacts >> a >> b >> value;)
    if (a == b) area += std::stod(value);
  for (std::string a, value; volumes >> a >> value;) volume += std::stod(value);
  const auto off = [](double theirs, double exact) { return theirs / exact - 1; };
  std::printf("    Voronota                %8.3f s  area off %+.1e  volume off %+.1e\n", seconds,
              off(area, ours.area_mm2), off(volume, ours.moments.volume));
  const std::string command = "/usr/bin/python3 '" SPHERULE_BENCH_SOURCES "/freesasa_area.py' < " + base + ".balls";
  if (FILE* pipe = ::popen(command.c_str(), "r")) {
    double time = 0, sasa = 0;
    if (std::fscanf(pipe, "seconds=%lf area=%lf", &time, &sasa) == 2)
      std::printf("    freesasa                %8.3f s  area off %+.1e\n", time, off(sasa, ours.area_mm2));
    ::pclose(pipe);
  }
  for (const char* extension : {".balls", ".volumes", ".contacts"}) std::filesystem::remove(base + extension);
}

std::atomic<std::size_t> in_use{0}, most{0};  // bytes from operator new

// The most that `work` has in use, beyond what was before.
template <typename Work>
double peak_bytes(Work&& work) {
  const std::size_t before = most = in_use.load();
  work();
  return static_cast<double>(most - before);
}

}  // namespace

void* operator new(std::size_t size) {
  void* memory = std::malloc(size);
  if (!memory) throw std::bad_alloc();
  const std::size_t now = in_use += ::malloc_usable_size(memory);
  for (std::size_t seen = most; seen < now && !most.compare_exchange_weak(seen, now);) {
  }
  return memory;
}
void operator delete(void* memory) noexcept {
  if (memory) in_use -= ::malloc_usable_size(memory);
  std::free(memory);
}
void operator delete(void* memory, std::size_t) noexcept { operator delete(memory); }

int main(int argc, char** argv) {
  const int runs = argc > 1 ? std::atoi(argv[1]) : 3;
  for (const std::size_t count : {10'000U, 100'000U, 1'000'000U}) {
    const std::vector<Sphere> balls = random_balls(count);
    UnionMeasures ours;
    const double bytes = peak_bytes([&] { ours = measure_union(std::span(balls)); }) / static_cast<double>(count);
    const auto times = bench::paired(
        runs, [&] { ours = measure_union(std::span(balls)); }, [&] { triangulate(balls); });
    std::printf(
        "%8zu random balls  ours %8.3f s  %7.0f balls/s  %4.0f bytes/ball   CGAL triangulation alone %8.3f s  "
        "CGAL/ours %.2f\n",
        count, times.a, static_cast<double>(count) / times.a, bytes, times.b, times.ratio);
    if (count == 10'000) print_peers(balls, ours);
    std::fflush(stdout);
  }
  const std::filesystem::path file = std::filesystem::path(SPHERULE_SHARED_DATA) / "ch2.nii.gz";
  if (!std::filesystem::exists(file)) return 0;
  const Volume volume = read_volume({file});
  const ObjectRule rule = bench::threshold(60.5);
  const BuiltModel built = build_model(volume, rule);
  const Solid& solid = *built.model.solid;
  const double bytes = peak_bytes([&] { measure_raw_union(built.model); });
  std::printf("raw head: %.0f bytes an inside cell\n", bytes / static_cast<double>(solid.inside_count));
  for (const unsigned threads : {1U, 2U}) {
    const Context context{.threads = threads, .cancel = {}, .progress = {}};
    const auto times = bench::paired(
        runs, [&] { measure_raw_union(built.model, context); },
        [&] { tetrahedralize(solid.boundary.points, context); });
    std::printf(
        "raw head, %zu spheres, %u thread(s)  union %.2f s  tetrahedralization %.2f s  tetrahedralization/union %.2f\n",
        built.model.spheres.size(), threads, times.a, times.b, times.ratio);
    std::fflush(stdout);
  }
}
