// SPDX-License-Identifier: GPL-3.0-or-later
#include "core/base/check.h"

#include <gtest/gtest.h>

#include <string>

#include "core/base/parallel.h"

namespace spherule {
namespace {

TEST(Check, AViolatedInvariantIsThrownWithItsPlaceAndText) {
  try {
    SPHERULE_CHECK(1 + 1 == 3);
    FAIL();
  } catch (const Defect& defect) {
    const std::string what = defect.what();
    EXPECT_NE(what.find("check_test.cpp:"), std::string::npos) << what;
    EXPECT_NE(what.find("1 + 1 == 3"), std::string::npos) << what;
  }
}

TEST(Check, OneViolatedInAThreadOfAStageReachesItsCaller) {
  Context context;
  context.threads = 4;
  EXPECT_THROW(parallel_for(context, "", 100, 1, [](std::size_t begin, std::size_t) { SPHERULE_CHECK(begin < 99); }),
               Defect);
}

}  // namespace
}  // namespace spherule
