// SPDX-License-Identifier: GPL-3.0-or-later
//
// Round numbers for axes, legends and scale bars. Private to core/render.
#pragma once

#include <string>
#include <vector>

namespace spherule {

/// 1, 2 or 5 times a power of ten: the least such number that is at least `least` (above 0).
double round_step(double least);
/// Multiples of a round step within [lo, hi], at most `most` + 1 of them; only lo when hi is not above it.
std::vector<double> ticks(double lo, double hi, int most);
/// Powers of ten within [lo, hi], both above 0; with 2 and 5 times each where there would be fewer than three.
std::vector<double> log_ticks(double lo, double hi);
/// The shortest text of a round number: 1000000 becomes 1e6 (as does 1e-5), thousands have no separator.
std::string label(double value);
/// A whole number with commas between thousands.
std::string with_commas(double value);

}  // namespace spherule
