// SPDX-License-Identifier: GPL-3.0-or-later
//
// Options as words, as the REST interface and the command line give them.
#pragma once

#include <string>
#include <utility>
#include <vector>

namespace spherule {

/// Names and values.
using OptionTexts = std::vector<std::pair<std::string, std::string>>;

}  // namespace spherule
