// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/inside.h"

#include <algorithm>
#include <bit>
#include <cmath>
#include <cstring>
#include <limits>
#include <numeric>
#include <optional>
#include <type_traits>

#include "core/base/int128.h"
#include "core/base/parallel.h"
#include "core/base/progress.h"
#include "core/base/text.h"

namespace spherule {

SampleBits::SampleBits(std::array<std::int32_t, 3> dims)
    : dims_(dims),
      words_((static_cast<std::size_t>(dims[0]) + 63) / 64),
      bits_(words_ * static_cast<std::size_t>(dims[1]) * static_cast<std::size_t>(dims[2])) {}

std::uint64_t SampleBits::count() const {
  return std::accumulate(bits_.begin(), bits_.end(), std::uint64_t{0}, [](std::uint64_t sum, std::uint64_t word) {
    return sum + static_cast<std::uint64_t>(std::popcount(word));
  });
}

bool fills_its_box(const SampleBits& bits) {
  const auto few = [](std::uint64_t outside, std::uint64_t of) { return outside <= of / 1000; };
  const auto [nx, ny, nz] = bits.dims();
  const auto box = [](std::int64_t x, std::int64_t y, std::int64_t z) {
    return static_cast<std::uint64_t>(std::max<std::int64_t>(x, 0) * std::max<std::int64_t>(y, 0) *
                                      std::max<std::int64_t>(z, 0));
  };
  const std::uint64_t all = box(nx, ny, nz);
  if (!few(all - bits.count(), all)) return false;
  std::uint64_t outside = 0;
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      if (j == 0 || k == 0 || j + 1 == ny || k + 1 == nz) {
        std::uint64_t inside = 0;
        for (const std::uint64_t word : bits.row(j, k)) inside += static_cast<std::uint64_t>(std::popcount(word));
        outside += static_cast<std::uint64_t>(nx) - inside;
      } else {
        outside += (bits.test(0, j, k) ? 0 : 1) + (nx > 1 && !bits.test(nx - 1, j, k) ? 1 : 0);
      }
    }
  }
  return few(outside, all - box(nx - 2, ny - 2, nz - 2));
}

SampleBits padded(const SampleBits& bits) {
  const auto [nx, ny, nz] = bits.dims();
  SampleBits result({nx + 2, ny + 2, nz + 2});
  for (std::int32_t k = 0; k < nz; ++k) {
    for (std::int32_t j = 0; j < ny; ++j) {
      const auto from = bits.row(j, k);
      const auto to = result.row(j + 1, k + 1);
      for (std::size_t w = 0; w < to.size(); ++w) {
        to[w] = (w < from.size() ? from[w] << 1 : 0) | (w > 0 && w <= from.size() ? from[w - 1] >> 63 : 0);
      }
    }
  }
  return result;
}

std::optional<Label> parse_label(std::string_view text) {
  if (text.starts_with('-')) return number_in<std::int64_t>(text);
  return number_in<std::uint64_t>(text);
}

std::string to_text(Label label) {
  return label < 0 ? std::to_string(static_cast<std::int64_t>(label))
                   : std::to_string(static_cast<std::uint64_t>(label));
}

namespace {

constexpr std::size_t kRowsPerPiece = 256;

void validate(const ObjectRule& rule) {
  if (rule.kind == ObjectRule::Kind::labels) {
    if (rule.labels.empty())
      throw Error(ErrorCode::invalid_argument, "Name at least one label.", {{"/labels", "must not be empty"}});
    return;
  }
  if (!std::isfinite(rule.lo)) {
    throw Error(ErrorCode::invalid_argument, "The threshold must be a finite number.",
                {{"/threshold", "must be finite"}});
  }
  if (rule.kind == ObjectRule::Kind::range && !(std::isfinite(rule.hi) && rule.lo <= rule.hi)) {
    throw Error(ErrorCode::invalid_argument, "The range must be two finite numbers, the smaller one first.",
                {{"/range", "must be [lo, hi] with lo <= hi"}});
  }
}

// Eight bytes of 0 or 1 to eight bits: byte i of x moves to bit 56 + i of the product, and nothing else reaches the top
// byte.
std::uint64_t pack8(const std::uint8_t* flags) {
  std::uint64_t x;
  std::memcpy(&x, flags, 8);
  return (x * 0x0102040810204080ULL) >> 56;
}

// Flags first, bits second: compilers vectorise the comparison when it writes whole bytes.
template <typename T, typename Predicate>
void classify_row(const T* values, std::size_t count, std::span<std::uint64_t> words, Predicate inside) {
  std::array<std::uint8_t, 64> flags;
  std::array<T, 64> tail{};
  for (std::size_t w = 0; w < words.size(); ++w) {
    const T* from = values + 64 * w;
    const std::size_t n = std::min<std::size_t>(64, count - 64 * w);
    if (n < 64) {
      std::copy_n(from, n, tail.begin());
      from = tail.data();
    }
    for (std::size_t i = 0; i < 64; ++i) flags[i] = inside(from[i]);
    std::uint64_t word = 0;
    for (std::size_t b = 0; b < 8; ++b) word |= pack8(&flags[8 * b]) << (8 * b);
    words[w] = n < 64 ? word & ((std::uint64_t{1} << n) - 1) : word;
  }
}

template <typename T, typename Predicate>
SampleBits classify(const std::array<std::int32_t, 3>& dims, std::span<const T> samples, const Context& context,
                    Predicate inside) {
  SampleBits bits(dims);
  const auto nx = static_cast<std::size_t>(dims[0]);
  const std::size_t rows = static_cast<std::size_t>(dims[1]) * static_cast<std::size_t>(dims[2]);
  parallel_for(context, "samples", rows, kRowsPerPiece, [&](std::size_t begin, std::size_t end) {
    for (std::size_t r = begin; r < end; ++r) {
      const auto j = static_cast<std::int32_t>(r % static_cast<std::size_t>(dims[1]));
      const auto k = static_cast<std::int32_t>(r / static_cast<std::size_t>(dims[1]));
      classify_row(samples.data() + r * nx, nx, bits.row(j, k), inside);
    }
  });
  return bits;
}

// The least stored integer from which on `holds` is true, given that it is false below and true above; one past the
// largest when it never holds.
template <typename T, typename Predicate>
Int128 first_where(Predicate holds) {
  Int128 lo = std::numeric_limits<T>::min();
  Int128 hi = static_cast<Int128>(std::numeric_limits<T>::max()) + 1;
  while (lo < hi) {
    const Int128 middle = lo + (hi - lo) / 2;
    if (holds(static_cast<T>(middle))) {
      hi = middle;
    } else {
      lo = middle + 1;
    }
  }
  return lo;
}

bool is_finite(double value) { return value - value == 0; }  // on vectors

// Every comparison of a rule is one with a closed interval. NaN is in none.
struct Interval {
  double lo, hi;
  bool holds(double value) const { return value >= lo && value <= hi; }
};
// Infinite values are in none either.
constexpr double kLargest = std::numeric_limits<double>::max();
Interval above(double hi) { return {std::nextafter(hi, std::numeric_limits<double>::infinity()), kLargest}; }

// value -> slope·value + intercept is monotone, also as rounded in double, so the stored integers whose value is in an
// interval form one too, and one subtraction and one unsigned comparison decide a sample.
template <typename T>
SampleBits classify_integers(const Volume& volume, std::span<const T> samples, const Context& context,
                             Interval interval, bool complement) {
  const auto value = [&](T stored) { return volume.slope * static_cast<double>(stored) + volume.intercept; };
  const auto reaches_lo = [&](T s) { return value(s) >= interval.lo; };
  const auto within_hi = [&](T s) { return value(s) <= interval.hi; };
  const bool rising = volume.slope > 0;
  const Int128 first = rising ? first_where<T>(reaches_lo) : first_where<T>(within_hi);
  const Int128 past =
      rising ? first_where<T>([&](T s) { return !within_hi(s); }) : first_where<T>([&](T s) { return !reaches_lo(s); });
  // None of them is all but all.
  const bool none = first >= past, outside = complement != none;
  using U = std::make_unsigned_t<T>;
  const U base = none ? U{0} : static_cast<U>(first);
  const U width = none ? std::numeric_limits<U>::max() : static_cast<U>(past - 1 - first);
  return classify(volume.grid.dims, samples, context,
                  [=](T s) { return (static_cast<U>(static_cast<U>(s) - base) <= width) != outside; });
}

template <typename T>
SampleBits classify_values(const Volume& volume, std::span<const T> samples, const Context& context, Interval interval,
                           bool complement) {
  if constexpr (std::is_integral_v<T>) {
    return classify_integers(volume, samples, context, interval, complement);
  } else {
    const double slope = volume.slope, intercept = volume.intercept;
    return classify(volume.grid.dims, samples, context, [=](T stored) {
      const double value = slope * static_cast<double>(stored) + intercept;
      return is_finite(value) && interval.holds(value) != complement;
    });
  }
}

template <typename T>
SampleBits classify_not_finite(const Volume& volume, std::span<const T> samples, const Context& context) {
  if constexpr (std::is_integral_v<T>) {
    return {};
  } else {
    const double slope = volume.slope, intercept = volume.intercept;
    SampleBits bits = classify(volume.grid.dims, samples, context,
                               [=](T stored) { return !is_finite(slope * static_cast<double>(stored) + intercept); });
    return bits.count() == 0 ? SampleBits{} : bits;
  }
}

// Which label a stored sample is, as the header defines it.
class LabelOf {
 public:
  explicit LabelOf(const Volume& volume) : slope_(volume.slope), intercept_(volume.intercept) {
    // Whole numbers of this size times any stored integer fit 128 bits.
    constexpr double kWhole = 0x1p62;
    const auto whole = [](double v) { return std::abs(v) <= kWhole && v == std::trunc(v); };
    exact_ = whole(slope_) && whole(intercept_);
    if (exact_) whole_slope_ = static_cast<Int128>(slope_), whole_intercept_ = static_cast<Int128>(intercept_);
  }

  template <typename T>
  std::optional<Label> operator()(T stored) const {
    if constexpr (std::is_integral_v<T>) {
      if (exact_) return whole_slope_ * static_cast<Int128>(stored) + whole_intercept_;
    }
    const double scaled = slope_ * static_cast<double>(stored), value = scaled + intercept_;
    const double nearest = std::round(value);
    if (!is_finite(value) || std::abs(nearest) > 0x1p64) return std::nullopt;
    const double off = std::abs(value - nearest);
    if (off > tolerance<T>(scaled) || off >= 0.5) return std::nullopt;
    return static_cast<Int128>(nearest);
  }

 private:
  template <typename T>
  double tolerance(double scaled) const {
    if (slope_ == 1 && intercept_ == 0) return 0;
    const double step = std::is_integral_v<T> && std::abs(slope_) < 1 ? std::abs(slope_) : 0;
    return step + 0x1p-23 * (std::abs(scaled) + std::abs(intercept_));
  }

  double slope_, intercept_;
  bool exact_;
  Int128 whole_slope_ = 1, whole_intercept_ = 0;
};

template <typename T>
SampleBits classify_labels(const Volume& volume, std::span<const T> samples, const std::vector<Label>& labels,
                           bool complement, const Context& context) {
  const LabelOf label_of(volume);
  const auto inside = [&](T stored) {
    if (!is_finite(volume.slope * static_cast<double>(stored) + volume.intercept)) return false;
    const std::optional<Label> label = label_of(stored);
    return (label && std::ranges::binary_search(labels, *label)) != complement;
  };
  if constexpr (sizeof(T) <= 2) {
    // Every stored value once, instead of every sample.
    std::vector<std::uint8_t> table(std::size_t{1} << (8 * sizeof(T)));
    using U = std::make_unsigned_t<T>;
    for (std::size_t u = 0; u < table.size(); ++u) table[u] = inside(static_cast<T>(static_cast<U>(u)));
    return classify(volume.grid.dims, samples, context, [&](T stored) { return table[static_cast<U>(stored)] != 0; });
  } else {
    return classify(volume.grid.dims, samples, context, inside);
  }
}

}  // namespace

InsideSamples classify_samples(const Volume& volume, const ObjectRule& rule, const Context& context) {
  validate(rule);
  const bool complement = rule.side == Side::below;
  return visit_voxels(volume, [&]<typename T>(std::span<const T> samples) -> InsideSamples {
    switch (rule.kind) {
      case ObjectRule::Kind::threshold:
        return {classify_values(volume, samples, context, {rule.lo, kLargest}, complement), {}, {}};
      case ObjectRule::Kind::range:
        return {classify_values(volume, samples, part_of(context, 0, 0.4), {rule.lo, rule.hi}, complement),
                classify_values(volume, samples, part_of(context, 0.4, 0.8), above(rule.hi), false),
                classify_not_finite(volume, samples, part_of(context, 0.8, 1))};
      case ObjectRule::Kind::labels: break;
    }
    return {classify_labels(volume, samples, rule.labels, complement, context), {}, {}};
  });
}

}  // namespace spherule
