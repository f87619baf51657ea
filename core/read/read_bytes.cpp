// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/read_bytes.h"

#include <algorithm>
#include <array>
#include <cstdio>
#include <limits>
#include <new>

#include "core/base/check.h"

namespace spherule {

namespace {

constexpr std::size_t kChunk = std::size_t{1} << 20;
// The most that one byte of deflate can unpack to (zlib's technical details).
constexpr std::uint64_t kDeflateExpansion = 1032;
// And of bzip2: a block holds at most 900,000 bytes after runs of up to 259 became 5 each, and takes at least 16.
constexpr std::uint64_t kBzip2Expansion = 900'000 / 5 * 259 / 16;
// How far before samples that are the end of a packed stream something else may go on.
constexpr std::uint64_t kMaxLead = std::uint64_t{1} << 24;
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

ByteReader::ByteReader(const std::filesystem::path& file, Packing packing, std::uint64_t offset, VoxelType type)
    : source_(open_unpacked(file, packing, offset, type)) {}

ByteReader::~ByteReader() = default;

std::size_t ByteReader::read(std::span<std::byte> into) { return source_->read(into); }

std::uint64_t ByteReader::skip(std::uint64_t count, const Context& context) { return source_->skip(count, context); }

bool is_gzip(const std::filesystem::path& file) {
  std::array<std::byte, 2> magic{};
  return ByteReader(file).read(magic) == 2 && magic[0] == std::byte{0x1f} && magic[1] == std::byte{0x8b};
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

namespace {

// At most so many bytes can come out of `packed` bytes of a file.
std::uint64_t most_unpacked(std::uint64_t packed, Packing packing, VoxelType type) {
  const auto times = [&](std::uint64_t factor) { return std::min(packed, UINT64_MAX / factor) * factor; };
  switch (packing) {
    case Packing::none: return packed;
    case Packing::deflate: return times(kDeflateExpansion);
    case Packing::bzip2: return times(kBzip2Expansion);
    case Packing::hex: return packed / 2;
    case Packing::text: return (packed + 1) / 2 * bytes_per_voxel(type);  // a digit and a blank each, but for the last
  }
  return packed;
}

// The samples of all frames in order, from as many files as there are.
class SampleStream {
 public:
  // Throws malformed where a file cannot hold its share.
  SampleStream(const Volume& volume, const SampleSource& source, std::uint64_t bytes, const Context& context)
      : source_(source), type_(volume.type), context_(context), share_(bytes / source.files.size()) {
    for (const auto& file : source.files) {
      const std::uint64_t size = size_of_file(file);
      const bool by_size = source.at_end && source.packing == Packing::none;
      if (by_size && size < share_) fail_cut();
      const std::uint64_t offset = by_size ? size - share_ : source.offset;
      const std::uint64_t room = most_unpacked(size < offset ? 0 : size - offset, source.packing, type_);
      const std::uint64_t lead = source.at_end ? 0 : source.skip;
      if (room < lead || room - lead < share_) fail_cut();
      offsets_.push_back(offset);
    }
  }

  void read(std::span<std::byte> into) {
    while (!into.empty()) {
      open_part();
      const std::size_t n = static_cast<std::size_t>(std::min<std::uint64_t>(into.size(), left_in_part()));
      if (reader_->read(into.first(n)) < n) fail_cut();
      into = into.subspan(n);
      advance(n);
    }
  }
  // Files of which nothing is wanted are not opened.
  void skip(std::uint64_t count) {
    while (count > 0) {
      const std::uint64_t n = std::min(count, left_in_part());
      if (reader_ || n < share_) {
        open_part();
        if (reader_->skip(n, context_) < n) fail_cut();
      }
      count -= n;
      advance(n);
    }
  }
  // To the end of a file under way, where its checksum is. Whether any file went on after its samples.
  bool finish() {
    if (reader_) skip(left_in_part());
    return trailing_;
  }

 private:
  std::uint64_t left_in_part() const { return share_ - at_ % share_; }
  void open_part() {
    if (reader_) return;
    const auto part = static_cast<std::size_t>(at_ / share_);
    const auto open = [&] {
      reader_ = std::make_unique<ByteReader>(source_.files[part], source_.packing, offsets_[part], type_);
    };
    open();
    std::uint64_t lead = source_.at_end ? 0 : source_.skip;
    if (source_.at_end && source_.packing != Packing::none) {
      const std::uint64_t all = reader_->skip(share_ + kMaxLead, context_);
      if (all < share_) fail_cut();
      if (all == share_ + kMaxLead) {
        throw Error(ErrorCode::malformed,
                    "The data are far longer than the samples that should end them; correct the header's byte skip.");
      }
      lead = all - share_;
      open();
    }
    if (reader_->skip(lead, context_) < lead) fail_cut();
  }
  void advance(std::uint64_t count) {
    at_ += count;
    if (at_ % share_ != 0 || !reader_) return;
    trailing_ = reader_->skip(kMaxTrailing, context_) > 0 || trailing_;
    reader_.reset();
  }

  const SampleSource& source_;
  VoxelType type_;
  const Context& context_;
  std::uint64_t share_, at_ = 0;
  std::vector<std::uint64_t> offsets_;
  std::unique_ptr<ByteReader> reader_;
  bool trailing_ = false;
};

// Of all frames together.
std::uint64_t all_bytes(const Volume& volume, const SampleSource& source) {
  const std::uint64_t bytes = volume.grid.sample_count() * bytes_per_voxel(volume.type);
  if (source.frames < 1 ||
      static_cast<std::uint64_t>(source.frames) > std::numeric_limits<std::int64_t>::max() / bytes) {
    throw Error(ErrorCode::malformed, "The header's number of volumes is not possible; correct the header.");
  }
  const std::uint64_t all = bytes * static_cast<std::uint64_t>(source.frames);
  if (source.files.empty() || all % source.files.size() != 0) {
    throw Error(ErrorCode::malformed,
                "The number of data files that the header names does not fit the volume's size; correct the header.");
  }
  return all;
}

}  // namespace

bool holds_exactly(const Volume& volume, const SampleSource& source, const Context& context) {
  try {
    const std::uint64_t all = all_bytes(volume, source);
    SampleStream stream(volume, source, all, context);
    stream.skip(all - 1);  // the last one is read: files of which nothing is wanted are not opened
    std::byte last;
    stream.read(std::span(&last, 1));
    return !stream.finish();
  } catch (const Error& error) {
    if (error.code() == ErrorCode::malformed) return false;
    throw;
  }
}

void read_samples(Volume& volume, const SampleSource& source, const Context& context) {
  const std::uint64_t width = bytes_per_voxel(volume.type);
  const std::uint64_t bytes = volume.grid.sample_count() * width;
  SampleStream stream(volume, source, all_bytes(volume, source), context);
  const std::uint64_t run = source.run == 0 ? bytes : source.run * width;
  SPHERULE_CHECK(bytes % run == 0);
  const std::uint64_t period = run * static_cast<std::uint64_t>(source.frames);
  const std::uint64_t begin = run * static_cast<std::uint64_t>(source.frame);

  // Address space for all of it at once, so that nothing is copied; pages follow as the bytes come.
  volume.voxels.clear();
  volume.voxels.reserve(bytes);
  const auto report = [&] {
    context.throw_if_cancelled();
    context.report("read", static_cast<double>(volume.voxels.size()) / static_cast<double>(bytes));
  };
  const auto append = [&](std::uint64_t count) {
    for (std::uint64_t left = count; left > 0;) {
      const auto n = static_cast<std::size_t>(std::min<std::uint64_t>(left, kChunk));
      const std::size_t old = volume.voxels.size();
      volume.voxels.resize(old + n);
      stream.read(std::span(volume.voxels).subspan(old));
      left -= n;
      report();
    }
  };
  if (period > kChunk || run == bytes) {
    stream.skip(begin);
    append(run);
    while (volume.voxels.size() < bytes) {
      stream.skip(period - run);
      append(run);
    }
  } else {
    // Short runs, a few periods at a time.
    std::vector<std::byte> piece(static_cast<std::size_t>(kChunk / period * period));
    for (std::uint64_t left = bytes / run; left > 0;) {
      const std::uint64_t periods = std::min<std::uint64_t>(left, piece.size() / period);
      stream.read(std::span(piece).first(static_cast<std::size_t>(periods * period)));
      for (std::uint64_t p = 0; p < periods; ++p) {
        const auto from = piece.begin() + static_cast<std::ptrdiff_t>(p * period + begin);
        volume.voxels.insert(volume.voxels.end(), from, from + static_cast<std::ptrdiff_t>(run));
      }
      left -= periods;
      report();
    }
  }
  const bool trailing = stream.finish();
  if (source.packing != Packing::text) to_native(volume.voxels, static_cast<std::size_t>(width), source.big_endian);
  if (trailing) volume.warnings.push_back("The data go on after the last sample; the rest was ignored.");
}

}  // namespace spherule
