// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/base/digest.h"

#include <gtest/gtest.h>

#include <set>

namespace spherule::server {
namespace {

// The examples of FIPS 180-2, appendix B.
TEST(Digest, MatchesTheStandardsExamples) {
  EXPECT_EQ(sha256_hex("abc"), "ba7816bf8f01cfea414140de5dae2223b00361a396177a9cb410ff61f20015ad");
  EXPECT_EQ(sha256_hex(""), "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855");
  Sha256 million;
  for (int i = 0; i < 1000; ++i) million.update(std::string(1000, 'a'));
  EXPECT_EQ(million.hex(), "cdc76e5c9914fb9281a1c7e284d73e67f1809a48a497200e046d39ccc7112cd0");
}

TEST(Digest, CanBeReadMidway) {
  Sha256 digest;
  digest.update("a");
  EXPECT_EQ(digest.hex(), sha256_hex("a"));
  digest.update("bc");
  EXPECT_EQ(digest.hex(), sha256_hex("abc"));
  EXPECT_EQ(digest.hex(), sha256_hex("abc"));
}

TEST(Digest, ContentIdsAreThePrefixAndHalfTheDigest) {
  EXPECT_EQ(content_id("vol", "abc"), "vol_ba7816bf8f01cfea414140de5dae2223");
}

TEST(Digest, RandomIdsDiffer) {
  std::set<std::string> ids;
  for (int i = 0; i < 1000; ++i) ids.insert(random_id("job"));
  EXPECT_EQ(ids.size(), 1000U);
  for (const std::string& id : ids) EXPECT_TRUE(is_id("job", id)) << id;
}

TEST(Digest, RefusesWhatIsNoId) {
  const std::string good = content_id("vol", "abc");
  EXPECT_TRUE(is_id("vol", good));
  EXPECT_FALSE(is_id("mdl", good));
  EXPECT_FALSE(is_id("vol", ""));
  EXPECT_FALSE(is_id("vol", "vol_"));
  EXPECT_FALSE(is_id("vol", good + "0"));
  EXPECT_FALSE(is_id("vol", good.substr(0, good.size() - 1)));
  EXPECT_FALSE(is_id("vol", "vol_BA7816BF8F01CFEA414140DE5DAE2223"));
  EXPECT_FALSE(is_id("vol", "vol_../../../../etc/passwd/000000000"));
}

}  // namespace
}  // namespace spherule::server
