// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/union_blob.h"

#include <gtest/gtest.h>

#include "core/base/error.h"
#include "tests/server/doubles.h"

namespace spherule::server {
namespace {

using test::MemoryBlobStore;

std::string bytes_of(const UnionMeasures& measures) {
  std::string bytes;
  write_union(measures, [&](std::string_view piece) {
    EXPECT_LE(piece.size(), std::size_t{4} << 20);
    bytes += piece;
  });
  return bytes;
}

UnionMeasures union_of(const std::string& bytes) {
  MemoryBlobStore store;
  return read_union(store.open(store.put("answers/a", bytes)));
}

UnionMeasures example(std::size_t parts) {
  UnionMeasures m;
  m.moments = {.volume = 1.0 / 3, .first = {1, -2, 3e-300}, .second = {{Vec3{1, 2, 3}, Vec3{2, 5, 6}, Vec3{3, 6, 9}}}};
  m.area_mm2 = 7.25;
  for (std::size_t i = 0; i < parts; ++i) {
    m.parts.push_back({.volume_mm3 = 0.1 * static_cast<double>(i), .area_mm2 = -0.0, .push_mm2 = {1, 1, 1}});
  }
  return m;
}

TEST(UnionBlob, ReadsBackExactly) {
  for (const std::size_t parts : {0, 1, 3, 300'000}) {
    const UnionMeasures m = example(parts), back = union_of(bytes_of(m));
    EXPECT_EQ(back.moments.volume, m.moments.volume);
    EXPECT_EQ(back.moments.first, m.moments.first);
    EXPECT_EQ(back.moments.second, m.moments.second);
    EXPECT_EQ(back.area_mm2, m.area_mm2);
    ASSERT_EQ(back.parts.size(), parts);
    for (std::size_t i = 0; i < parts; ++i) {
      ASSERT_EQ(back.parts[i].volume_mm3, m.parts[i].volume_mm3);
      ASSERT_EQ(back.parts[i].area_mm2, m.parts[i].area_mm2);
    }
  }
}

TEST(UnionBlob, RefusesWhatItDidNotWrite) {
  const std::string good = bytes_of(example(3));
  std::vector<std::string> bad{"", "SPHERULE", good + "x", good + std::string(16, '\0')};
  for (std::size_t length = 0; length < good.size(); length += 5) bad.push_back(good.substr(0, length));
  for (const std::size_t at : {std::size_t{0}, std::size_t{8}, std::size_t{12}, good.size() - 3 * 16 - 1}) {
    bad.push_back(good);
    bad.back()[at] = static_cast<char>(bad.back()[at] ^ 0x40);
  }
  for (const std::string& bytes : bad) {
    try {
      union_of(bytes);
      ADD_FAILURE() << bytes.size();
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::corrupt);
    }
  }
}

}  // namespace
}  // namespace spherule::server
