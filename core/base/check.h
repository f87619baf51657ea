// SPDX-License-Identifier: GPL-3.0-or-later
//
// Assertions about our own code, at three costs. Bad input is never checked here: it throws Error.
//   SPHERULE_CHECK  always on: O(1), at a stage's borders
//   SPHERULE_DCHECK on in debug builds: cheap enough for inner loops of tests
//   SPHERULE_AUDIT  on in debug builds: a whole named predicate, may cost as much as the stage itself
#pragma once

#include <cstdio>
#include <cstdlib>

namespace spherule::detail {
[[noreturn]] inline void check_failed(const char* expression, const char* file, int line) {
  std::fprintf(stderr, "spherule: %s:%d: violated: %s\n", file, line, expression);
  std::abort();
}
}  // namespace spherule::detail

#define SPHERULE_CHECK(expression) \
  ((expression) ? void(0) : ::spherule::detail::check_failed(#expression, __FILE__, __LINE__))
#ifdef NDEBUG
#define SPHERULE_DCHECK(expression) void(0)
#define SPHERULE_AUDIT(expression) void(0)
#else
#define SPHERULE_DCHECK(expression) SPHERULE_CHECK(expression)
#define SPHERULE_AUDIT(expression) SPHERULE_CHECK(expression)
#endif
