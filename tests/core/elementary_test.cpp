// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/base/elementary.h"

#include <gtest/gtest.h>

#include <cmath>
#include <limits>
#include <numbers>

#include "tests/phantoms.h"

namespace spherule {
namespace {

// Against the C library's in 64 bits of mantissa.
void expect_near(double ours, long double truth) {
  if (std::isnan(truth)) {
    EXPECT_TRUE(std::isnan(ours));
    return;
  }
  if (std::isinf(static_cast<double>(truth))) {
    EXPECT_EQ(ours, static_cast<double>(truth));
    return;
  }
  const double size = std::abs(static_cast<double>(truth));
  const double ulp = std::nextafter(size, std::numeric_limits<double>::infinity()) - size;
  EXPECT_LE(std::abs(ours - truth), 1.001L * ulp) << truth;
}

TEST(Elementary, FunctionsAreWithinAnUlpOfTheTruth) {
  phantoms::Random random(1);
  for (int i = 0; i < 20000; ++i) {
    const double x = (random.unit() - 0.5) * std::ldexp(1.0, static_cast<int>(random.below(24)) - 12);
    const double y = (random.unit() - 0.5) * std::ldexp(1.0, static_cast<int>(random.below(24)) - 12);
    const long double wide_x = x, wide_y = y;
    expect_near(elementary::sin(x), std::sin(wide_x));
    expect_near(elementary::cos(x), std::cos(wide_x));
    expect_near(elementary::tan(x), std::tan(wide_x));
    expect_near(elementary::asin(x), std::asin(wide_x));
    expect_near(elementary::atan2(y, x), std::atan2(wide_y, wide_x));
    expect_near(elementary::exp(x), std::exp(wide_x));
    expect_near(elementary::log(x), std::log(wide_x));
    expect_near(elementary::log10(x), std::log10(wide_x));
    expect_near(elementary::pow(std::abs(x), y), std::pow(std::abs(wide_x), wide_y));
    expect_near(elementary::cbrt(x), std::cbrt(wide_x));
    expect_near(elementary::hypot(x, y), std::hypot(wide_x, wide_y));
  }
}

TEST(Elementary, FunctionsAreExactWhereTheTruthIsANumber) {
  for (int n = -40; n <= 40; ++n) {
    EXPECT_EQ(elementary::cbrt(static_cast<double>(n) * n * n), n);
    EXPECT_EQ(elementary::pow(n, 3), static_cast<double>(n) * n * n);
    EXPECT_EQ(elementary::hypot(3.0 * n, 4.0 * n), 5.0 * std::abs(n));
  }
  double power = 1;
  for (int e = 0; e <= 22; ++e, power *= 10) {
    EXPECT_EQ(elementary::pow(10, e), power);
    EXPECT_EQ(elementary::log10(power), e);
  }
  EXPECT_EQ(elementary::exp(0), 1);
  EXPECT_EQ(elementary::log(1), 0);
  EXPECT_EQ(elementary::cos(0), 1);
}

TEST(Elementary, FunctionsTakeSpecialValuesAsInC) {
  constexpr double infinity = std::numeric_limits<double>::infinity();
  EXPECT_EQ(elementary::exp(-infinity), 0);
  EXPECT_EQ(elementary::exp(infinity), infinity);
  EXPECT_EQ(elementary::log(0), -infinity);
  EXPECT_TRUE(std::isnan(elementary::log(-1)));
  EXPECT_TRUE(std::isnan(elementary::sin(infinity)));
  EXPECT_TRUE(std::isnan(elementary::asin(1.5)));
  EXPECT_EQ(elementary::atan2(0.0, -1), std::numbers::pi);
  EXPECT_EQ(elementary::atan2(-0.0, -1), -std::numbers::pi);
  EXPECT_EQ(elementary::atan2(1, 0), std::numbers::pi / 2);
  EXPECT_EQ(elementary::hypot(infinity, 1), infinity);
}

}  // namespace
}  // namespace spherule
