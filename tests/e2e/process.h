// SPDX-License-Identifier: GPL-3.0-or-later
//
// A real server in its own process and folder, on a free port.
#pragma once

#include <sys/types.h>

#include <filesystem>
#include <string>
#include <vector>

namespace spherule::test {

/// A new folder, removed with its contents.
class TemporaryFolder {
 public:
  TemporaryFolder();
  ~TemporaryFolder();
  TemporaryFolder(const TemporaryFolder&) = delete;
  TemporaryFolder& operator=(const TemporaryFolder&) = delete;
  const std::filesystem::path& path() const { return path_; }

 private:
  std::filesystem::path path_;
};

struct Ended {
  int status = -1;     ///< exit status; -1 when a signal ended it
  std::string output;  ///< of stdout and stderr together
};
/// Runs spheruled with these arguments to its end.
Ended run_spheruled(const std::vector<std::string>& arguments);

/// What `spheruled key` prints: what a client sends, and what the configuration holds.
struct Key {
  std::string token, entry;
};
Key make_key(const std::string& name, const std::string& scope);

class ServerProcess {
 public:
  /// Starts spheruled and waits until it says where it listens. Throws runtime_error, with what it said on stderr,
  /// when it ends instead.
  explicit ServerProcess(const std::filesystem::path& data, std::vector<std::string> flags = {});
  /// Kills it unless it ended.
  ~ServerProcess();
  ServerProcess(const ServerProcess&) = delete;
  ServerProcess& operator=(const ServerProcess&) = delete;

  int port() const { return port_; }
  pid_t pid() const { return pid_; }
  /// SIGKILL, and waits for the end.
  void kill();
  /// SIGTERM.
  void ask_to_stop();
  /// The exit status; -1 when a signal ended it.
  int await_end();
  /// ask_to_stop() and await_end().
  int terminate();
  /// All that it has logged so far.
  std::string log() const;
  /// Most memory that it has had so far, bytes.
  std::size_t peak_memory() const;

 private:
  std::filesystem::path log_;
  pid_t pid_ = -1;
  int port_ = 0;
};

}  // namespace spherule::test
