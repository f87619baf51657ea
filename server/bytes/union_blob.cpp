// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/bytes/union_blob.h"

#include <array>

#include "server/bytes/blob_format.h"

namespace spherule::server {

namespace {

using format::require;

constexpr std::string_view kMagic = "SPHUNION";
constexpr std::uint32_t kVersion = 1;

using Row = std::array<double, 2>;
constexpr std::size_t kRows = 1 << 17;

}  // namespace

void write_union(const UnionMeasures& measures, const std::function<void(std::string_view)>& append) {
  format::Writer out(append);
  out.put_all(std::span<const char>(kMagic));
  out.put(kVersion);
  out.put<std::uint32_t>(0);
  out.put(measures.moments.volume);
  out.put(measures.moments.first);
  out.put(measures.moments.second);
  out.put(measures.area_mm2);
  out.put<std::uint64_t>(measures.parts.size());
  std::vector<Row> rows;
  for (std::size_t begin = 0; begin < measures.parts.size(); begin += kRows) {
    rows.clear();
    for (const BallPart& part :
         std::span(measures.parts).subspan(begin).first(std::min(kRows, measures.parts.size() - begin))) {
      rows.push_back({part.volume_mm3, part.area_mm2});
    }
    out.put_all(std::span<const Row>(rows));
  }
}

UnionMeasures read_union(const Blob& blob) {
  format::Reader in(blob);
  std::array<char, kMagic.size()> magic{};
  in.get_all(std::span<char>(magic));
  require(std::string_view(magic.data(), magic.size()) == kMagic && in.get<std::uint32_t>() == kVersion);
  require(in.get<std::uint32_t>() == 0);
  UnionMeasures measures;
  measures.moments.volume = in.get<double>();
  measures.moments.first = in.get<Vec3>();
  measures.moments.second = in.get<Mat3>();
  measures.area_mm2 = in.get<double>();
  const auto count = in.get<std::uint64_t>();
  require(in.left() % sizeof(Row) == 0 && count == in.left() / sizeof(Row));
  measures.parts.resize(count);
  std::vector<Row> rows;
  for (std::size_t begin = 0; begin < count; begin += rows.size()) {
    rows = in.get_vector<Row>(std::min<std::uint64_t>(kRows, count - begin));
    for (std::size_t i = 0; i < rows.size(); ++i) {
      measures.parts[begin + i].volume_mm3 = rows[i][0];
      measures.parts[begin + i].area_mm2 = rows[i][1];
    }
  }
  return measures;
}

}  // namespace spherule::server
