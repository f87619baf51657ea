// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/config.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <concepts>
#include <limits>
#include <string_view>
#include <system_error>
#include <thread>
#include <type_traits>
#include <variant>

#include "core/base/error.h"

namespace spherule::server {

namespace {

constexpr std::uint64_t many = std::numeric_limits<std::int64_t>::max();

using Field = std::variant<std::string Config::*, std::filesystem::path Config::*, std::uint16_t Config::*,
                           unsigned Config::*, std::uint64_t Config::*>;

struct Flag {
  std::string_view name, placeholder, meaning;
  Field field;
  std::uint64_t least = 0, most = 0;  // of numbers
};

const std::array flags = {
    Flag{"--host", "ADDRESS", "address to listen on; anybody who reaches it may use the server", &Config::host},
    Flag{"--port", "N", "port to listen on; 0: any free one", &Config::port, 0, 65535},
    Flag{"--data", "DIR", "folder of the catalogue and the blobs; made if needed", &Config::data},
    Flag{"--threads", "N", "threads for computing, all jobs together; 0: one a processor", &Config::threads, 0, 1024},
    Flag{"--jobs-at-once", "N", "jobs that run side by side, sharing the threads", &Config::jobs_at_once, 1, 256},
    Flag{"--queue-length", "N", "jobs that may wait", &Config::queue_length, 1, 1'000'000},
    Flag{"--max-body-bytes", "BYTES", "largest request", &Config::max_body_bytes, 1, many},
    Flag{"--max-decompressed-bytes", "BYTES", "largest volume, unpacked", &Config::max_decompressed_bytes, 1, many},
    Flag{"--max-voxels", "N", "most samples of a volume", &Config::max_voxels, 1, many},
    Flag{"--max-boundary-points", "N", "most boundary points of a model", &Config::max_boundary_points, 1, many},
    Flag{"--max-spheres", "N", "most spheres of an imported set", &Config::max_spheres, 1, many},
    Flag{"--max-image-pixels", "N", "most pixels of a picture", &Config::max_image_pixels, 1, many},
    Flag{"--max-wait-s", "SECONDS", "longest time that a request may wait for its job", &Config::max_wait_s, 0, 86400},
    Flag{"--max-streams", "N", "event streams at once", &Config::max_streams, 0, 100'000},
    Flag{"--model-cache-bytes", "BYTES", "memory for sphere models that were used lately", &Config::model_cache_bytes,
         0, many},
};

[[noreturn]] void refuse(std::string_view flag, const std::string& why) {
  throw Error(ErrorCode::invalid_argument, std::string(flag) + " " + why + "; --help lists what there is.");
}

std::uint64_t parse_number(const Flag& flag, std::string_view text) {
  std::uint64_t value = 0;
  auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  bool valid = error == std::errc();
  if (valid && flag.placeholder == "BYTES" && end + 1 == text.data() + text.size()) {
    const std::size_t power = std::string_view("KMG").find(*end) + 1;  // npos + 1 is 0
    valid = power > 0 && value <= many >> (10 * power);
    value <<= 10 * power;
    ++end;
  }
  valid = valid && end == text.data() + text.size();
  if (!valid || value < flag.least || value > flag.most)
    refuse(flag.name, "needs " +
                          (flag.most == many ? "a whole number of at least " + std::to_string(flag.least)
                                             : "a whole number from " + std::to_string(flag.least) + " to " +
                                                   std::to_string(flag.most)) +
                          (flag.placeholder == "BYTES" ? ", optionally with K, M or G" : ""));
  return value;
}

void set(Config& config, const Flag& flag, std::string_view text) {
  if (text.empty()) refuse(flag.name, "needs a value");
  std::visit(
      [&](auto field) {
        using Value = std::remove_reference_t<decltype(config.*field)>;
        if constexpr (std::integral<Value>)
          config.*field = static_cast<Value>(parse_number(flag, text));
        else
          config.*field = text;
      },
      flag.field);
}

std::string default_of(const Flag& flag) {
  const Config config;
  return std::visit(
      [&](auto field) -> std::string {
        using Value = std::remove_cvref_t<decltype(config.*field)>;
        if constexpr (std::integral<Value>)
          return std::to_string(config.*field);
        else
          return config.*field;
      },
      flag.field);
}

}  // namespace

std::optional<Config> parse_config(std::span<const char* const> arguments) {
  Config config;
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string_view argument = arguments[i];
    if (argument == "--help" || argument == "-h") return {};
    const std::size_t equals = argument.find('=');
    const std::string_view name = argument.substr(0, equals);
    const auto flag = std::find_if(flags.begin(), flags.end(), [&](const Flag& f) { return f.name == name; });
    if (flag == flags.end()) refuse(name, "is not a flag of this server");
    if (equals != std::string_view::npos)
      set(config, *flag, argument.substr(equals + 1));
    else
      set(config, *flag, ++i < arguments.size() ? arguments[i] : std::string_view());
  }
  if (config.threads == 0) config.threads = std::max(1U, std::thread::hardware_concurrency());
  return config;
}

std::string usage() {
  std::string text =
      "Usage: spheruled [flag value]...\n"
      "Serves union-of-spheres models of volumetric scans over HTTP. BYTES may end in K, M or G.\n\n";
  for (const Flag& flag : flags) {
    std::string left = "  " + std::string(flag.name) + " " + std::string(flag.placeholder);
    left.resize(std::max<std::size_t>(left.size() + 2, 36), ' ');
    text += left + std::string(flag.meaning) + " (" + default_of(flag) + ")\n";
  }
  return text + "  --help                            this text\n";
}

}  // namespace spherule::server
