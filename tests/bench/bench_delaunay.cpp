// SPDX-License-Identifier: GPL-3.0-or-later
//
// Our tetrahedralization against plain CGAL: Delaunay_triangulation_3 with the EPICK kernel, sequential, from the same
// points to the same list of four indices a cell. On points as they lie on the grid, and on the same points moved by up
// to an eighth of a voxel.
#include <CGAL/Delaunay_triangulation_3.h>
#include <CGAL/Exact_predicates_inexact_constructions_kernel.h>
#include <CGAL/Triangulation_vertex_base_with_info_3.h>

#include <cstdio>
#include <random>

#include "core/boundary.h"
#include "core/delaunay.h"
#include "tests/bench/scans.h"

using namespace spherule;

namespace {

using Kernel = CGAL::Exact_predicates_inexact_constructions_kernel;
using Peer = CGAL::Delaunay_triangulation_3<
    Kernel, CGAL::Triangulation_data_structure_3<CGAL::Triangulation_vertex_base_with_info_3<std::uint32_t, Kernel>,
                                                 CGAL::Delaunay_triangulation_cell_base_3<Kernel>>>;

Tetrahedralization by_peer(const std::vector<LatticePoint>& points) {
  std::vector<std::pair<Kernel::Point_3, std::uint32_t>> input;
  input.reserve(points.size());
  for (const LatticePoint p : points)
    input.emplace_back(Kernel::Point_3(p.x, p.y, p.z), static_cast<std::uint32_t>(input.size()));
  const Peer triangulation(input.begin(), input.end());
  Tetrahedralization cells;
  cells.reserve(triangulation.number_of_finite_cells());
  for (const auto cell : triangulation.finite_cell_handles()) {
    cells.push_back(
        {cell->vertex(0)->info(), cell->vertex(1)->info(), cell->vertex(2)->info(), cell->vertex(3)->info()});
  }
  return cells;
}

std::vector<LatticePoint> jittered(std::vector<LatticePoint> points, const Lattice& lattice) {
  std::mt19937 random(1);
  const std::int32_t eighth = (lattice.plane(0, 1) - lattice.plane(0, 0)) / 8;
  const auto move = [&](std::int32_t v) {
    const auto by = static_cast<std::int32_t>(random() % static_cast<std::uint32_t>(2 * eighth + 1)) - eighth;
    return std::clamp(v + by, 0, (1 << Lattice::coordinate_bits) - 1);
  };
  for (LatticePoint& p : points) p = {move(p.x), move(p.y), move(p.z)};
  return points;
}

void compare(const char* kind, const std::string& name, const std::vector<LatticePoint>& points, int runs) {
  std::size_t ours_cells = 0, peer_cells = 0;
  const auto times = bench::paired(
      runs, [&] { ours_cells = tetrahedralize(points).size(); }, [&] { peer_cells = by_peer(points).size(); });
  const double n = static_cast<double>(points.size());
  std::printf("%-38s %-8s %8zu points  ours %6.2f us/point  CGAL %6.2f us/point  CGAL/ours %.2f  cells %s\n",
              name.c_str(), kind, points.size(), 1e6 * times.a / n, 1e6 * times.b / n, times.ratio,
              ours_cells == peer_cells ? "equal" : "DIFFER");
  std::fflush(stdout);
}

}  // namespace

int main(int argc, char** argv) {
  const int runs = argc > 1 ? std::atoi(argv[1]) : 5;
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  for (const bench::Scan& scan : bench::scans()) {
    const bool chosen = scan.file == "ch2.nii.gz" || scan.file == "engine.raw" ||
                        scan.rule.kind == ObjectRule::Kind::labels || scan.file == "abdomen-ct.nii.gz";
    if (!chosen || !std::filesystem::exists(folder / scan.file)) continue;
    const Volume volume = bench::read(scan, folder);
    const BoundaryPoints boundary = extract_boundary(volume, scan.rule, classify_samples(volume, scan.rule));
    compare("as is", bench::name_of(scan), boundary.points, runs);
    compare("jittered", bench::name_of(scan), jittered(boundary.points, boundary.lattice), runs);
  }
}
