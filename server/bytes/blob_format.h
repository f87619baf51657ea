// SPDX-License-Identifier: GPL-3.0-or-later
//
// Little-endian numbers into and out of blobs: what the formats of model_blob.h and union_blob.h are written with.
#pragma once

#include <algorithm>
#include <bit>
#include <cstdint>
#include <functional>
#include <span>
#include <string_view>
#include <type_traits>
#include <vector>

#include "core/base/error.h"
#include "server/bytes/staging.h"

namespace spherule::server::format {

static_assert(std::endian::native == std::endian::little, "the formats are this machine's own layout");

inline constexpr std::size_t piece_bytes = 1 << 22;

/// Hands numbers on as bytes, in pieces of a few MiB at most.
class Writer {
 public:
  explicit Writer(const std::function<void(std::string_view)>& append) : append_(append) {}

  template <typename T>
  void put(const T& value) {
    put_all(std::span<const T>(&value, 1));
  }
  template <typename T>
  void put_all(std::span<const T> values) {
    static_assert(std::is_trivially_copyable_v<T>);
    std::string_view bytes(reinterpret_cast<const char*>(values.data()), values.size_bytes());
    for (; !bytes.empty(); bytes.remove_prefix(std::min(bytes.size(), piece_bytes)))
      append_(bytes.substr(0, piece_bytes));
  }

 private:
  const std::function<void(std::string_view)>& append_;
};

/// Throws corrupt unless the bytes make sense so far.
inline void require(bool good) {
  if (!good) throw Error(ErrorCode::corrupt, "The stored model is damaged; delete it and make it again.");
}

/// Takes numbers off a blob from its start on. Throws corrupt past its end.
class Reader {
 public:
  explicit Reader(const Blob& blob) : blob_(blob) {}

  template <typename T>
  T get() {
    T value{};
    get_all(std::span<T>(&value, 1));
    return value;
  }
  template <typename T>
  void get_all(std::span<T> values) {
    static_assert(std::is_trivially_copyable_v<T>);
    const std::span bytes(reinterpret_cast<char*>(values.data()), values.size_bytes());
    require(blob_.read_at(at_, bytes) == bytes.size());
    at_ += bytes.size();
  }
  /// A vector of exactly `count` values, when so many are left.
  template <typename T>
  std::vector<T> get_vector(std::uint64_t count) {
    require(count <= left() / sizeof(T));
    std::vector<T> values(count);
    get_all(std::span<T>(values));
    return values;
  }
  std::uint64_t left() const { return blob_.size() - std::min(blob_.size(), at_); }

 private:
  const Blob& blob_;
  std::uint64_t at_ = 0;
};

}  // namespace spherule::server::format
