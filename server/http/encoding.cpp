// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/encoding.h"

#include <array>
#include <new>

#include "core/base/error.h"

namespace spherule::server {

Inflater::Inflater() {
  if (inflateInit2(&stream_, 16 + MAX_WBITS) != Z_OK) throw std::bad_alloc();
}

Inflater::~Inflater() { inflateEnd(&stream_); }

void Inflater::feed(std::string_view bytes, const api::Body::Take& take) {
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
      if (result != Z_OK && result != Z_STREAM_END && result != Z_BUF_ERROR) {
        throw Error(ErrorCode::malformed, "The body is not gzip although its Content-Encoding says so.");
      }
      if (const std::size_t n = out.size() - stream_.avail_out; n > 0) take({out.data(), n});
    } while (stream_.avail_out == 0 && result != Z_STREAM_END);
    ended_ = result == Z_STREAM_END;
  }
}

Deflater::Deflater() {
  if (deflateInit2(&stream_, 5, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
}

Deflater::~Deflater() { deflateEnd(&stream_); }

std::string Deflater::feed(std::string_view bytes, bool last) {
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

bool compressible(std::string_view type) {
  return (type.starts_with("text/") && !type.starts_with("text/event-stream")) || type.find("json") != type.npos ||
         type.find("yaml") != type.npos;
}

bool accepts_gzip(std::string_view accept_encoding) {
  const std::size_t at = accept_encoding.find("gzip");
  if (at == std::string_view::npos) return false;
  std::string_view parameters = accept_encoding.substr(at + 4);
  parameters = parameters.substr(0, parameters.find(','));
  const std::size_t q = parameters.find("q=");
  return q == std::string_view::npos || parameters.substr(q + 2).find_first_of("123456789") != std::string_view::npos;
}

namespace {

constexpr std::string_view kPackedTag = "-gzip\"";

}  // namespace

std::string packed_tag(std::string plain) {
  return plain.insert(plain.size() - 1, kPackedTag.substr(0, kPackedTag.size() - 1));
}

std::string plain_tags(std::string tags) {
  for (std::size_t at; (at = tags.find(kPackedTag)) != std::string::npos;) tags.replace(at, kPackedTag.size(), "\"");
  return tags;
}

}  // namespace spherule::server
