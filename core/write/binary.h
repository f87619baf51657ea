// SPDX-License-Identifier: GPL-3.0-or-later
//
// Bytes of binary exports, private to core/write.
#pragma once

#include <bit>
#include <cstring>
#include <span>
#include <string>
#include <type_traits>

#include "core/base/geometry.h"
#include "core/write/export.h"

namespace spherule::detail {

static_assert(std::endian::native == std::endian::little, "the binary exports write native numbers as little-endian");

/// Appends the bytes of one number.
template <typename T>
void append_number(std::string& out, T value) {
  static_assert(std::is_arithmetic_v<T>);
  char bytes[sizeof value];
  std::memcpy(bytes, &value, sizeof value);
  out.append(bytes, sizeof value);
}

/// Appends x y z r of every sphere, and its columns, as float64.
inline void append_rows(std::string& out, std::span<const Sphere> spheres, std::span<const SphereColumn> columns) {
  for (std::size_t i = 0; i < spheres.size(); ++i) {
    const Sphere& s = spheres[i];
    for (const double value : {s.centre.x, s.centre.y, s.centre.z, s.radius}) append_number(out, value);
    for (const SphereColumn& column : columns) append_number(out, column.values[i]);
  }
}

}  // namespace spherule::detail
