// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/access/auth.h"

#include <gtest/gtest.h>

#include <set>
#include <vector>

#include "server/base/digest.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using test::error_of;

TEST(Keys, AreFoundByTheirTokensAndByNothingElse) {
  std::vector<ApiKey> keys;
  std::vector<std::string> tokens;
  for (const char* name : {"a", "b", "c"}) {
    tokens.push_back(new_token());
    keys.push_back({name, Scope::read, sha256_hex(tokens.back())});
  }
  for (std::size_t i = 0; i < keys.size(); ++i) {
    EXPECT_EQ(find_key(keys, "Bearer " + tokens[i]), &keys[i]);
    EXPECT_EQ(find_key(keys, "bearer " + tokens[i]), &keys[i]) << "schemes are written in any case";
  }
  const std::string& token = tokens[0];
  for (const std::string& shown : std::vector<std::string>{
           "", token, "Bearer", "Bearer ", "Basic " + token, "Bearer  " + token, "Bearer " + token + " ",
           "Bearer " + token.substr(1), "Bearer " + keys[0].sha256, "Bearer " + new_token()})
    EXPECT_EQ(find_key(keys, shown), nullptr) << shown;
  EXPECT_EQ(find_key({}, "Bearer " + token), nullptr);
}

TEST(Keys, AreLongAndDifferent) {
  std::set<std::string> tokens;
  for (int i = 0; i < 1000; ++i) tokens.insert(new_token());
  EXPECT_EQ(tokens.size(), 1000U);
  EXPECT_EQ(tokens.begin()->size(), 4 + 64U);
  EXPECT_TRUE(tokens.begin()->starts_with("sph_"));
}

TEST(Keys, AreWrittenAsTheyAreRead) {
  const std::string text = "ward-3.CT:admin:" + sha256_hex("x");
  EXPECT_EQ(to_string(key_from(text)), text);
  const std::string digest = sha256_hex("x");
  for (const std::string& wrong :
       {std::string(), std::string("a"), "a:" + digest, ":read:" + digest, "a:owner:" + digest, "a b:read:" + digest,
        "a:read:" + digest + "0", "a:read:" + digest.substr(1), "a:read:b:" + digest,
        std::string(65, 'a') + ":read:" + digest, "a:read:" + std::string(64, 'A'), "a\n:read:" + digest})
    EXPECT_EQ(error_of([&] { key_from(wrong); }), ErrorCode::invalid_argument) << wrong;
}

TEST(Scopes, GoWithWhatARequestDoes) {
  for (const char* path : {"/livez", "/readyz", "/openapi.yaml", "/docs"}) EXPECT_FALSE(needed_scope("GET", path));
  EXPECT_FALSE(needed_scope("OPTIONS", "/v1/models")) << "browsers ask before they show a key";
  for (const char* path :
       {"/v1/volumes", "/v1/volumes/x/content", "/metrics", "/version", "/", "/v2", "/docs/", "/livez/x"}) {
    EXPECT_EQ(needed_scope("GET", path), Scope::read) << path;
    EXPECT_EQ(needed_scope("HEAD", path), Scope::read) << path;
  }
  for (const char* method : {"POST", "PUT", "PATCH", "BREW"})
    EXPECT_EQ(needed_scope(method, "/v1/models"), Scope::write);
  EXPECT_EQ(needed_scope("DELETE", "/v1/models/x"), Scope::admin);
  EXPECT_EQ(needed_scope("DELETE", "/v1/uploads/x"), Scope::write);
  EXPECT_LT(Scope::read, Scope::write);
  EXPECT_LT(Scope::write, Scope::admin);
}

}  // namespace
}  // namespace spherule::server
