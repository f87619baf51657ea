// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/unpacked.h"

#include <bzlib.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <cstdio>
#include <cstring>
#include <new>
#include <vector>

namespace spherule {

namespace {
constexpr std::uint64_t kSink = std::uint64_t{1} << 20;
}

std::uint64_t size_of_file(const std::filesystem::path& file) {
  std::error_code error;
  const bool regular = std::filesystem::is_regular_file(file, error);
  const std::uintmax_t size = regular ? std::filesystem::file_size(file, error) : 0;
  if (!regular || error) throw Error(ErrorCode::not_found, "The file cannot be opened; send it again.");
  return size;
}

std::uint64_t ByteSource::skip(std::uint64_t count, const Context& context) {
  std::vector<std::byte> sink(static_cast<std::size_t>(std::min<std::uint64_t>(count, kSink)));
  std::uint64_t done = 0;
  while (done < count) {
    context.throw_if_cancelled();
    const std::size_t wanted = static_cast<std::size_t>(std::min<std::uint64_t>(count - done, kSink));
    const std::size_t got = read(std::span(sink).first(wanted));
    done += got;
    if (got < wanted) break;
  }
  return done;
}

namespace {

[[noreturn]] void fail_early_end() {
  throw Error(ErrorCode::malformed, "The compressed data end too early: the file is cut; send the whole file.");
}

[[noreturn]] void fail_damaged() {
  throw Error(ErrorCode::malformed,
              "The compressed data are damaged (they do not unpack or fail their checksum); send the file again.");
}

class PlainFile : public ByteSource {
 public:
  PlainFile(const std::filesystem::path& file, std::uint64_t offset) {
    size_of_file(file);
    file_.reset(std::fopen(file.c_str(), "rb"));
    if (!file_ || fseeko(file_.get(), static_cast<off_t>(offset), SEEK_SET) != 0) {
      throw Error(ErrorCode::not_found, "The file cannot be opened; send it again.");
    }
  }
  std::size_t read(std::span<std::byte> into) override { return std::fread(into.data(), 1, into.size(), file_.get()); }
  std::uint64_t skip(std::uint64_t count, const Context&) override {
    const off_t from = ftello(file_.get());
    fseeko(file_.get(), 0, SEEK_END);
    const off_t left = std::max<off_t>(0, ftello(file_.get()) - from);
    const off_t step = static_cast<off_t>(std::min(count, static_cast<std::uint64_t>(left)));
    fseeko(file_.get(), from + step, SEEK_SET);
    return static_cast<std::uint64_t>(step);
  }

 private:
  struct Close {
    void operator()(std::FILE* f) const { std::fclose(f); }
  };
  std::unique_ptr<std::FILE, Close> file_;
};

// A file a piece at a time, for those who make something else of its bytes.
class Refilled {
 public:
  Refilled(const std::filesystem::path& file, std::uint64_t offset) : file_(file, offset), piece_(1U << 16) {}
  // The next piece; empty at the end.
  std::span<std::byte> next() { return std::span(piece_).first(file_.read(piece_)); }

 private:
  PlainFile file_;
  std::vector<std::byte> piece_;
};

// The streams of zlib and libbz2 have the same fields.
template <typename Stream>
void refill(Stream& stream, Refilled& input) {
  const std::span<std::byte> piece = input.next();
  stream.next_in = reinterpret_cast<decltype(stream.next_in)>(piece.data());
  stream.avail_in = static_cast<unsigned>(piece.size());
}

// Fills `into` by steps of a codec, each of which says whether its stream is over; then the codec begins the next one,
// and says whether there is none. Returns the bytes made.
template <typename Stream, typename Step, typename Next>
std::size_t unpack(Stream& stream, Refilled& input, std::span<std::byte> into, bool& ended, Step&& step, Next&& next) {
  std::size_t done = 0;
  while (done < into.size() && !ended) {
    if (stream.avail_in == 0) refill(stream, input);
    const auto room = static_cast<unsigned>(std::min<std::size_t>(into.size() - done, 1U << 30));
    stream.next_out = reinterpret_cast<decltype(stream.next_out)>(into.data() + done);
    stream.avail_out = room;
    const bool starved = stream.avail_in == 0;
    const bool over = step();
    const unsigned made = room - stream.avail_out;
    done += made;
    if (over) {
      ended = !next();
    } else if (starved && made == 0) {
      fail_early_end();
    }
  }
  return done;
}

class Inflated : public ByteSource {
 public:
  Inflated(const std::filesystem::path& file, std::uint64_t offset) : input_(file, offset) {
    // 32: gzip or zlib, by their own headers.
    if (inflateInit2(&zlib_, 15 + 32) != Z_OK) throw std::bad_alloc();
  }
  ~Inflated() override { inflateEnd(&zlib_); }

  std::size_t read(std::span<std::byte> into) override {
    return unpack(
        zlib_, input_, into, ended_, [&] { return inflate_some(); }, [&] { return next_member(); });
  }

 private:
  bool inflate_some() {
    switch (inflate(&zlib_, Z_NO_FLUSH)) {
      case Z_OK:
      case Z_BUF_ERROR: return false;
      case Z_STREAM_END: return true;
      case Z_MEM_ERROR: throw std::bad_alloc();
      default: fail_damaged();
    }
  }

  // After a gzip member another may follow; anything else there (tapes pad with zeros) is ignored as gzip does.
  bool next_member() {
    std::array<std::byte, 2> magic{};
    std::size_t got = 0;
    while (got < magic.size()) {
      if (zlib_.avail_in == 0) refill(zlib_, input_);
      if (zlib_.avail_in == 0) break;
      magic[got++] = static_cast<std::byte>(*zlib_.next_in++);
      --zlib_.avail_in;
    }
    if (got < 2 || magic[0] != std::byte{0x1f} || magic[1] != std::byte{0x8b}) return false;
    inflateReset2(&zlib_, 15 + 16);
    // The two bytes may lie in different refills, so they are fed again from here.
    Bytef* rest = zlib_.next_in;
    const uInt rest_size = zlib_.avail_in;
    Bytef none = 0;
    zlib_.next_in = reinterpret_cast<Bytef*>(magic.data());
    zlib_.avail_in = 2;
    zlib_.next_out = &none;
    zlib_.avail_out = 0;
    inflate(&zlib_, Z_NO_FLUSH);
    zlib_.next_in = rest;
    zlib_.avail_in = rest_size;
    return true;
  }

  Refilled input_;
  z_stream zlib_{};
  bool ended_ = false;
};

class Bunzipped : public ByteSource {
 public:
  Bunzipped(const std::filesystem::path& file, std::uint64_t offset) : input_(file, offset) { start(); }
  ~Bunzipped() override { BZ2_bzDecompressEnd(&bzip2_); }

  std::size_t read(std::span<std::byte> into) override {
    return unpack(
        bzip2_, input_, into, ended_, [&] { return decompress_some(); }, [&] { return next_stream(); });
  }

 private:
  bool decompress_some() {
    switch (BZ2_bzDecompress(&bzip2_)) {
      case BZ_OK: return false;
      case BZ_STREAM_END: return true;
      case BZ_MEM_ERROR: throw std::bad_alloc();
      default: fail_damaged();
    }
  }
  void start() {
    if (BZ2_bzDecompressInit(&bzip2_, 0, 0) != BZ_OK) throw std::bad_alloc();
  }
  // Parallel packers write many streams. What follows and does not start like one is ignored, as bzip2 does.
  bool next_stream() {
    if (bzip2_.avail_in == 0) refill(bzip2_, input_);
    if (bzip2_.avail_in == 0 || *bzip2_.next_in != 'B') return false;
    char* rest = bzip2_.next_in;
    const unsigned rest_size = bzip2_.avail_in;
    BZ2_bzDecompressEnd(&bzip2_);
    bzip2_ = {};
    start();
    bzip2_.next_in = rest;
    bzip2_.avail_in = rest_size;
    return true;
  }

  Refilled input_;
  bz_stream bzip2_{};
  bool ended_ = false;
};

bool is_blank(std::byte b) {
  const auto c = static_cast<char>(b);
  return c == ' ' || c == '\t' || c == '\n' || c == '\r' || c == '\v' || c == '\f';
}

class HexDigits : public ByteSource {
 public:
  HexDigits(const std::filesystem::path& file, std::uint64_t offset) : input_(file, offset) {}

  std::size_t read(std::span<std::byte> into) override {
    std::size_t done = 0;
    unsigned high = kNone;
    while (done < into.size()) {
      if (piece_.empty()) piece_ = input_.next();
      if (piece_.empty()) {
        if (high != kNone) fail();
        break;
      }
      const std::byte b = piece_.front();
      piece_ = piece_.subspan(1);
      if (is_blank(b)) continue;
      const unsigned digit = value_of(static_cast<char>(b));
      if (high == kNone) {
        high = digit;
      } else {
        into[done++] = static_cast<std::byte>(16 * high + digit);
        high = kNone;
      }
    }
    return done;
  }

 private:
  static constexpr unsigned kNone = 16;
  [[noreturn]] static void fail() {
    throw Error(ErrorCode::malformed, "The samples written as hexadecimal digits do not parse; save the file again.");
  }
  static unsigned value_of(char c) {
    if (c >= '0' && c <= '9') return static_cast<unsigned>(c - '0');
    if (c >= 'a' && c <= 'f') return static_cast<unsigned>(c - 'a') + 10;
    if (c >= 'A' && c <= 'F') return static_cast<unsigned>(c - 'A') + 10;
    fail();
  }

  Refilled input_;
  std::span<std::byte> piece_;
};

class DecimalNumbers : public ByteSource {
 public:
  DecimalNumbers(const std::filesystem::path& file, std::uint64_t offset, VoxelType type)
      : input_(file, offset), type_(type), width_(bytes_per_voxel(type)) {}

  std::size_t read(std::span<std::byte> into) override {
    std::size_t done = 0;
    while (done < into.size()) {
      if (ready_.empty() && !parse_next()) break;
      const std::size_t n = std::min(ready_.size(), into.size() - done);
      std::copy_n(ready_.begin(), n, into.begin() + static_cast<std::ptrdiff_t>(done));
      ready_ = ready_.subspan(n);
      done += n;
    }
    return done;
  }

 private:
  [[noreturn]] static void fail() {
    throw Error(ErrorCode::malformed,
                "The samples written as text do not parse as numbers of the header's type; save the file again.");
  }

  // False at the end.
  bool parse_next() {
    constexpr std::size_t kLongest = 64;  // of a number
    std::array<char, kLongest> word;
    std::size_t length = 0;
    for (;;) {
      if (piece_.empty()) piece_ = input_.next();
      if (piece_.empty()) break;
      const std::byte b = piece_.front();
      piece_ = piece_.subspan(1);
      if (!is_blank(b) && b != std::byte{','}) {
        if (length == kLongest) fail();
        word[length++] = static_cast<char>(b);
      } else if (length > 0) {
        break;
      }
    }
    if (length == 0) return false;
    const bool signed_word = word[0] == '+' && length > 1;
    parse(word.data() + (signed_word ? 1 : 0), word.data() + length);
    return true;
  }

  void parse(const char* first, const char* last) {
    const auto as = [&]<typename T>(T value) {
      const auto [end, error] = std::from_chars(first, last, value);
      if (error != std::errc{} || end != last) fail();
      std::memcpy(number_.data(), &value, sizeof value);
    };
    switch (type_) {
      case VoxelType::uint8: as(std::uint8_t{}); break;
      case VoxelType::int8: as(std::int8_t{}); break;
      case VoxelType::uint16: as(std::uint16_t{}); break;
      case VoxelType::int16: as(std::int16_t{}); break;
      case VoxelType::uint32: as(std::uint32_t{}); break;
      case VoxelType::int32: as(std::int32_t{}); break;
      case VoxelType::uint64: as(std::uint64_t{}); break;
      case VoxelType::int64: as(std::int64_t{}); break;
      case VoxelType::float32: as(float{}); break;
      case VoxelType::float64: as(double{}); break;
    }
    ready_ = std::span(number_).first(width_);
  }

  Refilled input_;
  VoxelType type_;
  std::size_t width_;
  std::span<std::byte> piece_;
  std::array<std::byte, 8> number_{};
  std::span<const std::byte> ready_;  // of number_
};

}  // namespace

std::unique_ptr<ByteSource> open_unpacked(const std::filesystem::path& file, Packing packing, std::uint64_t offset,
                                          VoxelType type) {
  switch (packing) {
    case Packing::none: break;
    case Packing::deflate: return std::make_unique<Inflated>(file, offset);
    case Packing::bzip2: return std::make_unique<Bunzipped>(file, offset);
    case Packing::hex: return std::make_unique<HexDigits>(file, offset);
    case Packing::text: return std::make_unique<DecimalNumbers>(file, offset, type);
  }
  return std::make_unique<PlainFile>(file, offset);
}

}  // namespace spherule
