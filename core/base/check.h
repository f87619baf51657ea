// SPDX-License-Identifier: GPL-3.0-or-later
//
// Assertions about our own code, at three costs. Bad input is never checked here: it throws Error.
//   SPHERULE_CHECK  always on: O(1), at a stage's borders
//   SPHERULE_DCHECK on in debug builds: cheap enough for inner loops of tests
//   SPHERULE_AUDIT  on in debug builds: a whole named predicate, may cost as much as the stage itself
#pragma once

#include <stdexcept>
#include <string>

namespace spherule {

/// A violated invariant of our own. Thrown, so that a program that serves many loses one piece of work by it and not
/// the process. `what()` says where, for the log; never shown to remote users.
class Defect : public std::logic_error {
 public:
  using std::logic_error::logic_error;
};

namespace detail {
[[noreturn]] inline void check_failed(const char* expression, const char* file, int line) {
  throw Defect(std::string(file) + ":" + std::to_string(line) + ": violated: " + expression);
}
}  // namespace detail

}  // namespace spherule

#define SPHERULE_CHECK(expression) \
  ((expression) ? void(0) : ::spherule::detail::check_failed(#expression, __FILE__, __LINE__))
#ifdef NDEBUG
#define SPHERULE_DCHECK(expression) void(0)
#define SPHERULE_AUDIT(expression) void(0)
#else
#define SPHERULE_DCHECK(expression) SPHERULE_CHECK(expression)
#define SPHERULE_AUDIT(expression) SPHERULE_CHECK(expression)
#endif
