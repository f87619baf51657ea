// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> bytes of a file for other programs, and back. One .cpp a format. Every text format states frame and
// units (LPS mm) in the file; NPY cannot, so the server's documentation does.
#pragma once

#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// Header "x,y,z,r" after "#" comment lines; shortest decimals that read back to the same float64.
std::string spheres_to_csv(std::span<const Sphere> spheres);
/// NumPy 1.0 array, little-endian float32, shape (N, 4), C order, columns x y z r.
std::string spheres_to_npy(std::span<const Sphere> spheres);
/// Binary little-endian PLY, one vertex a sphere: x y z radius, float32.
std::string spheres_to_ply(std::span<const Sphere> spheres);
/// VTK XML PolyData (appended raw), one vertex cell a sphere, point array "radius": ParaView's Point Gaussian or Glyph
/// filter and 3D Slicer show it as spheres. float32.
std::string spheres_to_vtp(std::span<const Sphere> spheres);

struct ImportLimits {
  std::size_t max_spheres = 10'000'000;
};

/// Reads spheres that a user brings; the format ("csv" or "npy") is given. CSV: a header naming x, y, z, r in any order
/// (further columns ignored), '#' comments. NPY: shape (N, 4), float32 or float64, either byte order and memory order.
/// Throws malformed (with the line), unusable for NaN, infinite or negative radii (with the row), too_large over the
/// limit before memory is taken. Zero radii, repeated and nested spheres are ordinary input. An empty set is unusable.
std::vector<Sphere> spheres_from_csv(std::string_view bytes, const ImportLimits& limits = {});
std::vector<Sphere> spheres_from_npy(std::string_view bytes, const ImportLimits& limits = {});

}  // namespace spherule
