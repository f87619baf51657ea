// SPDX-License-Identifier: GPL-3.0-or-later
//
// Everything that can be set about a server, read from the command line and validated once at start.
#pragma once

#include <cstdint>
#include <filesystem>
#include <optional>
#include <span>
#include <string>

namespace spherule::server {

/// Every field has a flag (see usage()); a request over a limit is refused with too_large, never truncated.
struct Config {
  std::string host = "127.0.0.1";                ///< address to listen on; anybody who reaches it may use the server
  std::uint16_t port = 8080;                     ///< 0: any free port
  std::filesystem::path data = "spherule-data";  ///< catalogue and blobs; made if needed, used by one server at a time

  unsigned threads = 0;             ///< for computing, all jobs together; parsed 0 becomes the number of processors
  unsigned jobs_at_once = 1;        ///< they share `threads` evenly
  std::uint64_t queue_length = 64;  ///< jobs that wait; further ones are refused with busy

  std::uint64_t max_body_bytes = std::uint64_t{2} << 30;          ///< of one request, as sent
  std::uint64_t max_decompressed_bytes = std::uint64_t{8} << 30;  ///< of its samples, unpacked
  std::uint64_t max_voxels = std::uint64_t{1} << 30;              ///< samples of a volume
  std::uint64_t max_boundary_points = 50'000'000;                 ///< of a model
  std::uint64_t max_spheres = 10'000'000;                         ///< of a set that a user brings
  std::uint64_t max_image_pixels = std::uint64_t{1} << 24;        ///< width x height of a picture
  std::uint64_t max_wait_s = 60;                                  ///< cap of `Prefer: wait=N`
  std::uint64_t max_streams = 32;                                 ///< event streams at once
  std::uint64_t model_cache_bytes = std::uint64_t{1} << 30;       ///< sphere models kept in memory

  [[nodiscard]] unsigned threads_per_job() const { return threads < jobs_at_once ? 1 : threads / jobs_at_once; }
  [[nodiscard]] std::filesystem::path catalog_file() const { return data / "catalog.sqlite"; }
  [[nodiscard]] std::filesystem::path blob_folder() const { return data / "blobs"; }
};

/// Reads flags ("--port 8080" or "--port=8080"; byte counts may end in K, M, G, powers of 1024), not the program's
/// name. Nothing when --help is among them. Throws invalid_argument naming the flag that is unknown, incomplete or
/// outside its range, and what is allowed.
std::optional<Config> parse_config(std::span<const char* const> arguments);

/// The text for --help: every flag with its meaning and default.
std::string usage();

}  // namespace spherule::server
