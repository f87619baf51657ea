// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/io/read_bytes.h"

#include <zlib.h>

#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <new>

namespace spherule {

namespace {

constexpr std::size_t kChunk = std::size_t{1} << 20;
// The most that one byte of deflate can unpack to (zlib's technical details), and room for a few tiny blocks.
constexpr std::uint64_t kMaxExpansion = 1032;
// How far bytes after the samples are followed: enough for any padding, and to reach the checksum of a gzip stream.
constexpr std::uint64_t kMaxTrailing = std::uint64_t{1} << 16;

[[noreturn]] void fail_cut() {
  throw Error(ErrorCode::malformed,
              "The data end before the last sample that the header promises: the file is cut; send the whole file.");
}

template <std::size_t Width>
void swap_bytes(std::span<std::byte> bytes) {
  for (std::size_t i = 0; i + Width <= bytes.size(); i += Width) {
    std::reverse(bytes.data() + i, bytes.data() + i + Width);
  }
}

void to_native(std::span<std::byte> bytes, std::size_t width, bool big_endian) {
  if (big_endian == (std::endian::native == std::endian::big)) return;
  switch (width) {
    case 2: return swap_bytes<2>(bytes);
    case 4: return swap_bytes<4>(bytes);
    case 8: return swap_bytes<8>(bytes);
    default: return;
  }
}

}  // namespace

struct ByteReader::State {
  struct Close {
    void operator()(std::FILE* f) const { std::fclose(f); }
  };
  std::unique_ptr<std::FILE, Close> file;
  bool packed = false;
  bool ended = false;  // of the packed stream
  z_stream zlib{};
  std::vector<std::byte> input;

  ~State() {
    if (packed) inflateEnd(&zlib);
  }

  void refill() {
    zlib.next_in = reinterpret_cast<Bytef*>(input.data());
    zlib.avail_in = static_cast<uInt>(std::fread(input.data(), 1, input.size(), file.get()));
  }

  // After a gzip member another may follow; anything else there (tapes pad with zeros) is ignored as gzip does.
  void next_member() {
    std::array<std::byte, 2> magic{};
    std::size_t got = 0;
    while (got < magic.size()) {
      if (zlib.avail_in == 0) refill();
      if (zlib.avail_in == 0) break;
      magic[got++] = static_cast<std::byte>(*zlib.next_in++);
      --zlib.avail_in;
    }
    if (got < 2 || magic[0] != std::byte{0x1f} || magic[1] != std::byte{0x8b}) {
      ended = true;
      return;
    }
    inflateReset2(&zlib, 15 + 16);
    // The two bytes may lie in different refills, so they are fed again from here.
    Bytef* rest = zlib.next_in;
    const uInt rest_size = zlib.avail_in;
    Bytef none = 0;
    zlib.next_in = reinterpret_cast<Bytef*>(magic.data());
    zlib.avail_in = 2;
    zlib.next_out = &none;
    zlib.avail_out = 0;
    inflate(&zlib, Z_NO_FLUSH);
    zlib.next_in = rest;
    zlib.avail_in = rest_size;
  }

  std::size_t inflate_into(std::span<std::byte> into) {
    std::size_t done = 0;
    while (done < into.size() && !ended) {
      if (zlib.avail_in == 0) refill();
      const uInt room = static_cast<uInt>(std::min<std::size_t>(into.size() - done, 1U << 30));
      zlib.next_out = reinterpret_cast<Bytef*>(into.data() + done);
      zlib.avail_out = room;
      const bool starved = zlib.avail_in == 0;
      const int status = inflate(&zlib, Z_NO_FLUSH);
      done += room - zlib.avail_out;
      if (status == Z_STREAM_END) {
        next_member();
      } else if (status == Z_MEM_ERROR) {
        throw std::bad_alloc();
      } else if (status != Z_OK && status != Z_BUF_ERROR) {
        throw Error(
            ErrorCode::malformed,
            "The compressed data are damaged (they do not unpack or fail their checksum); send the file again.");
      } else if (starved && zlib.avail_out == room) {
        throw Error(ErrorCode::malformed, "The compressed data end too early: the file is cut; send the whole file.");
      }
    }
    return done;
  }
};

ByteReader::ByteReader(const std::filesystem::path& file, Packing packing, std::uint64_t offset)
    : state_(std::make_unique<State>()) {
  size_of_file(file);
  state_->file.reset(std::fopen(file.c_str(), "rb"));
  if (!state_->file || fseeko(state_->file.get(), static_cast<off_t>(offset), SEEK_SET) != 0) {
    throw Error(ErrorCode::not_found, "The file cannot be opened; send it again.");
  }
  if (packing == Packing::deflate) {
    // 32: gzip or zlib, by their own headers.
    if (inflateInit2(&state_->zlib, 15 + 32) != Z_OK) throw std::bad_alloc();
    state_->packed = true;
    state_->input.resize(std::size_t{1} << 16);
  }
}

ByteReader::~ByteReader() = default;

std::size_t ByteReader::read(std::span<std::byte> into) {
  if (state_->packed) return state_->inflate_into(into);
  return std::fread(into.data(), 1, into.size(), state_->file.get());
}

std::uint64_t ByteReader::skip(std::uint64_t count, const Context& context) {
  if (!state_->packed) {
    const off_t from = ftello(state_->file.get());
    fseeko(state_->file.get(), 0, SEEK_END);
    const off_t left = std::max<off_t>(0, ftello(state_->file.get()) - from);
    const off_t step = static_cast<off_t>(std::min(count, static_cast<std::uint64_t>(left)));
    fseeko(state_->file.get(), from + step, SEEK_SET);
    return static_cast<std::uint64_t>(step);
  }
  std::vector<std::byte> sink(static_cast<std::size_t>(std::min<std::uint64_t>(count, kChunk)));
  std::uint64_t done = 0;
  while (done < count) {
    context.throw_if_cancelled();
    const std::size_t wanted = static_cast<std::size_t>(std::min<std::uint64_t>(count - done, kChunk));
    const std::size_t got = read(std::span(sink).first(wanted));
    done += got;
    if (got < wanted) break;
  }
  return done;
}

bool is_gzip(const std::filesystem::path& file) {
  std::array<std::byte, 2> magic{};
  return ByteReader(file).read(magic) == 2 && magic[0] == std::byte{0x1f} && magic[1] == std::byte{0x8b};
}

std::uint64_t size_of_file(const std::filesystem::path& file) {
  std::error_code error;
  const bool regular = std::filesystem::is_regular_file(file, error);
  const std::uintmax_t size = regular ? std::filesystem::file_size(file, error) : 0;
  if (!regular || error) throw Error(ErrorCode::not_found, "The file cannot be opened; send it again.");
  return size;
}

std::string read_text(const std::filesystem::path& file, Packing packing, std::size_t count) {
  std::string text;
  ByteReader reader(file, packing);
  while (text.size() < count) {
    const std::size_t old = text.size();
    const std::size_t wanted = std::min(count - old, kChunk);
    text.resize(old + wanted);
    const std::size_t got = reader.read(std::as_writable_bytes(std::span(text)).subspan(old));
    text.resize(old + got);
    if (got < wanted) break;
  }
  return text;
}

std::int64_t chosen_frame(std::int64_t frames, const ReadOptions& options) {
  if (!options.frame) {
    if (frames == 1) return 0;
    throw Error(ErrorCode::unusable,
                "The file holds " + std::to_string(frames) +
                    " volumes (4-D); choose one with frame=0 to frame=" + std::to_string(frames - 1) + ".");
  }
  if (*options.frame < 0 || *options.frame >= frames) {
    const std::string sentence =
        "The frame must be within 0 and " + std::to_string(frames - 1) + ", the volumes that the file holds.";
    throw Error(ErrorCode::invalid_argument, sentence, {{"frame", sentence}});
  }
  return *options.frame;
}

std::array<std::int32_t, 3> checked_dims(const std::array<std::int64_t, 3>& dims, VoxelType type,
                                         const ReadLimits& limits) {
  std::uint64_t count = 1;
  const std::uint64_t bytes_limit = limits.max_bytes / bytes_per_voxel(type);
  const std::uint64_t limit = std::min<std::uint64_t>(limits.max_voxels, bytes_limit);
  for (const std::int64_t n : dims) {
    if (n < 1) throw Error(ErrorCode::unusable, "Every size of the volume must be at least 1; correct the header.");
  }
  for (const std::int64_t n : dims) {
    if (static_cast<std::uint64_t>(n) > limit / count || n > std::numeric_limits<std::int32_t>::max()) {
      throw Error(ErrorCode::too_large,
                  "The volume's header declares more than the " + std::to_string(limit) +
                      " samples that are allowed for this type; send a smaller or coarser volume.");
    }
    count *= static_cast<std::uint64_t>(n);
  }
  if (limits.admit) limits.admit(count * bytes_per_voxel(type));
  return {static_cast<std::int32_t>(dims[0]), static_cast<std::int32_t>(dims[1]), static_cast<std::int32_t>(dims[2])};
}

void read_samples(Volume& volume, const SampleSource& source, const Context& context) {
  const std::uint64_t bytes = volume.grid.sample_count() * bytes_per_voxel(volume.type);
  if (source.frames < 1 ||
      static_cast<std::uint64_t>(source.frames) > std::numeric_limits<std::int64_t>::max() / bytes) {
    throw Error(ErrorCode::malformed, "The header's number of volumes is not possible; correct the header.");
  }
  const std::uint64_t all = bytes * static_cast<std::uint64_t>(source.frames);
  const std::uint64_t begin = bytes * static_cast<std::uint64_t>(source.frame);
  const std::uint64_t parts = source.files.size();
  if (parts == 0 || all % parts != 0) {
    throw Error(ErrorCode::malformed,
                "The number of data files that the header names does not fit the volume's size; correct the header.");
  }
  const std::uint64_t share = all / parts;

  std::vector<std::uint64_t> offsets;
  for (const auto& file : source.files) {
    const std::uint64_t size = size_of_file(file);
    if (source.at_end && size < share) fail_cut();
    const std::uint64_t offset = source.at_end ? size - share : source.offset;
    const std::uint64_t packed = size < offset ? 0 : size - offset;
    const std::uint64_t room =
        source.packing == Packing::none ? packed : std::min(packed, UINT64_MAX / kMaxExpansion) * kMaxExpansion;
    const std::uint64_t skip = source.at_end ? 0 : source.skip;
    if (room < skip || room - skip < share) fail_cut();
    offsets.push_back(offset);
  }

  // Address space for all of it at once, so that nothing is copied; pages follow as the bytes come.
  volume.voxels.clear();
  volume.voxels.reserve(bytes);
  bool trailing = false;
  for (std::uint64_t part = begin / share; part < parts && part * share < begin + bytes; ++part) {
    ByteReader reader(source.files[part], source.packing, offsets[part]);
    const std::uint64_t first = std::max(begin, part * share);
    const std::uint64_t last = std::min(begin + bytes, (part + 1) * share);
    const std::uint64_t before = (source.at_end ? 0 : source.skip) + (first - part * share);
    if (reader.skip(before, context) < before) fail_cut();
    for (std::uint64_t at = first; at < last;) {
      context.throw_if_cancelled();
      const std::size_t wanted = static_cast<std::size_t>(std::min<std::uint64_t>(last - at, kChunk));
      const std::size_t old = volume.voxels.size();
      volume.voxels.resize(old + wanted);
      if (reader.read(std::span(volume.voxels).subspan(old)) < wanted) fail_cut();
      at += wanted;
      context.report("read", static_cast<double>(at - begin) / static_cast<double>(bytes));
    }
    // To the end of the stream, where its checksum is.
    const std::uint64_t rest = (part + 1) * share - last;
    if (reader.skip(rest, context) < rest) fail_cut();
    trailing = reader.skip(kMaxTrailing, context) > 0 || trailing;
  }
  to_native(volume.voxels, bytes_per_voxel(volume.type), source.big_endian);
  if (trailing) volume.warnings.push_back("The data go on after the last sample; the rest was ignored.");
}

}  // namespace spherule
