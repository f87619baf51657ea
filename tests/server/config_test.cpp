// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/config.h"

#include <gtest/gtest.h>

#include <string>
#include <vector>

#include "core/base/error.h"

namespace spherule::server {
namespace {

std::optional<Config> parse(const std::vector<const char*>& arguments) { return parse_config(arguments); }

std::string refusal(const std::vector<const char*>& arguments) {
  try {
    parse_config(arguments);
    return "accepted";
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    return error.what();
  }
}

TEST(Config, DefaultsListenOnLoopbackWithAllProcessors) {
  const auto config = parse({});
  ASSERT_TRUE(config);
  EXPECT_EQ(config->host, "127.0.0.1");
  EXPECT_EQ(config->port, 8080);
  EXPECT_GE(config->threads, 1U);
  EXPECT_EQ(config->catalog_file(), "spherule-data/catalog.sqlite");
}

TEST(Config, ReadsBothFormsOfFlags) {
  const auto config = parse({"--port", "0", "--data=/some where/=x", "--threads=6", "--jobs-at-once", "4", "--host",
                             "::1", "--max-body-bytes", "3G", "--model-cache-bytes=0"});
  ASSERT_TRUE(config);
  EXPECT_EQ(config->port, 0);
  EXPECT_EQ(config->data, "/some where/=x");
  EXPECT_EQ(config->threads, 6U);
  EXPECT_EQ(config->threads_per_job(), 1U);
  EXPECT_EQ(config->host, "::1");
  EXPECT_EQ(config->max_body_bytes, std::uint64_t{3} << 30);
  EXPECT_EQ(config->model_cache_bytes, 0U);
}

TEST(Config, EachJobHasAThread) {
  Config config;
  config.threads = 2;
  config.jobs_at_once = 3;
  EXPECT_EQ(config.threads_per_job(), 1U);
  config.threads = 8;
  EXPECT_EQ(config.threads_per_job(), 2U);
}

TEST(Config, HelpNamesEveryFlag) {
  EXPECT_FALSE(parse({"--help"}));
  EXPECT_FALSE(parse({"--port", "1", "-h"}));
  const std::string text = usage();
  for (const char* flag :
       {"--host", "--port", "--data", "--threads", "--jobs-at-once", "--queue-length", "--max-body-bytes",
        "--max-decompressed-bytes", "--max-voxels", "--max-boundary-points", "--max-spheres", "--max-image-pixels",
        "--max-wait-s", "--max-streams", "--model-cache-bytes", "--help"})
    EXPECT_NE(text.find(flag), std::string::npos) << flag;
}

TEST(Config, RefusesByName) {
  EXPECT_NE(refusal({"--prot", "1"}).find("--prot is not a flag"), std::string::npos);
  EXPECT_NE(refusal({"file.nii"}).find("file.nii is not a flag"), std::string::npos);
  EXPECT_NE(refusal({"--port"}).find("--port needs a value"), std::string::npos);
  EXPECT_NE(refusal({"--data="}).find("--data needs a value"), std::string::npos);
  for (const char* port : {"-1", "65536", "80x", "8K", " 80", "1e3", "99999999999999999999"})
    EXPECT_NE(refusal({"--port", port}).find("--port needs a whole number from 0 to 65535"), std::string::npos) << port;
  for (const char* size : {"0", "K", "1KB", "9999999999G", "-1", "1T"})
    EXPECT_NE(refusal({"--max-body-bytes", size}).find("at least 1"), std::string::npos) << size;
  EXPECT_NE(refusal({"--queue-length", "0"}).find("from 1"), std::string::npos);
}

}  // namespace
}  // namespace spherule::server
