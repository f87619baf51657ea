// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which samples of a volume belong to the object: the one place where a threshold, a range or a set of labels
// is compared with voxels. Everything after it works on bits.
#pragma once

#include <cstdint>
#include <limits>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <vector>

#include "core/base/context.h"
#include "core/base/int128.h"
#include "core/volume.h"

namespace spherule {

/// What happens where the object meets the border of the grid.
enum class Border : std::uint8_t {
  closed,  ///< the grid is surrounded by outside samples; the object is cut half a voxel beyond the last sample
  open,    ///< no boundary beyond the last sample; the object is cut open
};

/// A whole number that a sample may be: every int64 and every uint64.
using Label = Int128;
inline constexpr Label min_label = std::numeric_limits<std::int64_t>::min();
inline constexpr Label max_label = std::numeric_limits<std::uint64_t>::max();
/// A label from decimal digits, perhaps behind a minus; nothing for any other text and beyond the two bounds.
std::optional<Label> parse_label(std::string_view text);
/// The inverse.
std::string to_text(Label label);

/// The user's definition of the object.
struct ObjectRule {
  enum class Kind : std::uint8_t { threshold, range, labels };
  Kind kind = Kind::threshold;
  double lo = 0;  ///< threshold: inside where value >= lo. range: inside where lo <= value <= hi
  double hi = 0;
  std::vector<Label> labels;  ///< labels: inside where the value is one of these (`label_of`), ascending, each once
  Side side = Side::above;    ///< below: the complement (value < lo; outside the range; any other label)
  Border border = Border::closed;

  /// The number that decides for threshold rules, and the crossing values of a range.
  friend bool operator==(const ObjectRule&, const ObjectRule&) = default;
};

/// One bit per sample, rows of 64-bit words (bit i of a row = sample i; bits past dims[0] are 0).
class SampleBits {
 public:
  SampleBits() = default;
  explicit SampleBits(std::array<std::int32_t, 3> dims);

  const std::array<std::int32_t, 3>& dims() const { return dims_; }
  std::size_t words_per_row() const { return words_; }
  std::span<std::uint64_t> row(std::int32_t j, std::int32_t k) { return {bits_.data() + offset(j, k), words_}; }
  std::span<const std::uint64_t> row(std::int32_t j, std::int32_t k) const {
    return {bits_.data() + offset(j, k), words_};
  }
  /// Unchecked: the indices must be within dims.
  bool test(std::int32_t i, std::int32_t j, std::int32_t k) const {
    return (bits_[offset(j, k) + static_cast<std::size_t>(i) / 64] >> (i % 64)) & 1;
  }
  /// Samples outside the grid count as 0.
  bool test_or_outside(std::int32_t i, std::int32_t j, std::int32_t k) const {
    return i >= 0 && j >= 0 && k >= 0 && i < dims_[0] && j < dims_[1] && k < dims_[2] && test(i, j, k);
  }
  std::uint64_t count() const;

 private:
  std::size_t offset(std::int32_t j, std::int32_t k) const {
    return (static_cast<std::size_t>(k) * static_cast<std::size_t>(dims_[1]) + static_cast<std::size_t>(j)) * words_;
  }
  std::array<std::int32_t, 3> dims_{0, 0, 0};
  std::size_t words_ = 0;
  std::vector<std::uint64_t> bits_;
};

/// Whether the object is the box itself: at most one sample in a thousand is outside, of all and of the outermost
/// layer. No object that leaves the outermost layer free is taken for that, where an axis has fewer than 6000 samples:
/// of a cube of n along each that layer alone is nearly 6/n. O(samples / 64).
bool fills_its_box(const SampleBits& bits);

/// The bits with one more sample on every side, all 0: where a closed border has its outside samples.
SampleBits padded(const SampleBits& bits);

/// The rule applied to a volume.
struct InsideSamples {
  SampleBits inside;
  SampleBits above;  ///< range rules only (else empty): value > hi. An edge from below lo to above hi crosses twice.
  SampleBits not_finite;  ///< range rules only, and empty when there are none: no edge jumps over the range to them
};

/// Classifies every sample. Values that are NaN or infinite are outside on either side. Throws invalid_argument for a
/// rule that makes no sense (lo or hi not finite, lo > hi, no labels). Deterministic; O(n) at memory speed: integer
/// volumes are compared in their stored type, with the rule carried through slope and intercept exactly.
///
/// Which label a sample is: where slope and intercept are whole numbers and samples are integers, the value itself, in
/// exact integers; floating samples without scaling, the value itself. Other scalings (label maps that a program wrote
/// as floating numbers packed into integers) hit whole numbers only nearly, so a sample is the whole number nearest to
/// its value if it is no farther from it than what writing it so may have cost, and that is below 1/2:
///   one stored step where steps are finer than labels (|slope| < 1): half of it for the rounding to an integer, half
///   for the middle of a signed type's range, which is no integer and which writers put to either side; and
///   2^-23 (|slope · stored| + |intercept|), the rounding of slope, intercept or samples to float32.
InsideSamples classify_samples(const Volume& volume, const ObjectRule& rule, const Context& context = {});

}  // namespace spherule
