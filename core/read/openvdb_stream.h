// SPDX-License-Identifier: GPL-3.0-or-later
//
// An OpenVDB file as a stream that cannot be read beyond its end, and how the types of grids are stored. Private to
// core/read.
#pragma once

#include <array>
#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>

namespace spherule::vdb {

/// Throws malformed.
[[noreturn]] void fail_damaged();

/// The file as a stream that throws at any read that comes short. OpenVDB does not look at a stream's state: it would
/// go on with whatever was in its variables, for as long as a count in a damaged file says. One thread at a time.
class Stream {
 public:
  explicit Stream(const std::filesystem::path& file);

  std::istream& in() { return in_; }

  template <typename T>
  T value() {
    T v{};
    in_.read(reinterpret_cast<char*>(&v), sizeof v);
    return v;
  }
  std::array<std::int64_t, 3> place();
  /// Text with its length before it; lengths that the file does not have are seen before memory is taken.
  std::string text();
  /// Throws when so many bytes do not follow.
  void need(std::uint64_t bytes);
  void skip(std::uint64_t bytes);
  void seek(std::int64_t position);
  std::int64_t position() { return in_.tellg(); }

 private:
  std::uint64_t size_;
  std::ifstream in_;
};

/// How a type of grid is stored.
struct GridType {
  enum class Leaf : std::uint8_t {
    values,  ///< a value a voxel
    bits,    ///< a bit a voxel, beside which voxels are active
    states,  ///< which voxels are active, and nothing else
  };
  std::string_view tree;      ///< the file's name of it
  std::string_view name;      ///< for people
  std::size_t bytes, halved;  ///< of a value, and of one that is stored as half floats
  Leaf leaf = Leaf::values;
  bool scalar = true;
};

}  // namespace spherule::vdb
