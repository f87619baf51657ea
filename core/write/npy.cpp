// SPDX-License-Identifier: GPL-3.0-or-later
//
// The format: NumPy Enhancement Proposal 1, "A Simple File Format for NumPy Arrays".
#include <algorithm>
#include <array>
#include <charconv>
#include <optional>

#include "core/write/binary.h"
#include "core/write/export.h"
#include "core/write/import_check.h"

namespace spherule {
namespace {

constexpr std::string_view kMagic = "\x93NUMPY";

[[noreturn]] void malformed(const char* what) {
  throw Error(ErrorCode::malformed, std::string("The NPY ") + what + ": save it again with numpy.save.");
}

[[noreturn]] void unusable_type() {
  throw Error(ErrorCode::unusable,
              "The NPY array is not of type float32 or float64: convert it with astype('float32').");
}

[[noreturn]] void unusable_shape() {
  throw Error(ErrorCode::unusable,
              "The NPY array is not of shape (N, 4): give each sphere one row of four numbers, x, y, z, r.");
}

struct Header {
  std::string_view descr;
  bool fortran_order = false;
  std::vector<std::size_t> shape;
};

// The header is a Python dictionary literal with exactly three keys, so a parser of that much Python is enough.
class HeaderParser {
 public:
  explicit HeaderParser(std::string_view text) : rest_(text) {}

  Header parse() {
    std::optional<std::string_view> descr;
    std::optional<bool> fortran_order;
    std::optional<std::vector<std::size_t>> shape;
    expect('{');
    while (!accept('}')) {
      const std::string_view key = string();
      expect(':');
      if (key == "descr" && !descr) {
        if (peek() == '[') unusable_type();  // a record array
        descr = string();
      } else if (key == "fortran_order" && !fortran_order) {
        fortran_order = boolean();
      } else if (key == "shape" && !shape) {
        shape = tuple();
      } else {
        malformed("header has an unknown or repeated key");
      }
      if (!accept(',') && peek() != '}') malformed("header does not parse");
    }
    if (peek() != 0) malformed("header does not parse");
    if (!descr || !fortran_order || !shape) malformed("header lacks descr, fortran_order or shape");
    return {*descr, *fortran_order, std::move(*shape)};
  }

 private:
  char peek() {
    rest_.remove_prefix(std::min(rest_.find_first_not_of(" \t\n"), rest_.size()));
    return rest_.empty() ? '\0' : rest_.front();
  }
  bool accept(char c) {
    if (peek() != c) return false;
    rest_.remove_prefix(1);
    return true;
  }
  void expect(char c) {
    if (!accept(c)) malformed("header does not parse");
  }
  std::string_view string() {
    const char quote = peek();
    if (quote != '\'' && quote != '"') malformed("header does not parse");
    rest_.remove_prefix(1);
    const auto end = rest_.find(quote);
    if (end == std::string_view::npos) malformed("header does not parse");
    const std::string_view text = rest_.substr(0, end);
    rest_.remove_prefix(end + 1);
    return text;
  }
  bool boolean() {
    for (const bool value : {false, true}) {
      const std::string_view word = value ? "True" : "False";
      peek();
      if (!rest_.starts_with(word)) continue;
      rest_.remove_prefix(word.size());
      return value;
    }
    malformed("header does not parse");
  }
  std::vector<std::size_t> tuple() {
    std::vector<std::size_t> numbers;
    expect('(');
    while (!accept(')')) {
      peek();
      std::size_t number = 0;
      const auto [end, error] = std::from_chars(rest_.data(), rest_.data() + rest_.size(), number);
      if (error != std::errc{}) malformed("header has a shape that does not parse");
      rest_.remove_prefix(static_cast<std::size_t>(end - rest_.data()));
      numbers.push_back(number);
      if (numbers.size() > 2) unusable_shape();
      if (!accept(',') && peek() != ')') malformed("header has a shape that does not parse");
    }
    return numbers;
  }

  std::string_view rest_;
};

struct NpyFile {
  std::string_view header, data;
};

NpyFile split(std::string_view bytes) {
  const auto byte = [&](std::size_t i) { return static_cast<std::size_t>(static_cast<unsigned char>(bytes[i])); };
  if (!bytes.starts_with(kMagic)) malformed("file does not start like one");
  if (bytes.size() < 10) malformed("file is cut short");
  const std::size_t version = byte(6);
  if (version < 1 || version > 3) malformed("file has an unknown version");
  const std::size_t start = version == 1 ? 10 : 12;
  if (bytes.size() < start) malformed("file is cut short");
  std::size_t length = 0;
  for (std::size_t i = start; i-- > 8;) length = length << 8 | byte(i);
  if (bytes.size() - start < length) malformed("file is cut short");
  return {bytes.substr(start, length), bytes.substr(start + length)};
}

template <typename T>
double number_at(std::string_view data, std::size_t index, bool big_endian) {
  std::array<char, sizeof(T)> raw;
  std::memcpy(raw.data(), data.data() + index * sizeof(T), sizeof(T));
  if (big_endian) std::reverse(raw.begin(), raw.end());
  return static_cast<double>(std::bit_cast<T>(raw));
}

}  // namespace

std::string spheres_to_npy(std::span<const Sphere> spheres, std::span<const SphereColumn> columns) {
  std::string header = "{'descr': '<f8', 'fortran_order': False, 'shape': (" + std::to_string(spheres.size()) + ", " +
                       std::to_string(4 + columns.size()) + "), }";
  // Magic, version, length and header together fill whole blocks of 64 bytes, the header ending in a line feed.
  const std::size_t before = kMagic.size() + 4;
  header.append(63 - (before + header.size()) % 64, ' ');
  header += '\n';

  std::string out(kMagic);
  out.reserve(before + header.size() + 8 * (4 + columns.size()) * spheres.size());
  out += '\x01';
  out += '\x00';
  detail::append_number(out, static_cast<std::uint16_t>(header.size()));
  out += header;
  detail::append_rows(out, spheres, columns);
  return out;
}

std::vector<Sphere> spheres_from_npy(std::string_view bytes, const ImportLimits& limits) {
  const NpyFile file = split(bytes);
  const Header header = HeaderParser(file.header).parse();

  const bool float32 = header.descr == "<f4" || header.descr == ">f4";
  if (!float32 && header.descr != "<f8" && header.descr != ">f8") unusable_type();
  const bool big_endian = header.descr.front() == '>';
  if (header.shape.size() != 2 || header.shape[1] != 4) unusable_shape();
  const std::size_t count = header.shape[0];
  detail::require_some(count);
  detail::require_within(count, limits);
  // Divided, not multiplied: the limit may be any number, the product need not fit.
  const std::size_t row_bytes = float32 ? 16 : 32;
  if (file.data.size() / row_bytes < count) malformed("file is cut short");
  if (file.data.size() / row_bytes > count || file.data.size() % row_bytes != 0)
    malformed("file has bytes after the array");

  std::vector<Sphere> spheres(count);
  for (std::size_t row = 0; row < count; ++row) {
    const auto value = [&](std::size_t column) {
      const std::size_t index = header.fortran_order ? column * count + row : row * 4 + column;
      return float32 ? number_at<float>(file.data, index, big_endian) : number_at<double>(file.data, index, big_endian);
    };
    spheres[row] = {{value(0), value(1), value(2)}, value(3)};
    detail::require_usable(spheres[row], row + 1);
  }
  return spheres;
}

}  // namespace spherule
