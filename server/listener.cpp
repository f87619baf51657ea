// SPDX-License-Identifier: GPL-3.0-or-later
//
// The library leaves much to its user. What is done here and why (cpp-httplib 0.11.4; http/body.h has more):
// - A body that was not read to its end would be taken for the next request: the connection is closed then.
// - Ranges and content encodings are decided by api/ and http/; the library's own are switched off by removing what it
//   goes by from the request. It reads past the end for ranges that lie outside, and compresses with Brotli's slowest
//   level.
#include "server/listener.h"

#include <httplib.h>
#include <strings.h>
#include <sys/socket.h>

#include <algorithm>
#include <array>
#include <chrono>

#include "api/problem.h"
#include "core/base/error.h"
#include "server/digest.h"
#include "server/http/body.h"
#include "server/http/connections.h"
#include "server/http/encoding.h"
#include "server/http/reply.h"
#include "server/http/tls.h"
#include "server/log.h"

namespace spherule::server {

namespace {

using api::Request;
using api::Response;

constexpr std::size_t kLongestPath = 1024;

bool is_method(std::string_view method) {
  constexpr std::array<std::string_view, 7> methods = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"};
  return std::ranges::find(methods, method) != methods.end();
}

// Our own mark on answers; the library's own have none.
constexpr const char* kOurs = "X-Request-Id";

// An answer to what is not even a request.
std::string refusal_text(int status) {
  const std::string id = random_id("req");
  const Response problem = api::problem(status, id);
  const std::string& body = std::get<std::string>(problem.body);
  return "HTTP/1.1 " + std::to_string(status) +
         (status == 408 ? " Request Timeout" : " Request Header Fields Too Large") +
         "\r\nConnection: close\r\nContent-Type: application/problem+json\r\nContent-Length: " +
         std::to_string(body.size()) + "\r\n" + kOurs + ": " + id + "\r\n\r\n" + body;
}

// The library accepts connections and reads, answers and writes one request; what lies between is ours.
class Server final : public httplib::Server {
 public:
  explicit Server(const ListenerOptions& options, Connections::Refusal refusal)
      : transport_(options.tls_certificate.empty() ? MakeTransport(plain_transport)
                                                   : tls_transport(options.tls_certificate, options.tls_key)),
        connections_(
            options.connections,
            [this](Connection& connection, bool last) {
              bool closed = false;
              return process_request(connection, last, closed, nullptr) && !closed && !last;
            },
            std::move(refusal)) {
    new_task_queue = [this] { return new Accepted(connections_); };
  }
  const Connections& connections() const { return connections_; }

 private:
  // Where the library's loop puts what it has accepted: nothing that is put there blocks.
  struct Accepted final : httplib::TaskQueue {
    explicit Accepted(Connections& all) : connections(all) {}
    void enqueue(std::function<void()> add) override { add(); }
    void shutdown() override { connections.stop(); }
    Connections& connections;
  };
  bool process_and_close_socket(socket_t socket) override {
    connections_.add(transport_(socket));
    return true;
  }

  MakeTransport transport_;
  Connections connections_;
};

}  // namespace

struct Listener::State {
  State(ListenerOptions given, Handler answers, AccessLog logs)
      : options(std::move(given)), handler(std::move(answers)), log(std::move(logs)), http(options, refusal_text) {}

  ListenerOptions options;
  Handler handler;
  AccessLog log;
  Server http;
  std::uint16_t port = 0;
  std::atomic<bool> stopping{false}, finished{false};
  std::atomic<std::size_t> streams{0};

  void serve(httplib::Request& request, httplib::Response& response, const httplib::ContentReader* reader);
  void reply(Response&& answer, ReplyOptions options, httplib::Response& response);
  void send_own(const httplib::Request& request, Response&& problem, httplib::Response& response);
};

void Listener::State::reply(Response&& answer, ReplyOptions how, httplib::Response& response) {
  how.stopping = [this] { return stopping.load(); };
  how.streamed = [this] { --streams; };
  send(std::move(answer), std::move(how), response);
}

void Listener::State::serve(httplib::Request& request, httplib::Response& response,
                            const httplib::ContentReader* reader) {
  const auto start = std::chrono::steady_clock::now();
  Request asked;
  asked.id = random_id("req");
  asked.method = request.method;
  asked.path = request.path;
  for (const auto& [name, value] : request.params) asked.query.emplace_back(name, value);
  for (const auto& [name, value] : request.headers) {
    // The answer's entity is the same in every encoding; its tag is not.
    const bool tags = ::strcasecmp(name.c_str(), "If-None-Match") == 0 || ::strcasecmp(name.c_str(), "If-Match") == 0;
    asked.headers.emplace_back(name, tags ? plain_tags(value) : value);
  }
  ReplyOptions how{.encoding = preferred_encoding(request.get_header_value("Accept-Encoding")),
                   .known_tags = request.get_header_value("If-None-Match")};
  request.ranges.clear();
  request.headers.erase("Accept-Encoding");

  Response answer;
  try {
    HttpBody body(request, reader, stopping);
    if (reader == nullptr && body.present()) {
      // Without a reader there is no way past the body but to close; and no answer to HEAD closes.
      if (request.method == "HEAD") request.method = "GET";
      throw Error(ErrorCode::invalid_argument, "Send no body with this method.");
    }
    asked.body = &body;
    asked.gone = [connection = Connection::current()] { return connection != nullptr && connection->is_gone(); };
    // What is deleted cannot be told with the text that closes a connection; so the body goes first.
    if (request.method == "DELETE") body.drain();
    if (request.method == "DELETE" && !body.finished()) {
      throw Error(ErrorCode::invalid_argument, "Send no body with this method.");
    }
    answer = handler(asked);
    body.drain();
    if (!body.finished()) how.close = lingering(reader);
  } catch (const Error& error) {
    how.close = [] {};
    answer = api::problem(error, asked.id);
    answer.set(kOurs, asked.id);
  }
  if (std::holds_alternative<api::EventSource>(answer.body) && ++streams > options.max_streams) {
    --streams;
    answer = api::problem(Error(ErrorCode::busy, "Too many event streams are open; poll the job instead."), asked.id);
    answer.set(kOurs, asked.id);
  }
  if (log) {
    const std::chrono::duration<double> seconds = std::chrono::steady_clock::now() - start;
    log({asked.id, is_method(asked.method) ? asked.method : "?", std::string(answer.route), answer.status,
         seconds.count(), trace_of(asked)});
  }
  reply(std::move(answer), std::move(how), response);
}

// What the library refuses by itself: requests that it cannot parse.
void Listener::State::send_own(const httplib::Request& request, Response&& problem, httplib::Response& response) {
  const std::string id(problem.header(kOurs));
  if (log) log({id, is_method(request.method) ? request.method : "?", {}, problem.status, 0, {}});
  response.headers.clear();
  response.body.clear();
  const_cast<httplib::Request&>(request).ranges.clear();
  reply(std::move(problem), {.close = [] {}}, response);
}

Listener::Listener(ListenerOptions options, Handler handler, AccessLog log)
    : state_(std::make_unique<State>(std::move(options), std::move(handler), std::move(log))) {
  State& s = *state_;
  // What the library tells clients; Connections keeps to it.
  s.http.set_keep_alive_timeout(std::chrono::duration_cast<std::chrono::seconds>(s.options.connections.idle).count());
  s.http.set_keep_alive_max_count(s.options.connections.requests);
  s.http.set_tcp_nodelay(true);

  const auto refuse = [&s](const httplib::Request& request, httplib::Response& response, int status) {
    const std::string id = random_id("req");
    Response problem = api::problem(status, id);
    problem.set(kOurs, id);
    if (status == 405) problem.set("Allow", "GET, HEAD, POST, PATCH, DELETE, OPTIONS");
    s.send_own(request, std::move(problem), response);
  };
  s.http.set_pre_routing_handler([refuse](const httplib::Request& request, httplib::Response& response) {
    // Longer paths name nothing, and the library would match them recursively.
    const int status = !is_method(request.method) ? 405 : request.path.size() > kLongestPath ? 414 : 0;
    if (status == 0) return httplib::Server::HandlerResponse::Unhandled;
    refuse(request, response, status);
    return httplib::Server::HandlerResponse::Handled;
  });
  s.http.set_error_handler(
      httplib::Server::HandlerWithResponse([refuse](const httplib::Request& request, httplib::Response& response) {
        if (response.has_header(kOurs)) return httplib::Server::HandlerResponse::Unhandled;
        refuse(request, response, response.status);
        return httplib::Server::HandlerResponse::Handled;
      }));
  s.http.set_exception_handler([refuse](const httplib::Request& request, httplib::Response& response,
                                        const std::exception_ptr&) { refuse(request, response, 500); });
  s.http.set_expect_100_continue_handler([&s](const httplib::Request& request, httplib::Response& response) {
    try {
      response.status = framing(request).announced > s.options.max_body_bytes ? 413 : -1;
    } catch (const Error&) {
      response.status = 400;
    }
    return response.status == -1 ? 100 : response.status;
  });
  s.http.set_post_routing_handler([](const httplib::Request&, httplib::Response& response) {
    if (response.status == 204 || response.status == 304) response.headers.erase("Content-Length");
    if (response.has_header("Connection")) response.headers.erase("Keep-Alive");
  });

  const auto plain = [&s](const httplib::Request& request, httplib::Response& response) {
    s.serve(const_cast<httplib::Request&>(request), response, nullptr);
  };
  const auto reading = [&s](const httplib::Request& request, httplib::Response& response,
                            const httplib::ContentReader& reader) {
    s.serve(const_cast<httplib::Request&>(request), response, &reader);
  };
  constexpr const char* all = ".*";
  s.http.Get(all, plain).Options(all, plain);
  s.http.Post(all, reading).Put(all, reading).Patch(all, reading).Delete(all, reading);

  socket_t socket = INVALID_SOCKET;
  s.http.set_socket_options([&socket](socket_t made) {
    const int yes = 1;
    setsockopt(made, SOL_SOCKET, SO_REUSEADDR, &yes, sizeof yes);
    socket = made;
  });
  const int port = s.options.port == 0                                   ? s.http.bind_to_any_port(s.options.host)
                   : s.http.bind_to_port(s.options.host, s.options.port) ? s.options.port
                                                                         : -1;
  s.http.set_socket_options({});
  if (port <= 0) {
    throw Error(ErrorCode::busy, "The address cannot be listened on; give another host or port, or stop what has it.");
  }
  s.port = static_cast<std::uint16_t>(port);
  // The library's queue of five connections makes bursts of clients wait for a second.
  ::listen(socket, 512);
}

Listener::~Listener() = default;

std::uint16_t Listener::port() const { return state_->port; }

Listener::Load Listener::load() const {
  const Connections::Load load = state_->http.connections().load();
  return {.connections = load.open,
          .waiting = load.waiting,
          .answering = load.answering,
          .threads = load.threads,
          .streams = state_->streams,
          .received = load.received,
          .sent = load.sent};
}

void Listener::run() {
  if (!state_->stopping) state_->http.listen_after_bind();
  state_->finished = true;
}

void Listener::stop() {
  state_->stopping = true;
  // The library forgets a stop that comes before it listens.
  while (!state_->http.is_running() && !state_->finished) std::this_thread::sleep_for(std::chrono::milliseconds(1));
  state_->http.stop();
}

}  // namespace spherule::server
