// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/raw.h"

#include <algorithm>
#include <cmath>

#include "core/read/read_bytes.h"

namespace spherule {

namespace {

void require(bool holds, const char* field, const std::string& sentence) {
  if (!holds) throw Error(ErrorCode::invalid_argument, sentence, {{field, sentence}});
}

}  // namespace

Volume read_raw(const std::vector<std::filesystem::path>& files, const RawLayout& layout, const ReadOptions& options,
                const Context& context) {
  require(std::ranges::all_of(layout.dims, [](auto n) { return n >= 1; }), "dims", "Every size must be at least 1.");
  for (int a = 0; a < 3; ++a) {
    require(std::isnormal(layout.spacing[a]) && layout.spacing[a] > 0, "spacing",
            "Every spacing must be finite and above zero.");
    require(std::isfinite(layout.origin[a]), "origin", "The origin must be finite.");
  }
  require(files.size() == 1, "file", "Raw samples must come as one file.");

  Volume volume;
  volume.format = "raw";
  volume.type = layout.type;
  volume.grid = {.dims = checked_dims({layout.dims[0], layout.dims[1], layout.dims[2]}, layout.type, options.limits),
                 .spacing = layout.spacing,
                 .origin = layout.origin,
                 .direction = {}};
  try {
    require_bounded(volume.grid);
  } catch (const Error& error) {
    require(false, "spacing", error.what());
  }
  SampleSource source;
  source.files = files;
  source.big_endian = layout.big_endian;
  const bool exact = size_of_file(files[0]) == volume.grid.sample_count() * bytes_per_voxel(volume.type);
  if (!exact && is_gzip(files[0])) source.packing = Packing::deflate;
  source.frame = chosen_frame(1, options);
  read_samples(volume, source, context);
  return volume;
}

}  // namespace spherule
