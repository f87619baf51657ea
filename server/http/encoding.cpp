// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/encoding.h"

#include <zlib.h>
#include <zstd.h>

#include <algorithm>
#include <array>
#include <new>
#include <vector>

#include "core/base/error.h"

namespace spherule::server {

namespace {

constexpr std::array encodings = {Encoding::zstd, Encoding::gzip, Encoding::identity};  // the best first

[[noreturn]] void refuse(Encoding encoding) {
  throw Error(ErrorCode::malformed,
              "The body is not " + std::string(name(encoding)) + " although its Content-Encoding says so.");
}

class Inflater final : public Unpacker {
 public:
  Inflater() {
    if (inflateInit2(&stream_, 16 + MAX_WBITS) != Z_OK) throw std::bad_alloc();
  }
  ~Inflater() override { inflateEnd(&stream_); }
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;

  void feed(std::string_view bytes, const api::Body::Take& take) override {
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    while (stream_.avail_in > 0) {
      if (ended_) inflateReset(&stream_);
      std::array<char, 1 << 14> out;
      int result = Z_OK;
      do {
        stream_.next_out = reinterpret_cast<Bytef*>(out.data());
        stream_.avail_out = out.size();
        result = inflate(&stream_, Z_NO_FLUSH);
        if (result != Z_OK && result != Z_STREAM_END && result != Z_BUF_ERROR) refuse(Encoding::gzip);
        if (const std::size_t n = out.size() - stream_.avail_out; n > 0) take({out.data(), n});
      } while (stream_.avail_out == 0 && result != Z_STREAM_END);
      ended_ = result == Z_STREAM_END;
    }
  }
  bool ended() const override { return ended_; }

 private:
  z_stream stream_{};
  bool ended_ = false;
};

class Deflater final : public Packer {
 public:
  Deflater() {
    if (deflateInit2(&stream_, 5, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
  }
  ~Deflater() override { deflateEnd(&stream_); }
  Deflater(const Deflater&) = delete;
  Deflater& operator=(const Deflater&) = delete;

  std::string feed(std::string_view bytes, bool last) override {
    std::string packed;
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    do {
      std::array<char, 1 << 14> out;
      stream_.next_out = reinterpret_cast<Bytef*>(out.data());
      stream_.avail_out = out.size();
      deflate(&stream_, last ? Z_FINISH : Z_NO_FLUSH);
      packed.append(out.data(), out.size() - stream_.avail_out);
    } while (stream_.avail_out == 0);
    return packed;
  }

 private:
  z_stream stream_{};
};

class ZstdUnpacker final : public Unpacker {
 public:
  ZstdUnpacker() : context_(ZSTD_createDCtx()) {
    // RFC 9659: a content encoding has windows of 8 MiB at most, so that nobody makes us take more memory.
    if (!context_ || ZSTD_isError(ZSTD_DCtx_setParameter(context_.get(), ZSTD_d_windowLogMax, 23))) {
      throw std::bad_alloc();
    }
  }
  void feed(std::string_view bytes, const api::Body::Take& take) override {
    ZSTD_inBuffer in{bytes.data(), bytes.size(), 0};
    std::array<char, 1 << 14> piece;
    // A full piece may hide more output although the input is used up.
    for (bool full = false; in.pos < in.size || full;) {
      ZSTD_outBuffer out{piece.data(), piece.size(), 0};
      const std::size_t hint = ZSTD_decompressStream(context_.get(), &out, &in);
      if (ZSTD_isError(hint)) refuse(Encoding::zstd);
      if (out.pos > 0) take({piece.data(), out.pos});
      full = out.pos == out.size;
      ended_ = hint == 0;
    }
  }
  bool ended() const override { return ended_; }

 private:
  struct Free {
    void operator()(ZSTD_DCtx* context) const { ZSTD_freeDCtx(context); }
  };
  std::unique_ptr<ZSTD_DCtx, Free> context_;
  bool ended_ = false;
};

class ZstdPacker final : public Packer {
 public:
  ZstdPacker() : context_(ZSTD_createCCtx()) {
    if (!context_) throw std::bad_alloc();
  }
  std::string feed(std::string_view bytes, bool last) override {
    std::string packed;
    ZSTD_inBuffer in{bytes.data(), bytes.size(), 0};
    std::array<char, 1 << 14> piece;
    for (bool more = true; more;) {
      ZSTD_outBuffer out{piece.data(), piece.size(), 0};
      const std::size_t rest = ZSTD_compressStream2(context_.get(), &out, &in, last ? ZSTD_e_end : ZSTD_e_continue);
      if (ZSTD_isError(rest)) throw std::bad_alloc();
      packed.append(piece.data(), out.pos);
      more = last ? rest > 0 : in.pos < in.size;
    }
    return packed;
  }

 private:
  struct Free {
    void operator()(ZSTD_CCtx* context) const { ZSTD_freeCCtx(context); }
  };
  std::unique_ptr<ZSTD_CCtx, Free> context_;
};

std::string_view trimmed(std::string_view s) {
  while (!s.empty() && (s.front() == ' ' || s.front() == '\t')) s.remove_prefix(1);
  while (!s.empty() && (s.back() == ' ' || s.back() == '\t')) s.remove_suffix(1);
  return s;
}

bool same(std::string_view a, std::string_view b) {
  const auto lower = [](char c) { return c >= 'A' && c <= 'Z' ? static_cast<char>(c + 32) : c; };
  return std::ranges::equal(a, b, {}, lower, lower);
}

// A q-value in thousandths; 1000 for none, 0 for one that cannot be read.
int quality(std::string_view parameter) {
  if (parameter.empty()) return 1000;
  if (parameter.size() < 3 || !same(parameter.substr(0, 2), "q=")) return 0;
  const std::string_view digits = parameter.substr(2);
  if (digits.front() == '1') return 1000;
  int value = 0;
  for (std::size_t i = 2; i < 5; ++i) {
    value = 10 * value + (i < digits.size() && digits[i] >= '0' && digits[i] <= '9' ? digits[i] - '0' : 0);
  }
  return value;
}

}  // namespace

std::string_view name(Encoding encoding) {
  return encoding == Encoding::zstd ? "zstd" : encoding == Encoding::gzip ? "gzip" : "identity";
}

Encoding content_encoding(std::string_view header) {
  if (header.empty()) return Encoding::identity;
  for (const Encoding encoding : encodings) {
    if (same(header, name(encoding))) return encoding;
  }
  if (same(header, "x-gzip")) return Encoding::gzip;
  throw Error(ErrorCode::unknown_format, "Send the body as it is, or with Content-Encoding gzip or zstd.");
}

Encoding preferred_encoding(std::string_view header) {
  // Of zstd, gzip and identity, as `encodings`; -1: not said.
  std::array<int, encodings.size()> said = {-1, -1, -1};
  int others = -1;
  while (!header.empty()) {
    const std::size_t end = std::min(header.find(','), header.size());
    const std::string_view item = header.substr(0, end);
    header.remove_prefix(std::min(end + 1, header.size()));
    const std::size_t semicolon = std::min(item.find(';'), item.size());
    const std::string_view coding = trimmed(item.substr(0, semicolon));
    const int q = quality(trimmed(item.substr(std::min(semicolon + 1, item.size()))));
    for (std::size_t i = 0; i < encodings.size(); ++i) {
      if (same(coding, name(encodings[i]))) said[i] = q;
    }
    if (coding == "*") others = q;
  }
  // Who names an encoding wants it rather than none, unless none is named too.
  Encoding best = Encoding::identity;
  int best_quality = 0;
  for (std::size_t i = 0; i < encodings.size(); ++i) {
    const int q = said[i] >= 0 ? said[i] : encodings[i] == Encoding::identity ? 0 : std::max(others, 0);
    if (q > best_quality) {
      best = encodings[i];
      best_quality = q;
    }
  }
  return best;
}

std::unique_ptr<Unpacker> make_unpacker(Encoding encoding) {
  if (encoding == Encoding::zstd) return std::make_unique<ZstdUnpacker>();
  return std::make_unique<Inflater>();
}

std::unique_ptr<Packer> make_packer(Encoding encoding) {
  if (encoding == Encoding::zstd) return std::make_unique<ZstdPacker>();
  return std::make_unique<Deflater>();
}

bool compressible(std::string_view type) {
  return (type.starts_with("text/") && !type.starts_with("text/event-stream")) || type.find("json") != type.npos ||
         type.find("yaml") != type.npos || type.find("xml") != type.npos;
}

std::string packed_tag(std::string plain, Encoding encoding) {
  return plain.insert(plain.size() - 1, "-" + std::string(name(encoding)));
}

std::string plain_tags(std::string tags) {
  for (const Encoding encoding : {Encoding::gzip, Encoding::zstd}) {
    const std::string mark = "-" + std::string(name(encoding)) + "\"";
    for (std::size_t at; (at = tags.find(mark)) != std::string::npos;) tags.replace(at, mark.size(), "\"");
  }
  return tags;
}

}  // namespace spherule::server
