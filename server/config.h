// SPDX-License-Identifier: GPL-3.0-or-later
//
// Everything that can be set about a server, and the command line that sets it. One table in config.cpp holds every
// setting: the file's keys, the environment's names, the flags, --help, --print-config and the validation come from it.
//
// A setting `max_voxels` is `max_voxels = N` in the TOML file that --config (or SPHERULE_CONFIG) names,
// SPHERULE_MAX_VOXELS in the environment, and --max-voxels on the command line. A flag goes before the environment, the
// environment before the file, the file before the default.
#pragma once

#include <chrono>
#include <cstdint>
#include <filesystem>
#include <functional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "server/access/auth.h"

namespace spherule::server {

/// The settings; usage() explains each. A request over a limit is refused with too_large, never truncated.
struct Config {
  std::string host = "127.0.0.1";                  ///< without keys, only a loopback address is accepted
  std::string hosts;                               ///< names of this server beside those of loopback, commas between
  std::uint16_t port = 8080;                       ///< 0: any free port
  std::filesystem::path tls_certificate, tls_key;  ///< PEM; both or none
  std::vector<ApiKey> keys;                        ///< none: whoever reaches the (loopback) address may do everything

  std::filesystem::path data = "spherule-data";  ///< catalogue and blobs; made if needed, used by one server at a time
  std::filesystem::path audit_log;               ///< parsed empty becomes data / "audit.log"

  unsigned threads = 0;                 ///< for computing, all jobs together; parsed 0 becomes the number of processors
  unsigned jobs_at_once = 1;            ///< they share `threads` evenly
  std::uint64_t job_memory_bytes = 0;   ///< for all running jobs, by estimate; parsed 0 becomes 3/4 of what there is
  std::uint64_t queue_length = 64;      ///< jobs that wait; further ones are refused with busy
  std::uint64_t queue_per_client = 32;  ///< of these, one client's; further ones are refused with throttled
  std::chrono::seconds drain{10};       ///< how long a stopping server lets running jobs finish

  std::chrono::seconds keep_volumes{0}, keep_models{0}, keep_answers{0}, keep_jobs{0};  ///< unused for so long: 0 ever

  std::uint64_t max_answer_bytes = std::uint64_t{8} << 30;  ///< of stored answers together; 0: as many as there are

  std::uint64_t max_body_bytes = std::uint64_t{2} << 30;          ///< of one request, as sent
  std::uint64_t max_decompressed_bytes = std::uint64_t{8} << 30;  ///< of its samples, unpacked
  std::uint64_t max_voxels = std::uint64_t{1} << 30;              ///< samples of a volume
  std::uint64_t max_boundary_points = 50'000'000;                 ///< of a model
  std::uint64_t max_spheres = 10'000'000;                         ///< of a set that a user brings
  std::uint64_t max_image_pixels = std::uint64_t{1} << 24;        ///< width x height of a picture
  std::uint64_t max_job_s = 3600;                                 ///< that one job may run; then it fails
  std::uint64_t max_wait_s = 60;                                  ///< cap of `Prefer: wait=N`
  std::uint64_t max_streams = 32;                                 ///< event streams at once
  std::uint64_t max_connections_per_address = 1024;          ///< open at once; of loopback addresses as many as fit
  std::string cors_origins;                                  ///< whose pages may read answers, commas between
  std::uint64_t model_cache_bytes = std::uint64_t{1} << 30;  ///< sphere models kept in memory

  [[nodiscard]] unsigned threads_per_job() const { return threads < jobs_at_once ? 1 : threads / jobs_at_once; }
  [[nodiscard]] std::filesystem::path catalog_file() const { return data / "catalog.sqlite"; }
  [[nodiscard]] std::filesystem::path blob_folder() const { return data / "blobs"; }
};

/// What the program was asked to do.
struct CommandLine {
  enum class Command : std::uint8_t { serve, help, check_config, print_config, key, fsck, backup, restore };
  Command command = Command::serve;
  std::string operand;        ///< the key's NAME, or the backup's DIR
  Scope scope = Scope::read;  ///< of `key`
  bool repair = false;        ///< of `fsck`
  Config config;              ///< validated, with the zeros that mean "find out" filled in; not for help and key
};

/// The value of an environment variable; nullptr when it is not set. std::getenv is one.
using Environment = std::function<const char*(const char* name)>;

/// Reads the arguments (without the program's name), the environment and the file, and validates once. Flags are
/// "--port 8080" or "--port=8080". Throws invalid_argument naming the setting as it was given (flag, variable, or key
/// with the file's line) that is unknown, incomplete or outside its range, and what is allowed.
CommandLine parse_command_line(std::span<const char* const> arguments, const Environment& environment);

/// The text for --help: commands, and every setting with its meaning and default.
std::string usage();

/// A TOML file that sets every setting to its value in `config`, each with its meaning; the digests of keys are left
/// out.
std::string to_toml(const Config& config);

}  // namespace spherule::server
