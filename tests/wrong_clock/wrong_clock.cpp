// SPDX-License-Identifier: GPL-3.0-or-later
//
// A clock on the wall that is wrong by SPHERULE_CLOCK_OFF seconds, for whatever process preloads this.
#include <dlfcn.h>
#include <sys/time.h>

#include <cstdlib>
#include <ctime>

namespace {

using ClockGetTime = int(clockid_t, timespec*);

int right_time(clockid_t clock, timespec* time) {
  static auto* const real = reinterpret_cast<ClockGetTime*>(::dlsym(RTLD_NEXT, "clock_gettime"));
  return real(clock, time);
}

time_t off() {
  const char* text = std::getenv("SPHERULE_CLOCK_OFF");
  return text == nullptr ? 0 : std::atol(text);
}

}  // namespace

extern "C" int clock_gettime(clockid_t clock, timespec* time) {
  const int result = right_time(clock, time);
  if (result == 0 && (clock == CLOCK_REALTIME || clock == CLOCK_REALTIME_COARSE)) time->tv_sec += off();
  return result;
}

extern "C" time_t time(time_t* out) {
  timespec now{};
  clock_gettime(CLOCK_REALTIME, &now);
  if (out != nullptr) *out = now.tv_sec;
  return now.tv_sec;
}

extern "C" int gettimeofday(timeval* __restrict out, void* __restrict) {
  timespec now{};
  const int result = clock_gettime(CLOCK_REALTIME, &now);
  *out = {.tv_sec = now.tv_sec, .tv_usec = now.tv_nsec / 1000};
  return result;
}
