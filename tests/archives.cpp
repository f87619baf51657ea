// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/archives.h"

#include <bzlib.h>
#include <gtest/gtest.h>
#include <zlib.h>

namespace spherule::test {

namespace {

void put(std::string& out, std::uint64_t value, int bytes) {
  for (int i = 0; i < bytes; ++i) out += static_cast<char>(value >> (8 * i) & 0xff);
}

// `window` as deflateInit2 takes it: which frame is about the data.
std::string deflated(std::string_view bytes, int window) {
  z_stream stream{};
  EXPECT_EQ(deflateInit2(&stream, 6, Z_DEFLATED, window, 8, Z_DEFAULT_STRATEGY), Z_OK);
  std::string out(deflateBound(&stream, bytes.size()), '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  EXPECT_EQ(deflate(&stream, Z_FINISH), Z_STREAM_END);
  out.resize(stream.total_out);
  deflateEnd(&stream);
  return out;
}

}  // namespace

std::string bzip2(std::string_view bytes) {
  std::string out(bytes.size() + bytes.size() / 100 + 600, '\0');
  auto size = static_cast<unsigned>(out.size());
  EXPECT_EQ(BZ2_bzBuffToBuffCompress(out.data(), &size, const_cast<char*>(bytes.data()),
                                     static_cast<unsigned>(bytes.size()), 9, 0, 0),
            BZ_OK);
  out.resize(size);
  return out;
}

std::string zlib_stream(std::string_view bytes) { return deflated(bytes, MAX_WBITS); }
std::string gzip(std::string_view bytes) { return deflated(bytes, 16 + MAX_WBITS); }

std::string gunzip(const std::string& bytes) {
  z_stream stream{};
  EXPECT_EQ(inflateInit2(&stream, 16 + MAX_WBITS), Z_OK);
  std::string out(bytes.size() * 100 + 1000, '\0');
  stream.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
  stream.avail_in = static_cast<uInt>(bytes.size());
  stream.next_out = reinterpret_cast<Bytef*>(out.data());
  stream.avail_out = static_cast<uInt>(out.size());
  EXPECT_EQ(inflate(&stream, Z_FINISH), Z_STREAM_END);
  out.resize(stream.total_out);
  inflateEnd(&stream);
  return out;
}

// By APPNOTE.TXT: local headers with the data, then the directory, then its end.
std::string zip(const std::vector<ZipEntry>& entries) {
  std::string out, directory;
  for (const ZipEntry& entry : entries) {
    const std::string data = entry.deflated ? deflated(entry.bytes, -MAX_WBITS) : entry.bytes;
    const auto crc =
        crc32(0, reinterpret_cast<const Bytef*>(entry.bytes.data()), static_cast<uInt>(entry.bytes.size()));
    std::string shared;
    put(shared, 20, 2);
    put(shared, entry.flags, 2);
    put(shared, entry.deflated ? 8 : 0, 2);
    put(shared, 0, 4);
    put(shared, crc, 4);
    put(shared, data.size(), 4);
    put(shared, entry.bytes.size(), 4);
    put(shared, entry.name.size(), 2);
    put(shared, 0, 2);
    directory += "PK\x01\x02";
    put(directory, 0x0314, 2);  // made on Unix
    directory += shared;
    put(directory, 0, 2 + 2 + 2);
    put(directory, static_cast<std::uint64_t>(entry.mode) << 16, 4);
    put(directory, out.size(), 4);
    directory += entry.name;
    out += "PK\x03\x04" + shared + entry.name + data;
  }
  const std::size_t start = out.size();
  out += directory + std::string("PK\x05\x06");
  put(out, 0, 4);
  put(out, entries.size(), 2);
  put(out, entries.size(), 2);
  put(out, directory.size(), 4);
  put(out, start, 4);
  put(out, 0, 2);
  return out;
}

}  // namespace spherule::test
