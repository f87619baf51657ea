// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/e2e/process.h"

#include <fcntl.h>
#include <spawn.h>
#include <sys/wait.h>
#include <unistd.h>

#include <array>
#include <csignal>
#include <cstdlib>
#include <fstream>
#include <sstream>
#include <stdexcept>

extern char** environ;

namespace spherule::test {

TemporaryFolder::TemporaryFolder() {
  std::string name = (std::filesystem::temp_directory_path() / "spherule-e2e-XXXXXX").string();
  if (::mkdtemp(name.data()) == nullptr) throw std::runtime_error("no temporary folder");
  path_ = name;
}

TemporaryFolder::~TemporaryFolder() {
  std::error_code ignored;
  std::filesystem::remove_all(path_, ignored);
}

Ended run_spheruled(const std::vector<std::string>& arguments) {
  std::array<int, 2> out{};
  if (::pipe2(out.data(), O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
  std::vector<std::string> words = {SPHERULED};
  words.insert(words.end(), arguments.begin(), arguments.end());
  std::vector<char*> argv;
  for (std::string& word : words) argv.push_back(word.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
  posix_spawn_file_actions_adddup2(&actions, out[1], STDERR_FILENO);
  pid_t pid = -1;
  const int failed = ::posix_spawn(&pid, SPHERULED, &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  ::close(out[1]);
  Ended ended;
  std::array<char, 4096> piece{};
  for (ssize_t n; failed == 0 && (n = ::read(out[0], piece.data(), piece.size())) > 0;)
    ended.output.append(piece.data(), static_cast<std::size_t>(n));
  ::close(out[0]);
  int status = 0;
  if (failed == 0 && ::waitpid(pid, &status, 0) == pid && WIFEXITED(status)) ended.status = WEXITSTATUS(status);
  return ended;
}

Key make_key(const std::string& name, const std::string& scope) {
  const Ended made = run_spheruled({"key", name, "--scope", scope});
  if (made.status != 0) throw std::runtime_error("no key: " + made.output);
  const std::size_t token = made.output.find("sph_"), entry = made.output.find("\"" + name);
  return {made.output.substr(token, made.output.find('\n', token) - token),
          made.output.substr(entry + 1, made.output.find('"', entry + 1) - entry - 1)};
}

ServerProcess::ServerProcess(const std::filesystem::path& data, std::vector<std::string> flags)
    : log_(data.string() + ".log") {
  std::array<int, 2> out{};
  if (::pipe2(out.data(), O_CLOEXEC) != 0) throw std::runtime_error("no pipe");
  flags.insert(flags.begin(), {SPHERULED, "--port", "0", "--data", data.string()});
  std::vector<char*> argv;
  for (std::string& flag : flags) argv.push_back(flag.data());
  argv.push_back(nullptr);
  posix_spawn_file_actions_t actions;
  posix_spawn_file_actions_init(&actions);
  posix_spawn_file_actions_adddup2(&actions, out[1], STDOUT_FILENO);
  posix_spawn_file_actions_addopen(&actions, STDERR_FILENO, log_.c_str(), O_WRONLY | O_CREAT | O_APPEND, 0600);
  const int failed = ::posix_spawn(&pid_, SPHERULED, &actions, nullptr, argv.data(), environ);
  posix_spawn_file_actions_destroy(&actions);
  ::close(out[1]);
  std::string line;
  for (char c = 0; failed == 0 && ::read(out[0], &c, 1) == 1 && c != '\n';) line += c;
  ::close(out[0]);
  const std::size_t colon = line.rfind(':');
  if (colon == std::string::npos) {
    if (failed == 0) ::waitpid(pid_, nullptr, 0);
    pid_ = -1;
    throw std::runtime_error("spheruled did not start: " + log());
  }
  port_ = std::atoi(line.c_str() + colon + 1);
}

ServerProcess::~ServerProcess() { kill(); }

void ServerProcess::kill() {
  if (pid_ < 0) return;
  ::kill(pid_, SIGKILL);
  ::waitpid(pid_, nullptr, 0);
  pid_ = -1;
}

void ServerProcess::ask_to_stop() { ::kill(pid_, SIGTERM); }

int ServerProcess::terminate() {
  ask_to_stop();
  return await_end();
}

int ServerProcess::await_end() {
  int status = 0;
  ::waitpid(pid_, &status, 0);
  pid_ = -1;
  return WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

std::string ServerProcess::log() const {
  std::ostringstream text;
  text << std::ifstream(log_).rdbuf();
  return text.str();
}

std::size_t ServerProcess::peak_memory() const {
  std::ifstream status("/proc/" + std::to_string(pid_) + "/status");
  for (std::string line; std::getline(status, line);) {
    if (line.starts_with("VmHWM:")) return std::strtoull(line.c_str() + 6, nullptr, 10) * 1024;
  }
  return 0;
}

}  // namespace spherule::test
