// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the fuzz targets of volume readers share: bytes become a file (readers take names), and whatever comes of it
// must be a volume that keeps volume.h's promises or an Error that keeps error.h's.
#pragma once

#include <unistd.h>

#include <cmath>
#include <cstdint>
#include <cstdlib>
#include <filesystem>
#include <fstream>
#include <string>

#include "core/read/read.h"

namespace spherule::fuzz {

/// A folder in memory with the file "jane-doe" (the input) and, for headers that name a data file, "data" of 256 bytes.
class Folder {
 public:
  Folder() : path_("/dev/shm/spherule-fuzz-" + std::to_string(getpid())) {
    std::filesystem::create_directory(path_);
    std::ofstream(path_ / "data") << std::string(256, '\7');
  }
  ~Folder() { std::filesystem::remove_all(path_); }
  Folder(const Folder&) = delete;
  Folder& operator=(const Folder&) = delete;

  std::vector<std::filesystem::path> with(const std::uint8_t* data, std::size_t size) const {
    std::ofstream(path_ / "jane-doe", std::ios::binary)
        .write(reinterpret_cast<const char*>(data), static_cast<std::streamsize>(size));
    return {path_ / "jane-doe", path_ / "data"};
  }

 private:
  std::filesystem::path path_;
};

inline void require(bool holds) {
  if (!holds) std::abort();
}

/// Small enough that nothing legitimate takes long, large enough that headers' lies matter.
inline ReadOptions options() {
  ReadOptions options;
  options.limits = {.max_voxels = 1 << 22, .max_bytes = 1 << 24, .max_header_bytes = 1 << 16};
  return options;
}

inline void check_read(const std::vector<std::filesystem::path>& files, const ReadOptions& options) {
  try {
    const Volume volume = read_volume(files, options);
    const Grid& grid = volume.grid;
    require(grid.dims[0] >= 1 && grid.dims[1] >= 1 && grid.dims[2] >= 1);
    require(volume.voxels.size() == grid.sample_count() * bytes_per_voxel(volume.type));
    require(volume.voxels.size() <= options.limits.max_bytes && grid.sample_count() <= options.limits.max_voxels);
    require(std::isfinite(volume.slope) && volume.slope != 0 && std::isfinite(volume.intercept));
    require(std::isfinite(grid.origin.x) && std::isfinite(grid.origin.y) && std::isfinite(grid.origin.z));
    for (int a = 0; a < 3; ++a) {
      require(std::isfinite(grid.spacing[a]) && grid.spacing[a] > 0);
      require(std::abs(norm(grid.direction.column(a)) - 1) < 1e-9);
      require(std::abs(dot(grid.direction.column(a), grid.direction.column((a + 1) % 3))) < 1e-9);
    }
  } catch (const Error& error) {
    const std::string sentence = error.what();
    require(sentence.ends_with('.') && sentence.find("jane") == std::string::npos &&
            sentence.find("/dev") == std::string::npos && sentence.find('\n') == std::string::npos);
  }
}

}  // namespace spherule::fuzz
