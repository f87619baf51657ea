// SPDX-License-Identifier: GPL-3.0-or-later
//
// spheruled: configuration -> store -> jobs -> listener, until SIGTERM or SIGINT.
#include <csignal>
#include <cstdio>
#include <exception>
#include <span>
#include <string>
#include <thread>

#include "api/routes.h"
#include "core/base/error.h"
#include "server/config.h"
#include "server/listener.h"
#include "server/pipeline.h"

namespace {

using namespace spherule;

// One line an answered request, on stderr; nothing that a client wrote is in it.
void log_access(const server::AccessRecord& r) {
  std::fprintf(stderr, "%s %s %s %d %.3f s\n", r.request_id.c_str(), r.method.c_str(),
               r.route.empty() ? "-" : r.route.c_str(), r.status, r.seconds);
}

void log_fault(const std::string& job, const std::string& what) {
  std::fprintf(stderr, "%s failed by a defect of this program: %s\n", job.c_str(), what.c_str());
}

int serve(const server::Config& config) {
  // Blocked before any thread starts, so that all inherit it and only sigwait takes them.
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);

  server::Pipeline pipeline(config, log_fault);
  server::Listener listener(
      {.host = config.host,
       .port = config.port,
       .max_body_bytes = config.max_body_bytes,
       .max_streams = config.max_streams},
      [&](const api::Request& request) { return api::handle(pipeline, request); }, log_access);
  std::jthread network([&] { listener.run(); });
  std::printf("Spherule listens on http://%s:%d\n", config.host.c_str(), int{listener.port()});
  std::fflush(stdout);

  int signal = 0;
  sigwait(&signals, &signal);
  std::fprintf(stderr, "Stopping; jobs that are not done run again at the next start.\n");
  listener.stop();
  pipeline.stop(std::chrono::seconds(2));
  return 0;
}

}  // namespace

int main(int argc, char** argv) {
  try {
    const auto config = server::parse_config(std::span<const char* const>(argv + 1, argv + argc));
    if (!config) {
      std::fputs(server::usage().c_str(), stdout);
      return 0;
    }
    return serve(*config);
  } catch (const std::exception& error) {
    std::fprintf(stderr, "spheruled: %s\n", error.what());
    return 1;
  }
}
