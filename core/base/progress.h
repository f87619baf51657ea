// SPDX-License-Identifier: GPL-3.0-or-later
//
// Contexts for parts of a stage's work. A stage's progress never goes back, and only that stage reports under its name:
// so what it calls reports a part of its progress, or nothing.
#pragma once

#include "core/base/context.h"

namespace spherule {

/// The same, but for the progress: what is reported, 0 to 1, becomes from … to of the whole, under the same name. The
/// whole must outlive it.
inline Context part_of(const Context& whole, double from, double to) {
  return {.threads = whole.threads,
          .cancel = whole.cancel,
          .progress = [&whole, from, to](std::string_view stage, double fraction) {
            whole.report(stage, from + (to - from) * fraction);
          }};
}

/// The same, without progress.
inline Context quiet(const Context& context) {
  return {.threads = context.threads, .cancel = context.cancel, .progress = {}};
}

}  // namespace spherule
