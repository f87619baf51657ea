// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/config.h"

#include <gtest/gtest.h>

#include <fstream>
#include <map>
#include <string>
#include <vector>

#include "core/base/error.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using namespace std::chrono_literals;
using enum CommandLine::Command;

using Variables = std::map<std::string, std::string>;

CommandLine parse(const std::vector<const char*>& arguments, const Variables& variables = {}) {
  return parse_command_line(arguments, [&](const char* name) {
    const auto found = variables.find(name);
    return found == variables.end() ? nullptr : found->second.c_str();
  });
}

Config config_of(const std::vector<const char*>& arguments, const Variables& variables = {}) {
  return parse(arguments, variables).config;
}

std::string refusal(const std::vector<const char*>& arguments, const Variables& variables = {}) {
  try {
    parse(arguments, variables);
    return "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    return error.what();
  }
}

/// A configuration file with this text.
class ConfigFile : public testing::Test {
 protected:
  const char* file(const std::string& text) {
    std::ofstream(path_) << text;
    return path_.c_str();
  }
  test::TemporaryFolder folder;

 private:
  const std::string path_ = folder.path() / "spherule.toml";
};

const std::string digest(64, 'a');

TEST(Config, DefaultsListenOnLoopbackWithAllProcessors) {
  const CommandLine line = parse({});
  EXPECT_EQ(line.command, serve);
  EXPECT_EQ(line.config.host, "127.0.0.1");
  EXPECT_EQ(line.config.port, 8080);
  EXPECT_GE(line.config.threads, 1U);
  EXPECT_GT(line.config.job_memory_bytes, std::uint64_t{1} << 26);
  EXPECT_EQ(line.config.catalog_file(), "spherule-data/catalog.sqlite");
  EXPECT_EQ(line.config.audit_log, "spherule-data/audit.log");
  EXPECT_EQ(line.config.keep_volumes, 0s);
}

TEST(Config, ReadsBothFormsOfFlags) {
  const Config config =
      config_of({"--port", "0", "--data=/some where/=x", "--threads=6", "--jobs-at-once", "4", "--host", "::1",
                 "--max-body-bytes", "3G", "--model-cache-bytes=0", "--keep-answers", "2d", "--drain=90"});
  EXPECT_EQ(config.port, 0);
  EXPECT_EQ(config.data, "/some where/=x");
  EXPECT_EQ(config.threads, 6U);
  EXPECT_EQ(config.threads_per_job(), 1U);
  EXPECT_EQ(config.host, "::1");
  EXPECT_EQ(config.max_body_bytes, std::uint64_t{3} << 30);
  EXPECT_EQ(config.model_cache_bytes, 0U);
  EXPECT_EQ(config.keep_answers, 48h);
  EXPECT_EQ(config.drain, 90s);
}

TEST(Config, EachJobHasAThread) {
  Config config;
  config.threads = 2;
  config.jobs_at_once = 3;
  EXPECT_EQ(config.threads_per_job(), 1U);
  config.threads = 8;
  EXPECT_EQ(config.threads_per_job(), 2U);
}

TEST_F(ConfigFile, FlagsGoBeforeTheEnvironmentAndThatBeforeTheFile) {
  const char* path = file("port = 1001\nthreads = 11\nmax_voxels = 111\nmax_body_bytes = '2K'\nkeep_jobs = '1h'\n");
  const Variables variables = {
      {"SPHERULE_CONFIG", path}, {"SPHERULE_THREADS", "12"}, {"SPHERULE_PORT", "1002"}, {"SPHERULE_MAX_SPHERES", ""}};
  const Config config = config_of({"--port", "1003"}, variables);
  EXPECT_EQ(config.port, 1003);
  EXPECT_EQ(config.threads, 12U);
  EXPECT_EQ(config.max_voxels, 111U);
  EXPECT_EQ(config.max_body_bytes, 2048U);
  EXPECT_EQ(config.keep_jobs, 1h);
  EXPECT_EQ(config.max_spheres, Config().max_spheres);
  EXPECT_EQ(config_of({"--config", path}).port, 1001);
  EXPECT_EQ(config_of({"--config", path}, {{"SPHERULE_CONFIG", "elsewhere"}}).port, 1001);
}

TEST_F(ConfigFile, HoldsKeys) {
  const std::string one = "ward-3:write:" + digest, two = "it.ops:admin:" + std::string(64, '0');
  const Config config = config_of({"--config", file("host = '0.0.0.0'\nkeys = ['" + one + "', \"" + two + "\"]\n")});
  const std::vector<ApiKey> expected = {{"ward-3", Scope::write, digest},
                                        {"it.ops", Scope::admin, std::string(64, '0')}};
  EXPECT_EQ(config.keys, expected);
  EXPECT_EQ(config_of({}, {{"SPHERULE_KEYS", one + "," + two}}).keys, expected);
}

TEST_F(ConfigFile, RefusesByNameAndLine) {
  EXPECT_NE(refusal({"--config", file("\n\nprot = 1\n")}).find("prot (line 3 of the configuration file) is not a"),
            std::string::npos);
  EXPECT_NE(refusal({"--config", file("port = 70000")}).find("port (line 1 of the configuration file) needs a whole"),
            std::string::npos);
  for (const char* value : {"-1", "1.5", "true", "{}", "[1]", "1979-05-27", "'x'"})
    EXPECT_NE(refusal({"--config", file(std::string("port = ") + value)}).find("port (line 1"), std::string::npos)
        << value;
  EXPECT_NE(refusal({"--config", file("port = 1\nport = 2\n")}).find("no TOML at line 2"), std::string::npos);
  EXPECT_NE(refusal({"--config", file("[server]\nport = 1\n")}).find("server (line 1"), std::string::npos);
  EXPECT_NE(refusal({"--config", (folder.path() / "none").c_str()}).find("cannot be read"), std::string::npos);
}

TEST_F(ConfigFile, PrintsWhatItReads) {
  const std::string key = "ward:write:" + digest;
  Variables variables = {{"SPHERULE_KEYS", key}};
  const Config config = config_of({"--port", "81", "--data", "a \"b\"\\c", "--keep-models", "3d"}, variables);
  const std::string text = to_toml(config);
  EXPECT_EQ(text.find(digest), std::string::npos);
  EXPECT_NE(text.find("keys = [\"ward:write:…\"]\n"), std::string::npos);
  std::string readable = text;
  readable.replace(readable.find("…"), std::string("…").size(), digest);
  const Config again = config_of({"--config", file(readable)});
  EXPECT_EQ(to_toml(again), text);
  EXPECT_EQ(again.data, "a \"b\"\\c");
  EXPECT_EQ(again.keep_models, 72h);
  EXPECT_EQ(again.keys, config.keys);
}

TEST(Config, HelpNamesEverySetting) {
  EXPECT_EQ(parse({"--help"}).command, help);
  EXPECT_EQ(parse({"fsck", "--port", "1", "-h"}).command, help);
  const std::string text = usage(), file = to_toml(Config());
  for (const char* word : {"fsck", "backup DIR", "restore DIR", "key NAME", "--check-config", "--print-config"})
    EXPECT_NE(text.find(word), std::string::npos) << word;
  std::size_t count = 0;
  for (std::size_t at = 0; (at = file.find(" = ", at)) != std::string::npos; ++at, ++count) {
    const std::size_t begin = file.rfind('\n', at) + 1;
    std::string flag = "--" + file.substr(begin, at - begin);
    std::replace(flag.begin(), flag.end(), '_', '-');
    EXPECT_NE(text.find("  " + flag + " "), std::string::npos) << flag;
  }
  EXPECT_GE(count, 20U);
}

TEST(Config, KnowsCommands) {
  EXPECT_EQ(parse({"serve"}).command, serve);
  EXPECT_EQ(parse({"--check-config", "--port", "9"}).command, check_config);
  EXPECT_EQ(parse({"--port", "9", "--print-config"}).command, print_config);
  EXPECT_FALSE(parse({"fsck"}).repair);
  EXPECT_TRUE(parse({"fsck", "--repair", "--data", "d"}).repair);
  const CommandLine copy = parse({"backup", "elsewhere", "--data", "d"});
  EXPECT_EQ(copy.command, backup);
  EXPECT_EQ(copy.operand, "elsewhere");
  EXPECT_EQ(copy.config.data, "d");
  EXPECT_EQ(parse({"restore", "elsewhere"}).command, restore);
  const CommandLine made = parse({"key", "ward-3", "--scope", "write"}, {{"SPHERULE_CONFIG", "not read"}});
  EXPECT_EQ(made.command, key);
  EXPECT_EQ(made.operand, "ward-3");
  EXPECT_EQ(made.scope, Scope::write);
  EXPECT_EQ(parse({"key", "x"}).scope, Scope::read);
}

TEST(Config, RefusesByName) {
  EXPECT_NE(refusal({"--prot", "1"}).find("--prot is not a flag"), std::string::npos);
  EXPECT_NE(refusal({"file.nii"}).find("file.nii is not a command"), std::string::npos);
  EXPECT_NE(refusal({"--port"}).find("--port needs a value"), std::string::npos);
  EXPECT_NE(refusal({"--data="}).find("--data needs a value"), std::string::npos);
  EXPECT_NE(refusal({"backup"}).find("backup needs a DIR"), std::string::npos);
  EXPECT_NE(refusal({"key", "--scope"}).find("key needs a NAME"), std::string::npos);
  EXPECT_NE(refusal({"key", "x y"}).find("NAME:SCOPE:SHA256"), std::string::npos);
  EXPECT_NE(refusal({"key", "x", "--scope", "all"}).find("read, write or admin"), std::string::npos);
  EXPECT_NE(refusal({"--repair"}).find("--repair is not a flag"), std::string::npos);
  EXPECT_NE(refusal({}, {{"SPHERULE_PORT", "tcp://10.0.0.1:80"}}).find("SPHERULE_PORT needs a whole number"),
            std::string::npos);
  for (const char* port : {"-1", "65536", "80x", "8K", " 80", "1e3", "99999999999999999999"})
    EXPECT_NE(refusal({"--port", port}).find("--port needs a whole number from 0 to 65535"), std::string::npos) << port;
  for (const char* size : {"0", "K", "1KB", "9999999999G", "-1", "1T", "1s"})
    EXPECT_NE(refusal({"--max-body-bytes", size}).find("at least 1"), std::string::npos) << size;
  for (const char* time : {"", "d", "1w", "1K", "-1s", "99999999999999999d"})
    EXPECT_NE(refusal({"--keep-jobs", time}).find("--keep-jobs needs"), std::string::npos) << time;
  EXPECT_NE(refusal({"--queue-length", "0"}).find("from 1"), std::string::npos);
}

// What the program multiplies, adds up and counts in smaller units stays within its integers.
TEST(Config, RefusesAmountsThatWouldOverflow) {
  for (const char* flag : {"--keep-volumes", "--keep-models", "--keep-answers", "--keep-jobs"}) {
    for (const char* time : {"10000000000000", "3153600001", "36501d", "9223372036854775807", "18446744073709551615"})
      EXPECT_NE(refusal({flag, time}).find(std::string(flag) + " needs a whole number from 0 to 3153600000"),
                std::string::npos)
          << flag << " " << time;
  }
  EXPECT_EQ(config_of({"--keep-volumes", "36500d"}).keep_volumes, 24h * 36500);
  EXPECT_LT(config_of({"--keep-volumes", "3153600000"}).keep_volumes, std::chrono::microseconds::max() / 1000);
  for (const char* flag : {"--max-body-bytes", "--max-decompressed-bytes", "--job-memory-bytes", "--model-cache-bytes",
                           "--max-answer-bytes"}) {
    for (const char* size : {"9223372036854775807", "1125899906842625", "1048577G", "8796093022207G"})
      EXPECT_NE(refusal({flag, size}).find(std::string(flag) + " needs"), std::string::npos) << flag << " " << size;
    EXPECT_NO_THROW(config_of({flag, "1048576G"})) << flag;
  }
  for (const char* flag : {"--max-voxels", "--max-boundary-points", "--max-spheres", "--max-image-pixels"})
    EXPECT_NE(refusal({flag, "9223372036854775807"}).find(std::string(flag) + " needs"), std::string::npos) << flag;
  EXPECT_NE(refusal({"--drain", "1441m"}).find("--drain needs a whole number from 0 to 86400"), std::string::npos);
}

TEST(Config, RefusesWhatDoesNotGoTogether) {
  EXPECT_NE(refusal({"--tls-key", "x"}).find("go together"), std::string::npos);
  const std::string key = "a:read:" + digest;
  EXPECT_NE(refusal({"--keys", (key + "," + key).c_str()}).find("Two keys have the name a"), std::string::npos);
  for (const char* host : {"0.0.0.0", "::", "192.168.1.1", "example.org", "128.0.0.1", "127.evil.org"}) {
    EXPECT_NE(refusal({"--host", host}).find("loopback"), std::string::npos) << host;
    EXPECT_EQ(config_of({"--host", host, "--keys", key.c_str()}).host, host);
  }
  for (const char* host : {"localhost", "127.0.0.1", "127.8.9.1", "::1"})
    EXPECT_EQ(config_of({"--host", host}).host, host);
}

// A token that somebody put where its digest belongs must not end up in a terminal's or a service's log.
TEST(Config, DoesNotRepeatKeysThatItRefuses) {
  const std::string token = new_token();
  EXPECT_EQ(refusal({"--keys", ("a:read:" + token).c_str()}).find(token.substr(4)), std::string::npos);
}

}  // namespace
}  // namespace spherule::server
