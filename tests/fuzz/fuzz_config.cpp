// SPDX-License-Identifier: GPL-3.0-or-later
//
// Configuration files. What is accepted can be written down again, and says the same when it is read once more.
#include <unistd.h>

#include <array>
#include <cstdint>
#include <cstdlib>
#include <fstream>
#include <string>

#include "core/base/error.h"
#include "server/config.h"

namespace {

using namespace spherule;

const std::string& file() {
  static const std::string path = "/dev/shm/spherule-fuzz-config-" + std::to_string(getpid());
  static const int removed = std::atexit([] { ::unlink(file().c_str()); });
  static_cast<void>(removed);
  return path;
}

server::Config parsed(std::string_view toml) {
  std::ofstream(file(), std::ios::binary) << toml;
  const std::array<const char*, 3> arguments = {"--check-config", "--config", file().c_str()};
  return server::parse_command_line(arguments, [](const char*) -> const char* { return nullptr; }).config;
}

}  // namespace

extern "C" int LLVMFuzzerTestOneInput(const std::uint8_t* data, std::size_t size) {
  server::Config config;
  try {
    config = parsed({reinterpret_cast<const char*>(data), size});
  } catch (const Error& error) {
    if (!std::string(error.what()).ends_with('.')) std::abort();
    return 0;
  }
  config.keys.clear();  // are never written whole
  config.host = "127.0.0.1";
  const std::string text = to_toml(config);
  if (to_toml(parsed(text)) != text) std::abort();
  return 0;
}
