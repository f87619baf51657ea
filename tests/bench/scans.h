// SPDX-License-Identifier: GPL-3.0-or-later
//
// The real scans of the benchmarks, and how to time two things fairly.
#pragma once

#include <algorithm>
#include <chrono>
#include <filesystem>
#include <functional>
#include <string>
#include <vector>

#include "core/inside.h"
#include "core/read/read.h"

namespace spherule::bench {

/// One object in one scan. `readme_mm3` is the voxel volume that the data's README states (measured by other programs);
/// 0 where it gives none, and then voxels times spacing.
struct Scan {
  std::string file;
  ObjectRule rule;
  double readme_mm3 = 0;
  std::optional<RawLayout> raw;
};

inline ObjectRule threshold(double t, Border border = Border::closed) {
  ObjectRule rule;
  rule.lo = t;
  rule.border = border;
  return rule;
}
inline ObjectRule label(std::int64_t l) {
  ObjectRule rule;
  rule.kind = ObjectRule::Kind::labels;
  rule.labels = {l};
  return rule;
}
inline ObjectRule below(double t) {
  ObjectRule rule = threshold(t);
  rule.side = Side::below;
  return rule;
}

inline std::vector<Scan> scans() {
  const RawLayout engine{.dims = {256, 256, 128}, .type = VoxelType::uint8, .spacing = {1, 1, 1}, .origin = {}};
  return {
      {"ch2.nii.gz", threshold(60.5), 0, {}},
      {"ch2.nii.gz", threshold(30), 3603543, {}},
      {"ct-head.mhd", threshold(1150), 5.268e5, {}},
      {"ct-head.mhd", threshold(500), 2.2267e6, {}},
      {"mr-small.mhd", threshold(30), 2.363e6, {}},
      {"stroke-t1.nii.gz", threshold(60), 889397, {}},
      {"abdomen-ct.nii.gz", threshold(200), 7.269e5, {}},
      {"abdomen-ct.nii.gz", threshold(-300), 2.340e7, {}},
      {"abdomen-ct-small-labels.nii.gz", label(5), 1.0431e6, {}},
      {"pet.nii", threshold(0.5), 1.8104e6, {}},
      {"spect.nii", threshold(1000), 1.4795e6, {}},
      {"engine.raw", threshold(80), 1131002, engine},
      {"bonsai.nii.gz", threshold(80), 1147123, {}},
      {"stent.nrrd", threshold(1000), 6535, {}},
      {"embryo.nrrd", threshold(40), 705027, {}},
      {"frog-labels.mhd", label(10), 204672 * 1.5, {}},
      {"dicom-ct-j2k-labels.nii.gz", label(5), 6.9944e5, {}},
      {"sphere-levelset.vdb", below(0), 113.01, {}},
      {"smoke-fog.vdb", threshold(0.5), 84933 * 0.47619 * 0.47619 * 0.47619, {}},
  };
}

/// The files that make up a scan: a MetaImage's data file goes with its header.
inline std::vector<std::filesystem::path> files_of(const Scan& scan, const std::filesystem::path& folder) {
  std::vector<std::filesystem::path> files{folder / scan.file};
  for (const char* extension : {".raw", ".zraw"}) {
    const auto data = std::filesystem::path(files[0]).replace_extension(extension);
    if (files[0].extension() == ".mhd" && std::filesystem::exists(data)) files.push_back(data);
  }
  return files;
}

inline Volume read(const Scan& scan, const std::filesystem::path& folder) {
  ReadOptions options;
  options.raw = scan.raw;
  return read_volume(files_of(scan, folder), options);
}

inline std::string name_of(const Scan& scan) {
  std::string rule = scan.rule.kind == ObjectRule::Kind::labels ? "label " + to_text(scan.rule.labels[0])
                                                                : std::to_string(scan.rule.lo);
  if (scan.rule.kind != ObjectRule::Kind::labels) rule.erase(rule.find_last_not_of('0') + 1);
  if (rule.back() == '.') rule.pop_back();
  return scan.file + (scan.rule.side == Side::below ? " < " : " @ ") + rule;
}

/// Wall seconds of one call.
inline double seconds(const std::function<void()>& work) {
  const auto begin = std::chrono::steady_clock::now();
  work();
  return std::chrono::duration<double>(std::chrono::steady_clock::now() - begin).count();
}

inline double median(std::vector<double> values) {
  std::ranges::sort(values);
  const std::size_t n = values.size();
  return n % 2 == 1 ? values[n / 2] : (values[n / 2 - 1] + values[n / 2]) / 2;
}

/// Medians of two works done in turn, A B A B …, and of their ratio B / A pair by pair, which a drifting clock does not
/// bend.
struct Paired {
  double a, b, ratio;
};
inline Paired paired(int runs, const std::function<void()>& a, const std::function<void()>& b) {
  std::vector<double> as, bs, ratios;
  for (int run = 0; run < runs; ++run) {
    as.push_back(seconds(a));
    bs.push_back(seconds(b));
    ratios.push_back(bs.back() / as.back());
  }
  return {median(as), median(bs), median(ratios)};
}

}  // namespace spherule::bench
