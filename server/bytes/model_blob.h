// SPDX-License-Identifier: GPL-3.0-or-later
//
// SphereModel <-> bytes in the store. The format, version 1; every number little-endian, nothing aligned:
//
//   8 bytes   "SPHERULE"
//   u32       format version: 1
//   u32       kind: 1 a raw model (with its solid), 2 a plain set of spheres, 3 a simplified model with its levels
//
//   kind 1:
//   i32 x 3   dims of the grid
//   f64 x 3   spacing, mm
//   f64 x 3   origin, LPS mm
//   f64 x 9   direction, row-major
//   f64       length of a lattice unit, mm
//   i32 x ?   planes of the x, then y, then z axis: dims + 2 numbers each (Lattice::planes)
//   u64       1 when the object touches the border, else 0
//   u64       number of points P
//   u64       number of cells C
//   u64       number of inside cells, which come first
//   i32 x 3P  points
//   u32 x 4C  cells
//
//   kind 2:
//   u64       number of spheres N
//   f64 x 4N  x y z r, LPS mm
//
//   kind 3 (core/simplify/result.h):
//   u64       number of nodes N
//   u64       number of members M
//   f64 x 4N  x y z r, LPS mm
//   u32 x 3N  parent, from, to
//   u32 x N+1 where each node's members begin
//   u32 x M   members
//
// The spheres of a raw model are not stored: circumspheres() makes the same ones again, faster than a disk reads them.
// The blob store checks the bytes against their digest; what is checked here is that they make sense.
#pragma once

#include <cstdint>
#include <functional>
#include <string_view>

#include "core/base/context.h"
#include "core/simplify/result.h"
#include "core/spheres.h"
#include "server/bytes/staging.h"

namespace spherule::server {

/// Hands the model's bytes to `append`, in pieces of a few MiB at most. Throws what `append` throws.
void write_model(const SphereModel& model, const std::function<void(std::string_view)>& append);

/// The same for a simplified model with all its levels.
void write_levels(const Simplification& levels, const std::function<void(std::string_view)>& append);

/// The model in a blob; of a simplified one its last level. Throws corrupt for bytes that write_model did not write,
/// before memory is taken for them. O(cells); the memory of the model alone.
SphereModel read_model(const Blob& blob, const Context& context = {});

/// What write_levels wrote. Throws corrupt for anything else.
Simplification read_levels(const Blob& blob);

/// Memory that reading a model takes, of its stored size and its number of spheres: what it is stored as, and the
/// spheres that are made.
constexpr std::uint64_t bytes_to_load(std::uint64_t stored, std::uint64_t spheres) {
  return stored + spheres * sizeof(Sphere);
}

/// Memory that a model takes.
std::size_t bytes_in_memory(const SphereModel& model);
std::size_t bytes_in_memory(const Simplification& levels);

}  // namespace spherule::server
