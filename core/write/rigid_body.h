// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the files of rigid bodies say alike, private to core/write.
#pragma once

#include <string>

#include "core/write/decimal.h"
#include "core/write/export_bodies.h"

namespace spherule::detail {

/// Lines without breaks and comment signs: what the file is, in which units and frame, of what solid.
inline std::vector<std::string> about_body(const RigidBody& body) {
  const Vec3 o = body.origin_mm, c = body.centre_m;
  return {"Spherule: a union of " + std::to_string(body.spheres.size()) + " spheres", "units: metres, kilograms",
          "frame: axes of DICOM LPS (x left, y posterior, z head), origin at " + decimals({o.x, o.y, o.z}) +
              " mm of the model",
          "density " + decimals({body.density_kg_m3}) + " kg/m3, volume " + decimals({body.volume_m3}) + " m3, mass " +
              decimals({body.mass_kg}) + " kg (overlaps count once)",
          "centre of mass " + decimals({c.x, c.y, c.z})};
}

/// The tensor's upper half by rows: xx xy xz yy yz zz.
inline std::string inertia_by_rows(const RigidBody& body) {
  const auto& rows = body.inertia_kg_m2.rows;
  return decimals({rows[0].x, rows[0].y, rows[0].z, rows[1].y, rows[1].z, rows[2].z});
}

/// The lines, each after `prefix`.
inline std::string commented(const std::vector<std::string>& lines, std::string_view prefix) {
  std::string out;
  for (const std::string& line : lines) out.append(prefix).append(line) += '\n';
  return out;
}

/// "x y z r" of every sphere and then `after`, a line each.
inline std::string sphere_lines(const RigidBody& body, std::string_view after) {
  std::string out;
  for (const Sphere& s : body.spheres) {
    out += decimals({s.centre.x, s.centre.y, s.centre.z, s.radius});
    out.append(after) += '\n';
  }
  return out;
}

}  // namespace spherule::detail
