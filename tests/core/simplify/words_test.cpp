// SPDX-License-Identifier: GPL-3.0-or-later
#include <gtest/gtest.h>

#include "core/simplify/simplify.h"

namespace spherule {
namespace {

std::string pointers(const OptionTexts& texts) {
  try {
    static_cast<void>(parse_method(texts));
  } catch (const Error& error) {
    EXPECT_EQ(error.code(), ErrorCode::invalid_argument);
    std::string list;
    for (const FieldError& field : error.fields()) list += field.pointer + " ";
    return list;
  }
  return "none";
}

TEST(MethodWords, ReadBack) {
  const auto texts_of = [](const OptionTexts& given) { return method_texts(parse_method(given)); };
  EXPECT_EQ(
      texts_of({{"method", "sphericity"}}),
      (OptionTexts{{"method", "sphericity"}, {"threshold", "0.7"}, {"limit", "256"}, {"representative", "enclosing"}}));
  EXPECT_EQ(texts_of({{"representative", "volume"}, {"k", "9"}, {"method", "average"}}),
            (OptionTexts{{"method", "average"}, {"k", "9"}, {"representative", "volume"}}));
  EXPECT_EQ(texts_of({{"method", "prune"}, {"buckets", "7,3,7,0"}}),
            (OptionTexts{{"method", "prune"}, {"buckets", "0,3,7"}, {"bucket_count", "40"}}));
  EXPECT_EQ(texts_of({{"method", "prune"}, {"least_radius_mm", "-0"}}),
            (OptionTexts{{"method", "prune"}, {"least_radius_mm", "0"}}));
  EXPECT_EQ(texts_of({{"method", "best"}, {"iou", "0.9"}, {"mode", "outer"}}),
            (OptionTexts{{"method", "best"}, {"mode", "outer"}, {"iou", "0.9"}}));
  for (const char* method : {"sphericity", "median", "average", "prune", "best"}) {
    const OptionTexts texts = texts_of({{"method", method}});
    EXPECT_EQ(texts_of(texts), texts);
  }
}

TEST(MethodWords, RefuseWhatMakesNoSense) {
  EXPECT_EQ(pointers({}), "/method ");
  EXPECT_EQ(pointers({{"method", "k-means"}, {"k", "x"}}), "/method ");
  EXPECT_EQ(pointers({{"method", "median"}, {"k", "x"}, {"seed", "1"}, {"iou", "1"}}), "/k /seed /iou ");
  EXPECT_EQ(pointers({{"method", "median"}, {"k", "1"}, {"k", "1"}}), "/k /k ");
  EXPECT_EQ(pointers({{"method", "sphericity"}, {"threshold", "nan"}}), "/threshold ");
  EXPECT_EQ(pointers({{"method", "sphericity"}, {"threshold", "0.5x"}}), "/threshold ");
  EXPECT_EQ(pointers({{"method", "sphericity"}, {"limit", "4294967296"}}), "/limit ");
  EXPECT_EQ(pointers({{"method", "best"}, {"mode", "Inner"}}), "/mode ");
  EXPECT_EQ(pointers({{"method", "prune"}, {"buckets", "1,,2"}}), "/buckets ");
  EXPECT_EQ(pointers({{"method", "prune"}, {"buckets", ""}}), "/buckets ");
  EXPECT_EQ(pointers({{"method", "prune"}, {"bucket_count", "3"}}), "/bucket_count ");
}

TEST(CheckMethod, RefusesWhatTheModelCannotGive) {
  const auto pointer = [](const OptionTexts& texts, std::size_t count) -> std::string {
    try {
      check_method(parse_method(texts), count);
    } catch (const Error& error) {
      return error.code() == ErrorCode::invalid_argument ? error.fields().at(0).pointer : "unusable";
    }
    return "none";
  };
  for (const char* method : {"median", "average", "prune", "best"}) {
    EXPECT_EQ(pointer({{"method", method}, {"k", "0"}}, 9), "/k") << method;
    EXPECT_EQ(pointer({{"method", method}, {"k", "10"}}, 9), "/k") << method;
    EXPECT_EQ(pointer({{"method", method}, {"k", "9"}}, 9), "none") << method;
    EXPECT_EQ(pointer({{"method", method}, {"k", "1"}}, 0), "unusable") << method;
  }
  EXPECT_EQ(pointer({{"method", "sphericity"}, {"limit", "0"}}, 9), "/limit");
  EXPECT_EQ(pointer({{"method", "sphericity"}, {"limit", "10"}}, 9), "/limit");
  for (const char* wrong : {"0", "-1", "1.0000001"}) {
    EXPECT_EQ(pointer({{"method", "sphericity"}, {"limit", "9"}, {"threshold", wrong}}, 9), "/threshold");
    EXPECT_EQ(pointer({{"method", "best"}, {"iou", wrong}}, 9), "/iou");
    EXPECT_EQ(pointer({{"method", "prune"}, {"volume_share", wrong}}, 9), "/volume_share");
  }
  EXPECT_EQ(pointer({{"method", "prune"}, {"least_radius_mm", "-1"}}, 9), "/least_radius_mm");
  EXPECT_EQ(pointer({{"method", "prune"}, {"buckets", "40"}}, 9), "/buckets");
  EXPECT_EQ(pointer({{"method", "prune"}, {"buckets", "0"}, {"bucket_count", "65537"}}, 9), "/bucket_count");
  EXPECT_EQ(pointer({{"method", "prune"}}, 9), "") << "no rule";
  EXPECT_EQ(pointer({{"method", "prune"}, {"k", "3"}, {"volume_share", "0.5"}}, 9), "") << "two rules";
  EXPECT_EQ(pointer({{"method", "best"}}, 9), "");
  EXPECT_EQ(pointer({{"method", "best"}, {"k", "3"}, {"iou", "0.5"}}, 9), "");
  EXPECT_EQ(pointer({{"method", "best"}, {"k", "65536"}}, 70000), "/k");
}

}  // namespace
}  // namespace spherule
