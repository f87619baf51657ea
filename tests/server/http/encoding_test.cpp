// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/encoding.h"

#include <gtest/gtest.h>

#include "core/base/error.h"

namespace spherule::server {
namespace {

std::string pack(Encoding encoding, const std::string& bytes, std::size_t piece = 1000) {
  const auto packer = make_packer(encoding);
  std::string out;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    out += packer->feed(std::string_view(bytes).substr(at, piece), at + piece >= bytes.size());
  }
  return out;
}

// The unpacked bytes; whether the stream is complete goes to `ended`.
std::string unpack(Encoding encoding, const std::string& bytes, std::size_t piece, bool& ended) {
  const auto unpacker = make_unpacker(encoding);
  std::string out;
  for (std::size_t at = 0; at < bytes.size(); at += piece) {
    unpacker->feed(std::string_view(bytes).substr(at, piece), [&](std::string_view part) { out += part; });
  }
  ended = unpacker->ended();
  return out;
}

std::string sample() {
  std::string bytes;
  for (int i = 0; i < 40000; ++i) bytes += std::to_string(i * 7919 % 10007);
  return bytes;
}

TEST(Encodings, UnpackWhatWasPacked) {
  const std::string bytes = sample();
  bool ended = false;
  for (const Encoding encoding : {Encoding::gzip, Encoding::zstd}) {
    const std::string packed = pack(encoding, bytes);
    EXPECT_LT(packed.size(), bytes.size());
    for (const std::size_t piece : {std::size_t{1}, std::size_t{777}, packed.size()}) {
      EXPECT_EQ(unpack(encoding, packed, piece, ended), bytes) << name(encoding) << " " << piece;
      EXPECT_TRUE(ended);
    }
    EXPECT_EQ(unpack(encoding, packed + packed, 5000, ended), bytes + bytes) << "members follow one another";
    EXPECT_TRUE(ended);
    unpack(encoding, packed.substr(0, packed.size() - 1), 5000, ended);
    EXPECT_FALSE(ended) << "cut";
    EXPECT_THROW(unpack(encoding, "this is something else", 5000, ended), Error);
  }
}

TEST(Encodings, AreChosenByQuality) {
  const auto chosen = [](const char* header) { return std::string(name(preferred_encoding(header))); };
  EXPECT_EQ(chosen(""), "identity");
  EXPECT_EQ(chosen("gzip"), "gzip");
  EXPECT_EQ(chosen("gzip, deflate, br, zstd"), "zstd");
  EXPECT_EQ(chosen("zstd;q=0.4, gzip;q=0.5"), "gzip");
  EXPECT_EQ(chosen("zstd;q=0, gzip;q=0"), "identity");
  EXPECT_EQ(chosen("GZIP;Q=0.001"), "gzip");
  EXPECT_EQ(chosen("gzip;q=0.5, identity"), "identity");
  EXPECT_EQ(chosen("*"), "zstd");
  EXPECT_EQ(chosen("zstd;q=0, *;q=0.1"), "gzip");
  EXPECT_EQ(chosen("br, deflate"), "identity");
  EXPECT_EQ(chosen("xgzip, gzipx"), "identity");
  EXPECT_EQ(chosen("gzip;quality=1"), "identity");
  EXPECT_EQ(chosen(",,;q=,gzip;"), "gzip");
}

TEST(Encodings, OfBodies) {
  EXPECT_EQ(content_encoding(""), Encoding::identity);
  EXPECT_EQ(content_encoding("GZip"), Encoding::gzip);
  EXPECT_EQ(content_encoding("zstd"), Encoding::zstd);
  EXPECT_THROW(content_encoding("br"), Error);
  EXPECT_THROW(content_encoding("gzip, gzip"), Error);
}

TEST(Encodings, HaveTagsOfTheirOwn) {
  EXPECT_EQ(packed_tag("\"a\"", Encoding::zstd), "\"a-zstd\"");
  EXPECT_EQ(plain_tags("\"a-zstd\", W/\"b-gzip\", \"c\""), "\"a\", W/\"b\", \"c\"");
}

TEST(Encodings, AreForText) {
  for (const char* type : {"application/json", "application/problem+json", "text/csv", "application/yaml"}) {
    EXPECT_TRUE(compressible(type)) << type;
  }
  for (const char* type : {"image/png", "application/x-npy", "application/octet-stream", "text/event-stream"}) {
    EXPECT_FALSE(compressible(type)) << type;
  }
}

}  // namespace
}  // namespace spherule::server
