// SPDX-License-Identifier: GPL-3.0-or-later
//
// What is measured of a model's union <-> bytes in the store. The format, version 1; every number little-endian:
//
//   8 bytes   "SPHUNION"
//   u32       format version: 1
//   u32       0
//   f64       volume, mm³
//   f64 x 3   first moments, mm⁴
//   f64 x 9   second moments, mm⁵, row-major
//   f64       area, mm²
//   u64       number of spheres N
//   f64 x 2N  each sphere's part of the volume and of the area
#pragma once

#include <functional>
#include <string_view>

#include "core/measure/union.h"
#include "server/bytes/staging.h"

namespace spherule::server {

/// Hands the bytes to `append`, in pieces of a few MiB at most. Throws what `append` throws. The pushes of parts
/// are not kept: nothing that is served needs them.
void write_union(const UnionMeasures& measures, const std::function<void(std::string_view)>& append);

/// What write_union wrote. Throws corrupt for anything else, before memory is taken for it.
UnionMeasures read_union(const Blob& blob);

}  // namespace spherule::server
