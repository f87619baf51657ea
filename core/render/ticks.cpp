// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/render/ticks.h"

#include <algorithm>
#include <array>
#include <charconv>
#include <cmath>

#include "core/base/elementary.h"
#include "core/base/text.h"

namespace spherule {

double round_step(double least) {
  const double power = elementary::pow(10.0, std::floor(elementary::log10(least)));
  for (const double factor : {1.0, 2.0, 5.0, 10.0})
    if (factor * power >= least * (1 - 1e-9)) return factor * power;
  return 10 * power;
}

std::vector<double> ticks(double lo, double hi, int most) {
  if (!(hi > lo) || !std::isfinite(hi - lo)) return {lo};
  const double step = round_step((hi - lo) / std::max(1, most));
  std::vector<double> all;
  // Counted, since far from 0 the next multiple may be no other number.
  const double first = std::ceil(lo / step - 1e-9);
  for (int i = 0; i <= most && first + i <= hi / step + 1e-9; ++i) all.push_back((first + i) * step + 0.0);
  all.erase(std::ranges::unique(all).begin(), all.end());
  return all;
}

std::vector<double> log_ticks(double lo, double hi) {
  std::vector<double> tens, all;
  for (double e = std::floor(elementary::log10(lo)); e <= elementary::log10(hi); ++e)
    for (const double factor : {1.0, 2.0, 5.0}) {
      const double value = factor * elementary::pow(10.0, e);
      if (value < lo * (1 - 1e-9) || value > hi * (1 + 1e-9)) continue;
      all.push_back(value);
      if (factor == 1) tens.push_back(value);
    }
  return tens.size() >= 3 ? tens : all;
}

std::string label(double value) {
  std::array<char, 32> text;
  // Six digits: multiples of a step carry rounding behind them.
  const auto end =
      std::to_chars(text.data(), text.data() + text.size(), value + 0.0, std::chars_format::general, 6).ptr;
  std::string out(text.data(), end);
  if (const auto e = out.find('e'); e != out.npos) {
    if (out[e + 2] == '0') out.erase(e + 2, 1);
    if (out[e + 1] == '+') out.erase(e + 1, 1);
  }
  if (out.front() == '-') out.replace(0, 1, "\u2212");
  return out;
}

std::string with_commas(double value) {
  std::string out = text_of(std::llround(value));
  for (std::size_t i = out.size(); i > 3 + (value < 0 ? 1U : 0U); i -= 3) out.insert(i - 3, 1, ',');
  return out;
}

}  // namespace spherule
