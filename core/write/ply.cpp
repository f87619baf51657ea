// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: G. Turk, The PLY Polygon File Format (1994).
#include "core/write/binary.h"
#include "core/write/export.h"

namespace spherule {

std::string spheres_to_ply(std::span<const Sphere> spheres, std::span<const SphereColumn> columns) {
  std::string out =
      "ply\n"
      "format binary_little_endian 1.0\n"
      "comment Spherule: each vertex is the centre of a sphere\n"
      "comment SPACE=LPS\n"
      "comment UNITS=mm\n"
      "element vertex " +
      std::to_string(spheres.size()) +
      "\n"
      "property double x\n"
      "property double y\n"
      "property double z\n"
      "property double radius\n";
  for (const SphereColumn& column : columns) out += "property double " + column.name + '\n';
  out += "end_header\n";
  out.reserve(out.size() + 8 * (4 + columns.size()) * spheres.size());
  detail::append_rows(out, spheres, columns);
  return out;
}

}  // namespace spherule
