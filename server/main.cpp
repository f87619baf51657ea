// SPDX-License-Identifier: GPL-3.0-or-later
//
// spheruled: configuration -> store -> jobs -> listener, until SIGTERM or SIGINT; and the operator's commands.
#include <sys/resource.h>
#include <sys/stat.h>
#include <unistd.h>

#include <algorithm>
#include <chrono>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <exception>
#include <map>
#include <optional>
#include <span>
#include <string>
#include <thread>

#include "api/http/cors.h"
#include "api/routes.h"
#include "core/base/error.h"
#include "server/access/gate.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/config.h"
#include "server/fsck.h"
#include "server/http/listener.h"
#include "server/metrics.h"
#include "server/pipeline.h"

namespace {

using namespace spherule;

void log_access(const server::AccessRecord& r) {
  log(server::LogLine("request")
          .add("request", r.request_id)
          .add("method", r.method)
          .add_if("route", r.route)
          .add("status", std::int64_t{r.status})
          .add("seconds", r.seconds)
          .add_if("trace", r.trace));
}

void log_job(const server::JobRecord& job) {
  const std::chrono::duration<double> seconds = *job.finished - job.started.value_or(*job.finished);
  log(server::LogLine("job")
          .add("job", job.id)
          .add("kind", job.kind)
          .add_if("client", job.client)
          .add("result", job.result_id)
          .add("state", spherule::api::name(job.state))
          .add("seconds", seconds.count()));
}

void log_fault(const std::string& job, const std::string& what) {
  log(server::LogLine("fault").add("job", job).add("what", what));
}

// As many descriptors as the system allows: half for connections, half for files and all else.
server::ConnectionLimits connection_limits(const server::Config& config) {
  server::ConnectionLimits limits;
  limits.of_one_address = config.max_connections_per_address;
  rlimit descriptors{};
  if (::getrlimit(RLIMIT_NOFILE, &descriptors) != 0) return limits;
  descriptors.rlim_cur = descriptors.rlim_max;
  if (::setrlimit(RLIMIT_NOFILE, &descriptors) == 0 || ::getrlimit(RLIMIT_NOFILE, &descriptors) == 0) {
    limits.connections = std::min<std::size_t>(limits.connections, std::max<std::size_t>(descriptors.rlim_cur / 2, 16));
  }
  return limits;
}

// Blocked before any thread starts, so that all inherit it and only sigwait takes them.
sigset_t blocked_signals() {
  sigset_t signals;
  sigemptyset(&signals);
  sigaddset(&signals, SIGTERM);
  sigaddset(&signals, SIGINT);
  pthread_sigmask(SIG_BLOCK, &signals, nullptr);
  return signals;
}

server::PipelineLogs logs_of(server::AppendLog& audit) {
  return {.fault = log_fault,
          .job_ended = log_job,
          .expired =
              [&](const std::string& id) {
                const auto event =
                    server::LogLine("audit").add("who", "retention").add("action", "expire").add("object", id);
                if (!audit.append(event, false)) log(event);
              },
          .damaged = [](const std::string& id) { log(server::LogLine("damaged").add("object", id)); },
          .aside = [](const std::string& name) { log(server::LogLine("set_aside").add("object", name)); },
          .clock_moved =
              [](std::chrono::seconds by) {
                log(server::LogLine("clock_moved").add("seconds", std::int64_t{by.count()}));
              }};
}

server::ListenerOptions listener_options(const server::Config& config) {
  return {.host = config.host,
          .port = config.port,
          .tls_certificate = config.tls_certificate,
          .tls_key = config.tls_key,
          .max_streams = config.max_streams,
          .connections = connection_limits(config)};
}

// Returns once a signal has ended the service: with what the process is to end.
int serve_until(const sigset_t& signals, const server::Config& config, server::Pipeline& pipeline,
                server::Listener& listener) {
  std::jthread network([&] {
    try {
      listener.run();
    } catch (const std::exception& error) {
      log_fault("listener", error.what());
      ::kill(::getpid(), SIGTERM);
    }
  });
  std::printf("Spherule listens on %s://%s:%d\n", config.tls_key.empty() ? "http" : "https", config.host.c_str(),
              int{listener.port()});
  std::fflush(stdout);

  int signal = 0;
  sigwait(&signals, &signal);
  log(server::LogLine("stopping"));
  // Answering goes on meanwhile; a second signal ends the patience.
  pthread_sigmask(SIG_UNBLOCK, &signals, nullptr);
  const bool at_rest = pipeline.stop(config.drain);
  listener.stop();
  log(server::LogLine("stopped"));
  if (at_rest) return 0;
  // A job that does not hear must not hold up whoever stops the machine; all that is to last is on the disk.
  log_fault("pool", "a job did not stop when it was told to");
  std::_Exit(0);
}

int serve(const server::Config& config) {
  const sigset_t signals = blocked_signals();
  const api::AllowedOrigins origins = api::origins_from(config.cors_origins);
  server::RequestMetrics requests;
  std::optional<server::Listener> listener;
  server::AppendLog audit(config.audit_log);
  server::Pipeline pipeline(config, logs_of(audit), [&] {
    std::vector<api::Metric> metrics = requests.collect();
    for (auto& metric : metrics_of(listener->load())) metrics.push_back(std::move(metric));
    return metrics;
  });
  // One for each who may ask: event streams keep theirs.
  std::map<std::string, server::Pipeline> clients;
  clients.emplace("local", pipeline.on_behalf_of("local", server::Scope::admin));
  for (const server::ApiKey& key : config.keys) clients.emplace(key.name, pipeline.on_behalf_of(key.name, key.scope));
  // Without keys, or with one, there is nobody to share with.
  const std::size_t streams = config.keys.size() > 1 ? (config.max_streams + 1) / 2 : config.max_streams;
  const server::Gate gate({.keys = config.keys,
                           .hosts = server::hosts_from(config.hosts),
                           .origins = origins,
                           .streams_of_client = streams},
                          audit);
  const auto answer = [&](const api::Request& request) {
    return gate.pass(request, [&](const std::string& client) {
      api::Request known = request;
      known.client = client;
      return api::handle(clients.at(client), known);
    });
  };
  listener.emplace(
      listener_options(config),
      server::Listener::Handlers{.answer =
                                     [&](const api::Request& request) {
                                       return api::with_cors(origins, request, [&] { return answer(request); });
                                     },
                                 .admit = [&](const api::Request& request) -> std::optional<api::Response> {
                                   auto refused = gate.refusal(request);
                                   if (!refused) refused = api::refused_by_head(request, config.max_body_bytes);
                                   if (!refused) return {};
                                   return api::with_cors(origins, request, [&] { return *refused; });
                                 }},
      [&](const server::AccessRecord& request) {
        requests.count(request);
        log_access(request);
      });
  return serve_until(signals, config, pipeline, *listener);
}

int make_key(const server::CommandLine& line) {
  const std::string token = server::new_token();
  const server::ApiKey key{line.operand, line.scope, server::sha256_hex(token)};
  std::printf(
      "The token, for the client; it is not kept anywhere and not shown again:\n\n  %s\n\n"
      "Add this to `keys` of the configuration file (or SPHERULE_KEYS) and restart the server:\n\n  \"%s\"\n",
      token.c_str(), to_string(key).c_str());
  return 0;
}

int print(const server::StoreReport& report, const char* kept) {
  for (const server::Finding& finding : report.findings)
    std::printf("%s%s%s\n", std::string(to_string(finding.kind)).c_str(), finding.what.empty() ? "" : ": ",
                finding.what.c_str());
  std::printf("%s: %llu resources, %llu blobs, %llu bytes; %zu findings\n", kept,
              static_cast<unsigned long long>(report.resources), static_cast<unsigned long long>(report.blobs),
              static_cast<unsigned long long>(report.bytes), report.findings.size());
  return report.findings.empty() ? 0 : 2;
}

int run(const server::CommandLine& line) {
  using Command = server::CommandLine::Command;
  switch (line.command) {
    case Command::help: std::fputs(server::usage().c_str(), stdout); return 0;
    case Command::check_config: return 0;
    case Command::print_config: std::fputs(to_toml(line.config).c_str(), stdout); return 0;
    case Command::key: return make_key(line);
    case Command::fsck: return print(server::check_store(line.config.data, line.repair), "Good");
    case Command::backup: return print(server::copy_store(line.config.data, line.operand), "Copied");
    case Command::restore: return print(server::copy_store(line.operand, line.config.data), "Restored");
    case Command::serve: break;
  }
  return serve(line.config);
}

}  // namespace

int main(int argc, char** argv) {
  ::umask(0077);  // scans, and what is known of them, are nobody else's business
  try {
    return run(server::parse_command_line(std::span<const char* const>(argv + 1, argv + argc),
                                          [](const char* name) { return std::getenv(name); }));
  } catch (const std::exception& error) {
    std::fprintf(stderr, "spheruled: %s\n", error.what());
    return 1;
  }
}
