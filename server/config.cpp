// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/config.h"

#include <toml++/toml.h>
#include <algorithm>
#include <array>
#include <charconv>
#include <concepts>
#include <fstream>
#include <limits>
#include <set>
#include <system_error>
#include <thread>
#include <type_traits>
#include <variant>

#include "core/base/error.h"
#include "server/base/machine_memory.h"

namespace spherule::server {

namespace {

namespace fs = std::filesystem;
using std::chrono::seconds;

// More than any of them will be, and with room to be counted in smaller units, added up and compared.
constexpr std::uint64_t many = std::uint64_t{1} << 40;                     // things
constexpr std::uint64_t many_bytes = std::uint64_t{1} << 50;               // a pebibyte
constexpr std::uint64_t many_seconds = std::uint64_t{100} * 365 * 86'400;  // a hundred years

using Field = std::variant<std::string Config::*, fs::path Config::*, std::uint16_t Config::*, unsigned Config::*,
                           std::uint64_t Config::*, seconds Config::*, std::vector<ApiKey> Config::*>;

struct Setting {
  std::string_view key, placeholder, meaning;
  Field field;
  std::uint64_t least = 0, most = 0;  // of numbers
};

const std::array settings = {
    Setting{"host", "ADDRESS", "address to listen on; without keys a loopback address", &Config::host},
    Setting{"hosts", "NAME,...",
            "names of this server: requests for others are refused; loopback names always are its own", &Config::hosts},
    Setting{"port", "N", "port to listen on; 0: any free one", &Config::port, 0, 65535},
    Setting{"tls_certificate", "FILE", "PEM chain; with tls_key the server speaks HTTPS", &Config::tls_certificate},
    Setting{"tls_key", "FILE", "PEM private key of the certificate", &Config::tls_key},
    Setting{"keys", "KEY,...", "who may use the server, NAME:SCOPE:SHA256 each (see `spheruled key`)", &Config::keys},
    Setting{"data", "DIR", "folder of the catalogue and the blobs; made if needed", &Config::data},
    Setting{"audit_log", "FILE", "who did what; empty: audit.log in the data folder", &Config::audit_log},
    Setting{"threads", "N", "threads for computing, all jobs together; 0: one a processor", &Config::threads, 0, 1024},
    Setting{"jobs_at_once", "N", "jobs that run side by side, sharing the threads", &Config::jobs_at_once, 1, 256},
    Setting{"job_memory_bytes", "BYTES",
            "memory for running jobs, by estimate; 0: three quarters of the machine's or container's",
            &Config::job_memory_bytes, 0, many_bytes},
    Setting{"queue_length", "N", "jobs that may wait", &Config::queue_length, 1, 1'000'000},
    Setting{"queue_per_client", "N", "jobs of one client that may wait", &Config::queue_per_client, 1, 1'000'000},
    Setting{"drain", "TIME", "how long running jobs may go on once the server is told to stop", &Config::drain, 0,
            86400},
    Setting{"keep_volumes", "TIME", "delete volumes not used for so long, with all made from them; 0: never",
            &Config::keep_volumes, 0, many_seconds},
    Setting{"keep_models", "TIME", "delete models not used for so long; 0: never", &Config::keep_models, 0,
            many_seconds},
    Setting{"keep_answers", "TIME", "delete stored answers (pictures, exports …) not used for so long; 0: never",
            &Config::keep_answers, 0, many_seconds},
    Setting{"keep_jobs", "TIME", "forget jobs that ended so long ago; 0: never", &Config::keep_jobs, 0, many_seconds},
    Setting{"max_answer_bytes", "BYTES",
            "stored answers together; the least recently used go first, and are made again when asked for; 0: no limit",
            &Config::max_answer_bytes, 0, many_bytes},
    Setting{"max_body_bytes", "BYTES", "largest request", &Config::max_body_bytes, 1, many_bytes},
    Setting{"max_decompressed_bytes", "BYTES", "largest volume, unpacked", &Config::max_decompressed_bytes, 1,
            many_bytes},
    Setting{"max_voxels", "N", "most samples of a volume", &Config::max_voxels, 1, many},
    Setting{"max_boundary_points", "N", "most boundary points of a model", &Config::max_boundary_points, 1, many},
    Setting{"max_spheres", "N", "most spheres of an imported set", &Config::max_spheres, 1, many},
    Setting{"max_image_pixels", "N", "most pixels of a picture", &Config::max_image_pixels, 1, many},
    Setting{"max_job_s", "N", "seconds that one job may run; then it has failed", &Config::max_job_s, 1, 31'536'000},
    Setting{"max_wait_s", "N", "seconds that a request may wait for its job", &Config::max_wait_s, 0, 86400},
    Setting{"max_streams", "N", "event streams at once", &Config::max_streams, 0, 100'000},
    Setting{"max_connections_per_address", "N", "connections of one address at once; loopback addresses have no limit",
            &Config::max_connections_per_address, 1, 1'000'000},
    Setting{"cors_origins", "ORIGIN,...", "whose pages may read answers; *: all", &Config::cors_origins},
    Setting{"model_cache_bytes", "BYTES", "memory for sphere models that were used lately", &Config::model_cache_bytes,
            0, many_bytes},
};

std::string flag_of(std::string_view key) {
  std::string flag = "--" + std::string(key);
  std::ranges::replace(flag, '_', '-');
  return flag;
}

std::string variable_of(std::string_view key) {
  std::string variable = "SPHERULE_" + std::string(key);
  std::ranges::transform(variable, variable.begin(), [](char c) { return c >= 'a' && c <= 'z' ? c - 32 : c; });
  return variable;
}

[[noreturn]] void refuse(const std::string& sentence) {
  throw Error(ErrorCode::invalid_argument, sentence + "; --help lists what there is.");
}

/// Units that may follow a number, and what each multiplies it by.
struct Unit {
  char letter;
  std::uint64_t factor;
};
std::span<const Unit> units_of(const Setting& setting) {
  static constexpr std::array<Unit, 3> bytes = {{{'K', 1 << 10}, {'M', 1 << 20}, {'G', 1 << 30}}};
  static constexpr std::array<Unit, 4> times = {{{'s', 1}, {'m', 60}, {'h', 3600}, {'d', 86400}}};
  if (setting.placeholder == "BYTES") return bytes;
  if (setting.placeholder == "TIME") return times;
  return {};
}

std::uint64_t parse_number(const Setting& setting, const std::string& source, std::string_view text) {
  std::uint64_t value = 0;
  auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), value);
  bool valid = error == std::errc();
  if (valid && end + 1 == text.data() + text.size()) {
    const auto units = units_of(setting);
    const auto unit = std::ranges::find(units, *end, &Unit::letter);
    valid = unit != units.end() && value <= setting.most / unit->factor;
    if (valid) value *= unit->factor;
    ++end;
  }
  valid = valid && end == text.data() + text.size();
  if (!valid || value < setting.least || value > setting.most) {
    std::string allowed =
        "a whole number from " + std::to_string(setting.least) + " to " + std::to_string(setting.most);
    if (setting.placeholder == "BYTES")
      allowed = "a whole number of at least " + std::to_string(setting.least) + " and at most " +
                std::to_string(setting.most) + ", optionally with K, M or G";
    if (setting.placeholder == "TIME") allowed += ", in seconds or with s, m, h or d";
    refuse(source + " needs " + allowed);
  }
  return value;
}

std::vector<ApiKey> parse_keys(const std::string& source, std::string_view text) {
  std::vector<ApiKey> keys;
  while (!text.empty()) {
    const std::size_t comma = std::min(text.find(','), text.size());
    try {
      keys.push_back(key_from(text.substr(0, comma)));
    } catch (const Error& error) {
      // Not what was given: it may be a token in the wrong place.
      throw Error(error.code(), source + ": " + error.what());
    }
    text.remove_prefix(std::min(comma + 1, text.size()));
  }
  return keys;
}

/// `source` says where the value was given. Lists are text with commas between.
void set(Config& config, const Setting& setting, const std::string& source, std::string_view text) {
  if (text.empty() && setting.placeholder != "FILE" && !setting.placeholder.ends_with(",..."))
    refuse(source + " needs a value");
  std::visit(
      [&](auto field) {
        using Value = std::remove_reference_t<decltype(config.*field)>;
        if constexpr (std::integral<Value> || std::same_as<Value, seconds>)
          config.*field = static_cast<Value>(parse_number(setting, source, text));
        else if constexpr (std::same_as<Value, std::vector<ApiKey>>)
          config.*field = parse_keys(source, text);
        else
          config.*field = text;
      },
      setting.field);
}

const Setting* find_setting(auto&& matches) {
  const auto found = std::ranges::find_if(settings, matches);
  return found == settings.end() ? nullptr : &*found;
}

/// A TOML value as the text that a flag would have.
std::string text_of(const toml::node& value, const std::string& source) {
  if (const auto* text = value.as_string()) return text->get();
  if (const auto* number = value.as_integer(); number != nullptr && number->get() >= 0)
    return std::to_string(number->get());
  const auto* list = value.as_array();
  if (list == nullptr) refuse(source + " needs a whole number, a text or a list of texts");
  std::string joined;
  for (const toml::node& item : *list) {
    const auto* text = item.as_string();
    if (text == nullptr) refuse(source + " needs a list of texts");
    joined += (joined.empty() ? "" : ",") + text->get();
  }
  return joined;
}

void read_file(Config& config, const std::string& path) {
  std::ifstream file(path, std::ios::binary);
  if (!file) refuse("The configuration file cannot be read");
  toml::table table;
  try {
    table = toml::parse(file);
  } catch (const toml::parse_error& error) {
    refuse("The configuration file is no TOML at line " + std::to_string(error.source().begin.line) + ": " +
           std::string(error.description()));
  }
  for (const auto& [key, value] : table) {
    const std::string source =
        std::string(key.str()) + " (line " + std::to_string(key.source().begin.line) + " of the configuration file)";
    const Setting* setting = find_setting([&](const Setting& s) { return s.key == key.str(); });
    if (setting == nullptr) refuse(source + " is not a setting of this server");
    set(config, *setting, source, text_of(value, source));
  }
}

void validate(Config& config) {
  if (config.tls_certificate.empty() != config.tls_key.empty())
    refuse("tls_certificate and tls_key go together; give both or none");
  if (config.keys.empty() && !is_loopback(config.host))
    refuse(
        "Without keys the server listens on a loopback address only, because whoever reaches it may do everything; "
        "give keys (`spheruled key NAME` makes one), or host 127.0.0.1");
  static_cast<void>(hosts_from(config.hosts));  // refuses what is no name
  std::set<std::string_view> names;
  for (const ApiKey& key : config.keys)
    if (!names.insert(key.name).second) refuse("Two keys have the name " + key.name + "; give each its own");
  if (config.audit_log.empty()) config.audit_log = config.data / "audit.log";
  if (config.threads == 0) config.threads = std::max(1U, std::thread::hardware_concurrency());
  if (config.job_memory_bytes == 0) config.job_memory_bytes = memory_there_is() / 4 * 3;
}

/// The value as a flag takes it.
std::string text_of(const Config& config, const Setting& setting) {
  return std::visit(
      [&](auto field) -> std::string {
        using Value = std::remove_cvref_t<decltype(config.*field)>;
        if constexpr (std::integral<Value>)
          return std::to_string(config.*field);
        else if constexpr (std::same_as<Value, seconds>)
          return std::to_string((config.*field).count());
        else if constexpr (std::same_as<Value, std::vector<ApiKey>>)
          return {};
        else
          return config.*field;
      },
      setting.field);
}

std::string toml_text(std::string_view text) {
  std::string result = "\"";
  for (const char c : text) {
    if (c == '"' || c == '\\') result += '\\';
    if (static_cast<unsigned char>(c) < 0x20)
      result += {'\\', 'u', '0', '0', static_cast<char>('0' + (c >> 4)), "0123456789ABCDEF"[c & 15]};
    else
      result += c;
  }
  return result + '"';
}

struct Named {
  std::string_view name;
  CommandLine::Command command;
  std::string_view operand;
};
using enum CommandLine::Command;
constexpr std::array<Named, 5> commands = {{{"serve", serve, ""},
                                            {"key", key, "NAME"},
                                            {"fsck", fsck, ""},
                                            {"backup", backup, "DIR"},
                                            {"restore", restore, "DIR"}}};

// The command that the arguments begin with, and its operand, which are taken away.
CommandLine command_of(std::span<const char* const>& arguments) {
  CommandLine line;
  if (arguments.empty() || *arguments[0] == '-') return line;
  const auto named = std::ranges::find(commands, std::string_view(arguments[0]), &Named::name);
  if (named == commands.end()) refuse(std::string(arguments[0]) + " is not a command of this server");
  line.command = named->command;
  arguments = arguments.subspan(1);
  if (named->operand.empty()) return line;
  if (arguments.empty() || *arguments[0] == '-' || *arguments[0] == '\0')
    refuse(std::string(named->name) + " needs a " + std::string(named->operand));
  line.operand = arguments[0];
  arguments = arguments.subspan(1);
  return line;
}

}  // namespace

CommandLine parse_command_line(std::span<const char* const> arguments, const Environment& environment) {
  CommandLine line = command_of(arguments);
  const char* file = environment("SPHERULE_CONFIG");
  std::string path = file != nullptr ? file : "";
  std::vector<std::tuple<const Setting*, std::string, std::string>> given;  // flags wait for the file
  for (std::size_t i = 0; i < arguments.size(); ++i) {
    const std::string_view argument = arguments[i];
    if (argument == "--help" || argument == "-h") {
      line.command = help;
      return line;
    }
    if (argument == "--check-config" || argument == "--print-config") {
      line.command = argument == "--check-config" ? check_config : print_config;
      continue;
    }
    if (argument == "--repair" && line.command == fsck) {
      line.repair = true;
      continue;
    }
    const std::size_t equals = argument.find('=');
    const std::string name(argument.substr(0, equals));
    const Setting* setting = find_setting([&](const Setting& s) { return flag_of(s.key) == name; });
    const bool scope = name == "--scope" && line.command == key;
    if (setting == nullptr && name != "--config" && !scope) refuse(name + " is not a flag of this server");
    std::string value;
    if (equals != std::string_view::npos)
      value = argument.substr(equals + 1);
    else if (++i < arguments.size())
      value = arguments[i];
    else
      refuse(name + " needs a value");
    if (scope)
      line.scope = scope_from(value);
    else if (setting == nullptr)
      path = value;
    else
      given.emplace_back(setting, name, value);
  }
  if (line.command == key) {
    static_cast<void>(key_from(line.operand + ":read:" + std::string(64, '0')));  // refuses an impossible name
    return line;
  }
  if (!path.empty()) read_file(line.config, path);
  for (const Setting& setting : settings) {
    const std::string variable = variable_of(setting.key);
    const char* value = environment(variable.c_str());
    if (value != nullptr && *value != '\0') set(line.config, setting, variable, value);
  }
  for (const auto& [setting, name, value] : given) set(line.config, *setting, name, value);
  validate(line.config);
  return line;
}

std::string usage() {
  std::string text =
      "Usage: spheruled [COMMAND] [--flag value]...\n"
      "Serves union-of-spheres models of volumetric scans over HTTP.\n\n"
      "  serve           what it does without a COMMAND\n"
      "  key NAME        make a key for a client and show what to configure (--scope read, write or admin)\n"
      "  fsck            compare the catalogue with the blobs, digests included; --repair sets damage aside\n"
      "  backup DIR      copy all data into a new folder, also while a server runs\n"
      "  restore DIR     copy a backup into the (empty) data folder\n\n"
      "  --check-config  only validate; --print-config: also print every setting as a TOML file\n"
      "  --config FILE   a TOML file of settings: --max-voxels is max_voxels there, and SPHERULE_MAX_VOXELS in the\n"
      "                  environment. Flags go before the environment, and that before the file.\n\n"
      "BYTES may end in K, M or G (powers of 1024), TIME in s, m, h or d.\n\n";
  const Config defaults;
  for (const Setting& setting : settings) {
    std::string left = "  " + flag_of(setting.key) + " " + std::string(setting.placeholder);
    left.resize(std::max<std::size_t>(left.size() + 2, 34), ' ');
    const std::string value = text_of(defaults, setting);
    text += left + std::string(setting.meaning) + (value.empty() ? "" : " (" + value + ")") + "\n";
  }
  return text;
}

std::string to_toml(const Config& config) {
  std::string text;
  for (const Setting& setting : settings) {
    text += "# " + std::string(setting.meaning) + "\n" + std::string(setting.key) + " = ";
    if (std::holds_alternative<std::vector<ApiKey> Config::*>(setting.field)) {
      std::string list;
      for (const ApiKey& key : config.keys)
        list += (list.empty() ? "" : ", ") + toml_text(key.name + ":" + std::string(to_string(key.scope)) + ":…");
      text += "[" + list + "]\n";
    } else {
      const std::string value = text_of(config, setting);
      const bool number = setting.most > 0;
      text += (number ? value : toml_text(value)) + "\n";
    }
  }
  return text;
}

}  // namespace spherule::server
