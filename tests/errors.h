// SPDX-License-Identifier: GPL-3.0-or-later
//
// What every refusal must be.
#pragma once

#include <gtest/gtest.h>

#include <string>

#include "core/base/error.h"

namespace spherule::test {

/// Expects an Error of this code from f(), with a sentence that holds the words.
template <typename F>
void expect_error(F&& f, ErrorCode code, const std::string& words = {}) {
  try {
    f();
    ADD_FAILURE() << "nothing was thrown; expected: " << words;
  } catch (const Error& e) {
    EXPECT_EQ(static_cast<int>(e.code()), static_cast<int>(code)) << e.what();
    EXPECT_NE(std::string(e.what()).find(words), std::string::npos) << e.what();
    EXPECT_TRUE(std::string(e.what()).ends_with('.')) << e.what();
  }
}

}  // namespace spherule::test
