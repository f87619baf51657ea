// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> files of programs that show them: molecular viewers and 3-D scenes. One .cpp a format.
#pragma once

#include <span>
#include <string>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// Extended XYZ: species "X", pos, radius; mm along LPS, and its second line says so. OVITO and ASE read it.
std::string spheres_to_xyz(std::span<const Sphere> spheres);

/// PQR (https://ics.uci.edu/~dock/manuals/apbs/html/user-guide/a2566.html), fields between spaces: atom S of residue
/// SPH, charge 0, radius. Programs take its numbers as ångström; they are mm along LPS, and a REMARK says so.
std::string spheres_to_pqr(std::span<const Sphere> spheres);

struct GlbOptions {
  enum class Style : unsigned char {
    instanced,  ///< one ball drawn N times, by EXT_mesh_gpu_instancing: small files for programs that know it
    mesh,       ///< all balls in one mesh, for every program
  };
  Style style = Style::instanced;
  /// A ball is an icosahedron whose triangles are cut into four so many times, its corners on the sphere: 80, 320,
  /// 1280 … triangles, whose middles lie 0.1, 0.03, 0.007 … radii under it. 0 … 5.
  int detail = 2;
};
/// Most triangles that a mesh may have.
inline constexpr std::size_t max_glb_triangles = 20'000'000;

/// glTF 2.0, binary. The scene is in metres with glTF's axes (x to the patient's left, y to the head, z to the
/// anterior); the numbers inside are float32 mm along LPS from the middle of the spheres' box, which the node's scale,
/// rotation and translation turn into that: what float32 loses is of the box, however far from the origin it is. Smooth
/// normals, one grey material. Spheres of radius 0 are left out, and at least one must be left (unusable). Throws
/// too_large for a mesh of more than max_glb_triangles. A cancellation is polled, but while the parts of the file are
/// joined.
std::string spheres_to_glb(std::span<const Sphere> spheres, const GlbOptions& options = {},
                           const Context& context = {});

}  // namespace spherule
