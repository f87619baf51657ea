// SPDX-License-Identifier: GPL-3.0-or-later
//
// What all readers share: the bytes of a file in order, unpacked where need be, and samples that take memory only as
// they really arrive. Private to core/read.
#pragma once

#include <cstddef>
#include <cstdint>
#include <filesystem>
#include <memory>
#include <span>
#include <string>
#include <vector>

#include "core/base/context.h"
#include "core/read/options.h"
#include "core/read/unpacked.h"

namespace spherule {

/// A file's bytes in order, unpacked. Throws malformed where packed data are damaged or end early, also when only the
/// checksum at their end is wrong or missing; not_found when the file cannot be opened. One thread at a time.
class ByteReader {
 public:
  /// Reads `file` from byte `offset` of the file itself (before unpacking). `type` is that of samples in text.
  explicit ByteReader(const std::filesystem::path& file, Packing packing = Packing::none, std::uint64_t offset = 0,
                      VoxelType type = VoxelType::uint8);
  ~ByteReader();
  ByteReader(const ByteReader&) = delete;
  ByteReader& operator=(const ByteReader&) = delete;

  /// Fills `into`; the number of bytes read, which is smaller only at the end.
  std::size_t read(std::span<std::byte> into);
  /// Passes over `count` bytes; the number passed, which is smaller only at the end. Polls cancellation. O(count) when
  /// packed, else O(1).
  std::uint64_t skip(std::uint64_t count, const Context& context);

 private:
  std::unique_ptr<ByteSource> source_;
};

/// Whether the file starts like a gzip stream.
bool is_gzip(const std::filesystem::path& file);
/// The first bytes of a file, unpacked, at most `count`.
std::string read_text(const std::filesystem::path& file, Packing packing, std::size_t count);

/// Where the samples of a volume lie: equal shares of them in each of `files`, in order.
struct SampleSource {
  std::vector<std::filesystem::path> files;
  Packing packing = Packing::none;
  std::uint64_t offset = 0;  ///< bytes of each file before its share, before unpacking
  std::uint64_t skip = 0;    ///< bytes before its share, after unpacking
  bool at_end = false;       ///< the share is the end of the file, after unpacking; offset and skip do not matter
  bool big_endian = false;
  std::int64_t frames = 1;  ///< volumes of this size one after another ...
  std::int64_t frame = 0;   ///< ... of which this one is wanted
  std::uint64_t run = 0;    ///< samples of one volume side by side before those of the next; 0: all that it has
};

/// The one of `frames` volumes that the options choose.
/// Throws unusable when there are several and none is chosen; invalid_argument when there are fewer than the choice.
std::int64_t chosen_frame(std::int64_t frames, const ReadOptions& options);

/// Checks sizes before any memory is taken, asks limits.admit, and returns the sizes as a Grid has them.
/// Throws unusable for sizes below 1; too_large over the limits; what admit throws.
std::array<std::int32_t, 3> checked_dims(const std::array<std::int64_t, 3>& dims, VoxelType type,
                                         const ReadLimits& limits);

/// Whether the source's one file has all the samples of such volumes and nothing after them. Takes no memory for them;
/// O(bytes) of a packed file.
bool holds_exactly(const Volume& volume, const SampleSource& source, const Context& context);

/// Reads the samples of volume.grid.dims and volume.type into volume.voxels, in native byte order.
/// The sizes must have passed `checked_dims`. Throws malformed when the files hold fewer bytes (seen before memory is
/// taken, by what a packing can expand to at most) or damaged ones; bytes after the samples only add a warning.
/// Memory: pages are touched only as bytes arrive, and 2 MiB beside them. Polls cancellation and reports "read" after
/// every MiB.
void read_samples(Volume& volume, const SampleSource& source, const Context& context);

}  // namespace spherule
