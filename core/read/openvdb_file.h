// SPDX-License-Identifier: GPL-3.0-or-later
//
// What an OpenVDB file says around its trees: which grids it has, of which types, and where they lie. Private to
// core/read. Everything throws malformed where bytes are missing or make no sense.
#pragma once

#include <array>
#include <cstdint>
#include <filesystem>
#include <fstream>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/read/read.h"

namespace spherule::vdb {

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

struct GridEntry {
  std::string name;
  const GridType* type = nullptr;  ///< null: one that we cannot pass over (points)
  bool half = false;
  std::size_t tree = 0;  ///< the entry that has the tree: itself, but for instances
  std::int64_t position = 0;
};

/// What precedes a grid's tree, or stands instead of it.
struct GridHead {
  std::uint32_t compression = 0;
  bool level_set = false;
  bool linear = true;  ///< else a camera's frustum, and what follows is not set
  Mat3 axes{};         ///< columns: one step of the index, in world units
  Vec3 origin{};       ///< of voxel (0, 0, 0)
};

struct File {
  std::uint32_t version = 0;
  std::uint32_t library_major = 0, library_minor = 0;
  std::vector<GridEntry> grids;
};

/// Reads the list of grids. Of a file without the places of its grids (written as a stream), they are found by passing
/// over one after another, up to the first of a type that we do not know: O(file). Throws unusable for versions other
/// than 222 to 224.
File read_file(Stream& stream, const Context& context);

/// Reads what is at entry.position, and leaves the stream at the tree. Throws unusable for a transform unknown to
/// OpenVDB and for a singular one.
GridHead read_head(Stream& stream, const File& file, const GridEntry& entry);

/// The grids, for a sentence: "density (float), velocity (vec3s)". Names that are not plain words are left out.
std::string list_of_grids(const File& file);

}  // namespace spherule::vdb
