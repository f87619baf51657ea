// SPDX-License-Identifier: GPL-3.0-or-later
//
// Every stage of core that takes a context, on something that keeps it busy: for tests of what holds for all of them.
#pragma once

#include <functional>
#include <string>
#include <vector>

#include "core/base/context.h"

namespace spherule::stages {

struct Stage {
  std::string name;
  std::function<void(const Context&)> run;
};

/// On volumes of about `size`³ voxels and 8 · size² balls. What they work on lives as long as the program.
std::vector<Stage> all(int size);

}  // namespace spherule::stages
