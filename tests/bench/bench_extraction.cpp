// SPDX-License-Identifier: GPL-3.0-or-later
//
// Our boundary extraction (voxels to boundary points, one thread) against VTK's Flying Edges (voxels to triangle mesh
// without normals, one thread) on the same samples; and the number of points of both, which must be equal with an open
// border.
#include <unistd.h>

#include <cstdio>
#include <fstream>

#include "core/boundary.h"
#include "tests/bench/scans.h"

using namespace spherule;

namespace {

struct Peer {
  unsigned long long points = 0;
  double seconds = 0;
};

Peer flying_edges(const Volume& volume, double threshold, const std::string& script, int runs) {
  const std::string dump =
      (std::filesystem::temp_directory_path() / ("spherule-bench-" + std::to_string(::getpid()) + ".raw")).string();
  std::ofstream(dump, std::ios::binary)
      .write(reinterpret_cast<const char*>(volume.voxels.data()), static_cast<std::streamsize>(volume.voxels.size()));
  const auto& d = volume.grid.dims;
  // Samples are compared as stored, so the threshold goes back through slope and intercept.
  char command[1024];
  std::snprintf(command, sizeof command,
                "/usr/bin/python3 '%s' '%s' %.17g --dims %d %d %d --dtype %s --spacing %.9g %.9g %.9g --repeat %d",
                script.c_str(), dump.c_str(), (threshold - volume.intercept) / volume.slope, d[0], d[1], d[2],
                std::string(name(volume.type)).c_str(), volume.grid.spacing.x, volume.grid.spacing.y,
                volume.grid.spacing.z, runs);
  Peer peer;
  if (FILE* pipe = ::popen(command, "r")) {
    if (std::fscanf(pipe, "points=%llu triangles=%*u seconds=%lf", &peer.points, &peer.seconds) != 2) peer = {};
    while (std::fgetc(pipe) != EOF) {
    }
    ::pclose(pipe);
  }
  std::filesystem::remove(dump);
  return peer;
}

}  // namespace

int main(int argc, char** argv) {
  const int runs = argc > 1 ? std::atoi(argv[1]) : 9;
  const std::filesystem::path folder = SPHERULE_SHARED_DATA;
  const std::string script = SPHERULE_BENCH_SOURCES "/flying_edges.py";
  for (bench::Scan scan : bench::scans()) {
    // One iso-value of upward values is what the peer can do.
    if (scan.rule.kind != ObjectRule::Kind::threshold || scan.rule.side == Side::below ||
        !std::filesystem::exists(folder / scan.file))
      continue;
    scan.rule.border = Border::open;
    const Volume volume = bench::read(scan, folder);
    std::size_t points = 0;
    std::vector<double> ours;
    for (int run = 0; run < runs; ++run) {
      ours.push_back(bench::seconds(
          [&] { points = extract_boundary(volume, scan.rule, classify_samples(volume, scan.rule)).points.size(); }));
    }
    const Peer peer = flying_edges(volume, scan.rule.lo, script, runs);
    const double ms = 1e3 * bench::median(ours);
    std::printf("%-34s %8zu points  VTK %8llu %s  ours %7.2f ms (%.2f Gvoxel/s)  VTK %7.2f ms  VTK/ours %.2f\n",
                bench::name_of(scan).c_str(), points, peer.points, points == peer.points ? "equal" : "DIFFER", ms,
                static_cast<double>(volume.grid.sample_count()) / ms / 1e6, 1e3 * peer.seconds,
                1e3 * peer.seconds / ms);
    std::fflush(stdout);
  }
}
