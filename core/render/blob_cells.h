// SPDX-License-Identifier: GPL-3.0-or-later
//
// Where the surface of blended balls is (blobs.cpp states their fields), and what makes it there. Private to
// core/render.
//
// A ray that asks every field on its way asks hundreds where balls overlap as those of raw models do. So space is cut
// into cubes. Bounds of the sum say which of them the surface may pass; the others are dropped. In a cube that lies
// within a field's reach that field is one polynomial of degree four, and so is the sum of all such fields: 14 numbers,
// however many balls there are. What is left for a cube's own list are the fields whose edge passes it, which become
// few as cubes become small.
#pragma once

#include <array>
#include <cstdint>
#include <optional>
#include <span>
#include <vector>

#include "core/base/context.h"
#include "core/base/geometry.h"

namespace spherule {

/// The field of a ball: strength · (squared_reach - d²)² at the distance d from its centre, within its reach.
struct BlobField {
  Vec3 centre;
  double squared_ball = 0, squared_reach = 0;
  double strength = 0;
};

/// A symmetric matrix: xx, yy, zz, xy, xz, yz.
using Symmetric = std::array<double, 6>;

/// A sum of strength · (squared_reach - d²)², wherever that is, as a polynomial in u, the place from some centre:
///   constant + 4 linear·u + uᵀ square u - 4 |u|² cube·u + fourth |u|⁴
struct BlobSum {
  double constant = 0, fourth = 0;
  Vec3 linear, cube;
  Symmetric square{};

  /// Of the place u.
  double value(Vec3 u) const;
  Vec3 gradient(Vec3 u) const;
  Mat3 hessian(Vec3 u) const;
};

struct BlobCell {
  Vec3 centre;
  double half = 0;  ///< of the cube's side, and a little more, so that no ray passes between two cubes
  BlobSum sum;      ///< of the fields that reach all of the cube, from its centre ...
  std::uint32_t first = 0, count = 0;  ///< ... and of the others that reach it, in BlobCells::listed
};

struct BlobCells {
  std::vector<BlobCell> cells;        ///< all that the surface may pass
  std::vector<std::uint32_t> listed;  ///< indices of fields

  std::span<const std::uint32_t> list(const BlobCell& cell) const {
    return std::span(listed).subspan(cell.first, cell.count);
  }
  /// What holds the surface in a cell, of these fields.
  Box box(const BlobCell& cell, std::span<const BlobField> fields) const;
  /// Whether the sum is at least 1 all around the point, or the cell to ask.
  struct Location {
    bool inside = false;
    std::optional<std::uint32_t> cell{};
  };
  Location locate(Vec3 point) const;

  // The tree over them: of each node, the first of its eight children, or what it is.
  static constexpr std::int32_t outside = -1, inside = -2, first_cell = -3;  // the cell is first_cell - node
  std::vector<std::int32_t> nodes;
  Vec3 centre;
  double half = 0;
};

/// Cells for the surface where the sum of fields is 1. O(fields · levels) where fields lie side by side; work, and what
/// is kept, are bounded by a constant and a part for each field (blob_cells.cpp): where very many fields end in one
/// place, lists stay long. The same for every thread count. Throws cancelled.
BlobCells blob_cells(std::span<const BlobField> fields, const Context& context);

}  // namespace spherule
