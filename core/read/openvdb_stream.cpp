// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/read/openvdb_stream.h"

#include "core/base/error.h"
#include "core/read/unpacked.h"

namespace spherule::vdb {

void fail_damaged() { throw Error(ErrorCode::malformed, "The OpenVDB file is cut or damaged; send an intact file."); }

Stream::Stream(const std::filesystem::path& file) : size_(size_of_file(file)), in_(file, std::ios::binary) {
  in_.exceptions(std::ios::failbit | std::ios::badbit | std::ios::eofbit);
}

std::array<std::int64_t, 3> Stream::place() {
  const auto i = value<std::int32_t>(), j = value<std::int32_t>(), k = value<std::int32_t>();
  return {i, j, k};
}

std::string Stream::text() {
  const auto length = value<std::uint32_t>();
  need(length);
  std::string s(length, '\0');
  in_.read(s.data(), length);
  return s;
}

void Stream::need(std::uint64_t bytes) {
  if (bytes > size_ - static_cast<std::uint64_t>(position())) fail_damaged();
}

void Stream::skip(std::uint64_t bytes) {
  need(bytes);
  in_.seekg(static_cast<std::streamoff>(bytes), std::ios::cur);
}

void Stream::seek(std::int64_t position) {
  if (position < 0 || static_cast<std::uint64_t>(position) > size_) fail_damaged();
  in_.seekg(position);
}

}  // namespace spherule::vdb
