// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/base/text.h"

#include <gtest/gtest.h>

#include <cmath>
#include <cstdint>
#include <limits>

namespace spherule {
namespace {

using Parts = std::vector<std::string_view>;

TEST(Text, TrimmedHasNoBlanksAtEitherEnd) {
  EXPECT_EQ(trimmed(" \t\r\n\v\fa b \n"), "a b");
  EXPECT_EQ(trimmed("a"), "a");
  EXPECT_EQ(trimmed(" \t "), "");
  EXPECT_EQ(trimmed(""), "");
  EXPECT_EQ(trimmed("\n= a =\n", " =\n"), "a");
  EXPECT_EQ(trimmed("\na\n", " "), "\na\n");
}

TEST(Text, LoweredLeavesOtherBytesAlone) {
  EXPECT_EQ(lowered("AZaz09 [@`{"), "azaz09 [@`{");
  EXPECT_EQ(lowered("\xc3\x84\xff"), "\xc3\x84\xff");
}

TEST(Text, SplitKeepsEmptyParts) {
  EXPECT_EQ(split("a,b", ','), (Parts{"a", "b"}));
  EXPECT_EQ(split("", ','), (Parts{""}));
  EXPECT_EQ(split(",", ','), (Parts{"", ""}));
  EXPECT_EQ(split(",a,,", ','), (Parts{"", "a", "", ""}));
}

TEST(Text, Listed) {
  EXPECT_EQ(listed(Parts{}), "");
  EXPECT_EQ(listed(Parts{"one"}), "one");
  EXPECT_EQ(listed(Parts{"one", "two", "three"}), "one, two, three");
}

TEST(Text, ANumberIsAllOfTheText) {
  EXPECT_EQ(number_in<int>("-12"), -12);
  EXPECT_EQ(number_in<std::uint8_t>("255"), 255);
  EXPECT_EQ(number_in<double>("1e-3"), 0.001);
  EXPECT_EQ(number_in<double>("-0.5"), -0.5);
  for (const char* text : {"", " ", "1 ", " 1", "1,", "+1", "0x1", "one", "1e", "--1"}) {
    EXPECT_FALSE(number_in<int>(text)) << text;
    EXPECT_FALSE(number_in<double>(text)) << text;
  }
  EXPECT_FALSE(number_in<int>("1.0"));
  EXPECT_FALSE(number_in<std::uint8_t>("256"));
  EXPECT_FALSE(number_in<unsigned>("-1"));
  for (const char* text : {"inf", "-inf", "nan", "1e999"}) EXPECT_FALSE(number_in<double>(text)) << text;
}

TEST(Text, TextReadsBackToTheSameNumber) {
  EXPECT_EQ(text_of(0.1), "0.1");
  EXPECT_EQ(text_of(-0.0), "0");
  EXPECT_EQ(text_of(1e9), "1e+09");
  EXPECT_EQ(text_of(std::int64_t{-12}), "-12");
  EXPECT_EQ(text_of(std::numeric_limits<std::uint64_t>::max()), "18446744073709551615");
  for (const double value : {1.0 / 3, -5e-324, std::numeric_limits<double>::max(), std::nextafter(1, 2)})
    EXPECT_EQ(number_in<double>(text_of(value)), value);
}

}  // namespace
}  // namespace spherule
