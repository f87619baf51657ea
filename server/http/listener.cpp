// SPDX-License-Identifier: GPL-3.0-or-later
//
#include "server/http/listener.h"

#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <strings.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <atomic>
#include <chrono>
#include <utility>

#include "api/http/problem.h"
#include "core/base/error.h"
#include "server/base/digest.h"
#include "server/base/log.h"
#include "server/http/body.h"
#include "server/http/connections.h"
#include "server/http/encoding.h"
#include "server/http/reply.h"
#include "server/http/tls.h"

namespace spherule::server {

namespace {

using api::HttpError;
using api::Request;
using api::Response;

constexpr std::size_t kLongestPath = 1024;
constexpr int kBacklog = 512;

bool is_method(std::string_view method) {
  constexpr std::array<std::string_view, 7> methods = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"};
  return std::ranges::find(methods, method) != methods.end();
}

bool same(std::string_view a, const char* b) {
  return a.size() == std::char_traits<char>::length(b) && ::strncasecmp(a.data(), b, a.size()) == 0;
}

class Socket {
 public:
  explicit Socket(int descriptor) : descriptor_(descriptor) {}
  ~Socket() { ::close(descriptor_); }
  Socket(const Socket&) = delete;
  Socket& operator=(const Socket&) = delete;
  int get() const { return descriptor_; }

 private:
  const int descriptor_;
};

int listening_socket(const std::string& host, std::uint16_t port) {
  addrinfo wanted{};
  wanted.ai_family = AF_UNSPEC;
  wanted.ai_socktype = SOCK_STREAM;
  wanted.ai_flags = AI_PASSIVE;
  addrinfo* found = nullptr;
  int listening = -1;
  if (::getaddrinfo(host.c_str(), std::to_string(port).c_str(), &wanted, &found) == 0) {
    for (const addrinfo* one = found; one != nullptr && listening < 0; one = one->ai_next) {
      listening = ::socket(one->ai_family, one->ai_socktype | SOCK_CLOEXEC | SOCK_NONBLOCK, one->ai_protocol);
      if (listening < 0) continue;
      const int yes = 1, no = 0;
      ::setsockopt(listening, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
      if (one->ai_family == AF_INET6) ::setsockopt(listening, IPPROTO_IPV6, IPV6_V6ONLY, &no, sizeof no);
      if (::bind(listening, one->ai_addr, one->ai_addrlen) != 0 || ::listen(listening, kBacklog) != 0) {
        ::close(std::exchange(listening, -1));
      }
    }
    ::freeaddrinfo(found);
  }
  if (listening < 0) {
    throw Error(ErrorCode::busy, "The address cannot be listened on; give another host or port, or stop what has it.");
  }
  return listening;
}

std::uint16_t port_of(int socket) {
  sockaddr_storage storage{};
  socklen_t size = sizeof storage;
  ::getsockname(socket, reinterpret_cast<sockaddr*>(&storage), &size);
  return ntohs(storage.ss_family == AF_INET6 ? reinterpret_cast<const sockaddr_in6&>(storage).sin6_port
                                             : reinterpret_cast<const sockaddr_in&>(storage).sin_port);
}

// The request as api/ sees it, without its body.
Request request_of(const Head& head) {
  Target target = parse_target(head.target);
  Request request{.method = head.method, .path = std::move(target.path), .query = std::move(target.query)};
  request.id = random_id("req");
  for (const auto& [name, value] : head.fields) {
    // The answer's entity is the same in every encoding; its tag is not.
    const bool tags = same(name, "If-None-Match") || same(name, "If-Match");
    request.headers.emplace_back(name, tags ? plain_tags(value) : value);
  }
  return request;
}

Response with_id(Response response, const std::string& id) {
  if (response.header("X-Request-Id").empty()) response.set("X-Request-Id", id);
  return response;
}

}  // namespace

struct Listener::State {
  State(ListenerOptions given, Handlers answers, AccessLog logs)
      : options(std::move(given)),
        handlers(std::move(answers)),
        log(std::move(logs)),
        transport(options.tls_certificate.empty() ? MakeTransport(plain_transport)
                                                  : tls_transport(options.tls_certificate, options.tls_key)),
        socket(listening_socket(options.host, options.port)),
        connections(options.connections, {.answer = [this](Connection& connection) { return answer(connection); },
                                          .refusal = [this](const HeadRefusal& why) { return refusal_text(why); },
                                          .is_health = [](const Head& head) { return is_health(head); }}) {}

  const ListenerOptions options;
  const Handlers handlers;
  const AccessLog log;
  const MakeTransport transport;
  Socket socket;
  std::atomic<bool> stopping{false};
  std::atomic<std::size_t> streams{0};
  Connections connections;  // goes first: it calls back

  static bool is_health(const Head& head);
  Connections::Next answer(Connection& connection);
  Response answered(const Request& request) const;
  std::optional<Response> refusal(const Request& request, const Connection& connection) const;
  std::string refusal_text(const HeadRefusal& why) const;
  void write_down(const Request& request, const Response& response, double seconds) const;
};

bool Listener::State::is_health(const Head& head) {
  const std::string_view path = std::string_view(head.target).substr(0, head.target.find('?'));
  return path == "/livez" || path == "/readyz" || path == "/metrics";
}

// An answer to what is not even a request.
std::string Listener::State::refusal_text(const HeadRefusal& why) const {
  const std::string id = random_id("req");
  Response problem = api::problem(HttpError(why.status, why.sentence), id);
  const std::string& body = std::get<std::string>(problem.body);
  problem.set("X-Request-Id", id);
  problem.set("Content-Length", std::to_string(body.size()));
  problem.set("Connection", "close");
  write_down({.id = id}, problem, 0);
  return head_text(problem.status, problem.headers) + body;
}

void Listener::State::write_down(const Request& request, const Response& response, double seconds) const {
  if (!log) return;
  log({request.id, is_method(request.method) ? request.method : "?", std::string(response.route), response.status,
       seconds, trace_of(request)});
}

// What the head alone decides.
std::optional<Response> Listener::State::refusal(const Request& request, const Connection& connection) const {
  if (!is_method(request.method)) {
    return api::problem(HttpError(405, "Use one of the methods GET, HEAD, POST, PATCH, DELETE, OPTIONS.",
                                  {{"Allow", "GET, HEAD, POST, PATCH, DELETE, OPTIONS"}}),
                        request.id);
  }
  if (request.path.size() > kLongestPath) return api::problem(414, request.id);
  if (!connection.head().has_body()) return {};
  if (request.method == "GET" || request.method == "HEAD" || request.method == "OPTIONS") {
    return api::problem(Error(ErrorCode::invalid_argument, "Send no body with this method."), request.id);
  }
  // For a body that is here already, the answer itself decides all this.
  if (connection.body_arrived() || !handlers.admit) return {};
  return handlers.admit(request);
}

Response Listener::State::answered(const Request& request) const {
  try {
    return handlers.answer(request);
  } catch (const Error& error) {
    return api::problem(error, request.id);
  } catch (...) {
    return api::problem(500, request.id);
  }
}

Connections::Next Listener::State::answer(Connection& connection) {
  const auto start = std::chrono::steady_clock::now();
  const Head& head = connection.head();
  Request request = request_of(head);
  HttpBody body(connection);
  request.body = &body;
  request.gone = [&connection] { return connection.is_gone(); };
  std::optional<Response> response = refusal(request, connection);
  if (!response) {
    connection.invite();
    if (!connection.body_arrived()) return Connections::Next::body;
    response = answered(request);
  }
  // Counted for as long as it is sent.
  struct Place {
    std::atomic<std::size_t>& streams;
    const bool taken;
    const std::size_t number = taken ? ++streams : 0;
    ~Place() {
      if (taken) --streams;
    }
  } const place{streams, std::holds_alternative<api::EventSource>(response->body)};
  if (place.number > options.max_streams) {
    response =
        api::problem(Error(ErrorCode::busy, "Too many event streams are open; poll the job instead."), request.id);
  }
  write_down(request, *response, std::chrono::duration<double>(std::chrono::steady_clock::now() - start).count());

  ReplyOptions how{.encoding = preferred_encoding(head.field("Accept-Encoding")),
                   .known_tags = std::string(head.field("If-None-Match")),
                   .stopping = [this] { return stopping.load(); }};
  const bool again = connection.drop_body() && !connection.last();
  if (again) {
    const auto idle = std::chrono::duration_cast<std::chrono::seconds>(options.connections.idle);
    how.keep_alive =
        "timeout=" + std::to_string(idle.count()) + ", max=" + std::to_string(options.connections.requests);
  }
  if (!send(with_id(std::move(*response), request.id), how, connection)) return Connections::Next::broken;
  return again ? Connections::Next::again : Connections::Next::close;
}

Listener::Listener(ListenerOptions options, Handlers handlers, AccessLog log)
    : state_(std::make_unique<State>(std::move(options), std::move(handlers), std::move(log))) {}

Listener::~Listener() = default;

std::uint16_t Listener::port() const { return port_of(state_->socket.get()); }

Listener::Load Listener::load() const {
  const Connections::Load load = state_->connections.load();
  return {.connections = load.open,
          .waiting = load.waiting,
          .answering = load.answering,
          .threads = load.threads,
          .streams = state_->streams,
          .received = load.received,
          .sent = load.sent};
}

void Listener::run() {
  State& s = *state_;
  if (!s.stopping) s.connections.accept_from(s.socket.get(), s.transport);
  s.stopping.wait(false);
  // Newcomers are refused at once; the descriptor lasts as long as somebody may use it.
  ::shutdown(s.socket.get(), SHUT_RDWR);
  s.connections.stop();
}

void Listener::stop() {
  state_->stopping = true;
  state_->stopping.notify_all();
}

}  // namespace spherule::server
