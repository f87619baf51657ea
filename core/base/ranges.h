// SPDX-License-Identifier: GPL-3.0-or-later
//
// Which numbers a request may hold, by name: the one table. openapi.yaml states the same ranges, and a test holds one
// against the other. They are wide enough for every use and narrow enough that whatever is computed of them stays an
// ordinary number:
//   lengths   spheres and grids lie within 1e9 mm (core/volume.h, core/write/export.h), so no length in a model is
//             of use beyond it; squares and cubes of lengths, and their reciprocals, are far from the ends of float64
//   places    a camera or a plane may stand a thousand times as far away; of what is 1e9 mm large there, float64 still
//             tells 2^23 places apart
//   values    samples may be any numbers, so what they are compared with may be nearly any: differences of
//             two are finite
#pragma once

#include <algorithm>
#include <cmath>
#include <cstdint>
#include <string>

#include "core/base/geometry.h"
#include "core/base/text.h"

namespace spherule {

/// Numbers from `least` to `most`, both included unless `above`: then greater than `least`.
template <typename T>
struct NumberRange {
  T least, most;
  bool above = false;

  /// False for NaN.
  constexpr bool holds(T value) const { return (above ? value > least : value >= least) && value <= most; }
  /// "within 0 and 4", "above 0 and at most 1".
  std::string words() const {
    return (above ? "above " : "within ") + text(least) + (above ? " and at most " : " and ") + text(most);
  }

 private:
  // 1e9 for 1e+09.
  static std::string text(T value) {
    std::string out = text_of(value);
    if (const auto e = out.find('e'); e != out.npos) {
      if (out[e + 2] == '0') out.erase(e + 2, 1);
      if (out[e + 1] == '+') out.erase(e + 1, 1);
    }
    return out;
  }
};

namespace ranges {

using Real = NumberRange<double>;
using Whole = NumberRange<std::int64_t>;

// Of all requests.
inline constexpr Real value{-1e300, 1e300};           ///< thresholds, ranges, levels and marks
inline constexpr Real length_mm{0, 1e9};              ///< radii and distances in models
inline constexpr Whole level{1, 0xffffffff};          ///< of a simplified model
inline constexpr Whole page{1, 1000};                 ///< entries a page
inline constexpr Whole index{0, 0x7fffffff};          ///< of files, frames, slices
inline constexpr Whole bytes{0, 0x7fffffffffffffff};  ///< of uploads: sizes and offsets; numbers of events too
inline constexpr Whole wait_s{0, 0xffffffff};         ///< of `Prefer: wait`

// Pictures.
inline constexpr Whole pixels{1, 8192};
inline constexpr Whole plot_pixels{100, 8192};
inline constexpr Whole samples{1, 8};
inline constexpr Real smoothness{0, 4};
inline constexpr Whole bucket_count{1, 1024}, bucket{0, 1023};
inline constexpr Whole turntable{0, 360};
inline constexpr Real opacity{0, 1, true};
inline constexpr Real field_of_view{1, 120};      ///< degrees
inline constexpr Real place_mm{-1e12, 1e12};      ///< each coordinate of position and look_at, and the offset of clip
inline constexpr Real direction{-1e12, 1e12};     ///< each component of up and of clip's normal
inline constexpr Real colour_range{-1e30, 1e30};  ///< mm, mm³ or 1/mm
inline constexpr Real window{1e-300, 1e300};
inline constexpr Real region{-1e6, 1e6};  ///< samples

// Rows of spheres and histograms.
inline constexpr Whole row{0, std::int64_t{1} << 52}, rows{1, 100'000};
inline constexpr Whole buckets{1, 65536};

// Files for other programs.
inline constexpr Real density{1e-9, 1e9};  ///< kg/m³
inline constexpr Real voxel_mm{1e-9, 1e9};
inline constexpr Whole detail{0, 5};

// Simplification.
inline constexpr Whole count{1, 0xffffffff};  ///< of spheres
inline constexpr Whole best_count{1, 65535};
inline constexpr Real share{0, 1, true};

// Registration.
inline constexpr Whole registered_spheres{4, 512}, inits{1, 256};
inline constexpr Real scale{1e-9, 1e9};
inline constexpr Real weight{0, 1e6};

// The layout of headerless samples.
inline constexpr Whole dim{1, 0x7fffffff};
inline constexpr Real spacing_mm{1e-9, 1e9}, origin_mm{-1e9, 1e9};

}  // namespace ranges
/// Whether the range holds each coordinate.
constexpr bool all_in(const NumberRange<double>& range, Vec3 v) {
  return range.holds(v.x) && range.holds(v.y) && range.holds(v.z);
}

}  // namespace spherule
