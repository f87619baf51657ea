// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/log.h"

#include <gtest/gtest.h>
#include <sys/stat.h>

#include <filesystem>
#include <fstream>
#include <regex>
#include <sstream>
#include <thread>
#include <vector>

#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

namespace fs = std::filesystem;

std::vector<std::string> lines_of(const fs::path& path) {
  std::ifstream file(path);
  std::vector<std::string> lines;
  for (std::string line; std::getline(file, line);) lines.push_back(line);
  return lines;
}

TEST(LogLine, IsOneJsonObject) {
  const std::string text = LogLine("test")
                               .add("text", "a\"b\\c\nd\x01")
                               .add("count", std::int64_t{-3})
                               .add("seconds", 0.25)
                               .add_if("none", "")
                               .text();
  EXPECT_TRUE(
      std::regex_match(text, std::regex(R"(\{"time":"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d\.\d{6}Z","event":"test",)"
                                        R"("text":"a\\"b\\\\c\\u000ad\\u0001","count":-3,"seconds":0\.250000\}\n)")))
      << text;
}

TEST(Trace, IsTakenFromWellFormedHeadersOnly) {
  const auto trace = [](const std::string& value) {
    api::Request request;
    request.headers = {{"Traceparent", value}};
    return trace_of(request);
  };
  const std::string id = "4bf92f3577b34da6a3ce929d0e0e4736";
  EXPECT_EQ(trace("00-" + id + "-00f067aa0ba902b7-01"), id);
  EXPECT_EQ(trace("01-" + id + "-00f067aa0ba902b7-01-more"), id);
  for (const std::string& wrong :
       {std::string(), "00-" + id, "ff-" + id + "-00f067aa0ba902b7-01",
        "00-" + std::string(32, '0') + "-00f067aa0ba902b7-01", "00-" + id + "-0000000000000000-01",
        "00-" + std::string("JOHN DOE") + id.substr(8) + "-00f067aa0ba902b7-01", "00_" + id + "_00f067aa0ba902b7_01"})
    EXPECT_EQ(trace(wrong), "") << wrong;
  EXPECT_EQ(trace_of({}), "");
}

TEST(AppendLog, KeepsWhatIsThereAndIsForTheServersEyesOnly) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "new" / "audit.log";
  { EXPECT_TRUE(AppendLog(file).append(LogLine("one"), true)); }
  { EXPECT_TRUE(AppendLog(file).append(LogLine("two"), false)); }
  const auto lines = lines_of(file);
  ASSERT_EQ(lines.size(), 2U);
  EXPECT_NE(lines[0].find("\"one\""), std::string::npos);
  EXPECT_NE(lines[1].find("\"two\""), std::string::npos);
  EXPECT_EQ(fs::status(file).permissions() & (fs::perms::group_all | fs::perms::others_all), fs::perms::none);
}

TEST(AppendLog, StartsANewFileWhenTheOldOneIsRenamed) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "audit.log";
  AppendLog log(file);
  log.append(LogLine("before"), false);
  fs::rename(file, folder.path() / "audit.log.1");
  log.append(LogLine("after"), false);
  fs::remove(file);
  log.append(LogLine("again"), false);
  EXPECT_EQ(lines_of(folder.path() / "audit.log.1").size(), 1U);
  ASSERT_EQ(lines_of(file).size(), 1U);
  EXPECT_NE(lines_of(file)[0].find("again"), std::string::npos);
}

TEST(AppendLog, SaysWhenItCannotWrite) {
  const test::TemporaryFolder folder;
  EXPECT_EQ(test::error_of([&] { AppendLog log(folder.path()); }), ErrorCode::corrupt);
  AppendLog log(folder.path() / "a" / "audit.log");
  fs::remove_all(folder.path() / "a");
  EXPECT_FALSE(log.append(LogLine("x"), false));
}

TEST(AppendLog, LinesOfManyThreadsDoNotMix) {
  const test::TemporaryFolder folder;
  const fs::path file = folder.path() / "audit.log";
  AppendLog log(file);
  {
    std::vector<std::jthread> writers;
    for (int w = 0; w < 8; ++w)
      writers.emplace_back([&log, w] {
        for (int i = 0; i < 200; ++i)
          log.append(LogLine("x").add("text", std::string(100, static_cast<char>('a' + w))), false);
      });
  }
  const auto lines = lines_of(file);
  EXPECT_EQ(lines.size(), 1600U);
  const std::regex whole(R"(\{"time":"[^"]*","event":"x","text":"(.)\1{99}"\})");
  for (const std::string& line : lines) EXPECT_TRUE(std::regex_match(line, whole)) << line;
}

}  // namespace
}  // namespace spherule::server
