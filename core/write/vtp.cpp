// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: VTK File Formats, "XML File Formats", serial PolyData with one raw appended block.
#include <cstdint>

#include "core/write/binary.h"
#include "core/write/export.h"

namespace spherule {
namespace {

// A string array in ASCII is its characters' codes, each string ended by 0.
std::string string_array(std::string_view name, std::string_view value) {
  std::string out =
      "      <DataArray type=\"String\" Name=\"" + std::string(name) + "\" NumberOfTuples=\"1\" format=\"ascii\">";
  for (const char c : value) out += std::to_string(static_cast<int>(c)) + ' ';
  return out + "0</DataArray>\n";
}

std::string appended_array(std::string_view type_and_name, std::size_t offset) {
  return "        <DataArray type=" + std::string(type_and_name) + " format=\"appended\" offset=\"" +
         std::to_string(offset) + "\"/>\n";
}

}  // namespace

std::string spheres_to_vtp(std::span<const Sphere> spheres, std::span<const SphereColumn> columns) {
  const std::size_t n = spheres.size();
  // Each appended array is its length in bytes, as UInt64, and then its bytes.
  const std::size_t points_at = 0;
  const std::size_t radii_at = points_at + 8 + 24 * n;
  const std::size_t columns_at = radii_at + 8 + 8 * n;
  const std::size_t connectivity_at = columns_at + columns.size() * (8 + 8 * n);
  const std::size_t offsets_at = connectivity_at + 8 + 8 * n;
  const std::string count = std::to_string(n);
  std::string column_arrays;
  for (std::size_t c = 0; c < columns.size(); ++c) {
    column_arrays += appended_array("\"Float64\" Name=\"" + columns[c].name + '"', columns_at + c * (8 + 8 * n));
  }

  std::string out =
      "<?xml version=\"1.0\"?>\n"
      "<!-- Spherule: each vertex is the centre of a sphere; frame LPS, units mm -->\n"
      "<VTKFile type=\"PolyData\" version=\"1.0\" byte_order=\"LittleEndian\" header_type=\"UInt64\">\n"
      "  <PolyData>\n"
      "    <FieldData>\n" +
      string_array("SPACE", "LPS") + string_array("UNITS", "mm") +
      "    </FieldData>\n"
      "    <Piece NumberOfPoints=\"" +
      count + "\" NumberOfVerts=\"" + count +
      "\" NumberOfLines=\"0\" NumberOfStrips=\"0\" NumberOfPolys=\"0\">\n"
      "      <Points>\n" +
      appended_array("\"Float64\" Name=\"Points\" NumberOfComponents=\"3\"", points_at) +
      "      </Points>\n"
      "      <PointData Scalars=\"radius\">\n" +
      appended_array("\"Float64\" Name=\"radius\"", radii_at) + column_arrays +
      "      </PointData>\n"
      "      <Verts>\n" +
      appended_array("\"Int64\" Name=\"connectivity\"", connectivity_at) +
      appended_array("\"Int64\" Name=\"offsets\"", offsets_at) +
      "      </Verts>\n"
      "    </Piece>\n"
      "  </PolyData>\n"
      "  <AppendedData encoding=\"raw\">\n"
      "_";
  out.reserve(out.size() + offsets_at + 8 + 8 * n + 64);
  const auto append_length = [&](std::size_t bytes) { detail::append_number(out, static_cast<std::uint64_t>(bytes)); };

  append_length(24 * n);
  for (const Sphere& s : spheres)
    for (int a = 0; a < 3; ++a) detail::append_number(out, s.centre[a]);
  append_length(8 * n);
  for (const Sphere& s : spheres) detail::append_number(out, s.radius);
  for (const SphereColumn& column : columns) {
    append_length(8 * n);
    for (const double value : column.values) detail::append_number(out, value);
  }
  append_length(8 * n);
  for (std::size_t i = 0; i < n; ++i) detail::append_number(out, static_cast<std::int64_t>(i));
  append_length(8 * n);
  for (std::size_t i = 0; i < n; ++i) detail::append_number(out, static_cast<std::int64_t>(i + 1));
  out += "\n  </AppendedData>\n</VTKFile>\n";
  return out;
}

}  // namespace spherule
