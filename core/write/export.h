// SPDX-License-Identifier: GPL-3.0-or-later
//
// Spheres -> bytes of a file for other programs, and back. One .cpp a format. Every format that can states frame and
// units (LPS mm) in the file; NPY cannot, so the server's documentation does. The same spheres give the same bytes.
// Binary ones are float64 throughout: float32 has only 24 bits, which far from the origin are used up by the place.
// Memory of each writer: the file's bytes (64 for each line of CSV and number of a column, 8 a number of the others).
#pragma once

#include <cstddef>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// One more number for each sphere, beside x, y, z and r.
struct SphereColumn {
  std::string name;  ///< of ASCII letters, digits and underscores; ends in its unit if it has one
  std::vector<double> values;
};

// Columns must be as long as `spheres`.

/// Header "x,y,z,r" and the names of columns, after "#" comment lines; shortest decimals that read back to the same
/// float64.
std::string spheres_to_csv(std::span<const Sphere> spheres, std::span<const SphereColumn> columns = {});
/// NumPy 1.0 array, little-endian float64, shape (N, 4 + columns), C order: x y z r, then the columns.
std::string spheres_to_npy(std::span<const Sphere> spheres, std::span<const SphereColumn> columns = {});
/// Binary little-endian PLY, one vertex a sphere: x y z radius, then the columns, float64. The comment SPACE=LPS is the
/// one 3D Slicer looks for.
std::string spheres_to_ply(std::span<const Sphere> spheres, std::span<const SphereColumn> columns = {});
/// VTK XML PolyData (appended raw), one vertex cell a sphere, point array "radius" and one for each column: ParaView's
/// Point Gaussian or Glyph filter and 3D Slicer show it as spheres. float64. The field arrays SPACE ("LPS", which 3D
/// Slicer obeys) and UNITS ("mm") state the frame.
std::string spheres_to_vtp(std::span<const Sphere> spheres, std::span<const SphereColumn> columns = {});

struct ImportLimits {
  std::size_t max_spheres = 10'000'000;  ///< in one set
};

/// Coordinates and radii that a user brings are at most this, in mm (a thousand kilometres), so that squares and cubes
/// of them stay ordinary numbers everywhere.
inline constexpr double max_import_coordinate = 1e9;
/// Radii above 0 are at least this, in mm: below every ball of a volume (half a lattice unit of the least spacing,
/// 1e-9 mm / 2^25), and its square is a normal number even of float32.
inline constexpr double min_import_radius = 1e-18;

/// Reads spheres that a user brings; the format ("csv" or "npy") is given. CSV: a header naming x, y, z, r in any order
/// (further columns ignored), '#' comments and empty lines anywhere, LF or CRLF. NPY: versions 1 to 3, shape (N, 4),
/// float32 or float64, either byte order and memory order.
/// Throws malformed (CSV: with the line), unusable for NaN, infinite or huge numbers and negative or tiny radii (with
/// the row, counted from 1), too_large over the limit before memory is taken. Zero radii, repeated and nested spheres
/// are ordinary input. An empty set is unusable. O(bytes).
std::vector<Sphere> spheres_from_csv(std::string_view bytes, const ImportLimits& limits = {});
std::vector<Sphere> spheres_from_npy(std::string_view bytes, const ImportLimits& limits = {});

}  // namespace spherule
