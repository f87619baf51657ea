// SPDX-License-Identifier: GPL-3.0-or-later
//
// The library leaves much to its user. What is done here and why (cpp-httplib 0.11.4):
// - Bodies are always taken through its ContentReader, counted and unpacked here: elsewhere it buffers them whole,
//   ignores its own limit for chunked ones, and takes a cut gzip stream for a complete one.
// - A request without Content-Length and chunking has no body; the library would wait for one.
// - A body that was not read to its end would be taken for the next request: the connection is closed then, which the
//   library does only when a content provider fails.
// - Ranges and content encodings are decided by api/ and here; the library's own are switched off by removing what it
//   goes by from the request. It reads past the end for ranges that lie outside, and compresses with Brotli's slowest
//   level.
#include "server/listener.h"

#include <httplib.h>
#include <sys/socket.h>
#include <zlib.h>

#include <algorithm>
#include <array>
#include <charconv>
#include <chrono>
#include <optional>

#include "api/problem.h"
#include "core/base/error.h"
#include "server/digest.h"

namespace spherule::server {

namespace {

using api::Request;
using api::Response;

// What an unread rest of a body may cost before the connection is closed instead.
constexpr std::uint64_t kDrainBytes = 1 << 20;
constexpr std::size_t kLongestPath = 1024;
constexpr std::size_t kPieceBytes = 1 << 18;
constexpr std::size_t kWorthCompressing = 1024;

// zlib's stream in gzip's framing, either way.
class Inflater {
 public:
  Inflater() {
    if (inflateInit2(&stream_, 16 + MAX_WBITS) != Z_OK) throw std::bad_alloc();
  }
  ~Inflater() { inflateEnd(&stream_); }
  Inflater(const Inflater&) = delete;
  Inflater& operator=(const Inflater&) = delete;

  // Members may follow one another.
  void feed(std::string_view bytes, const api::Body::Take& take) {
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    while (stream_.avail_in > 0) {
      if (ended_) inflateReset(&stream_);
      std::array<char, 1 << 14> out;
      int result = Z_OK;
      do {
        stream_.next_out = reinterpret_cast<Bytef*>(out.data());
        stream_.avail_out = out.size();
        result = inflate(&stream_, Z_NO_FLUSH);
        if (result != Z_OK && result != Z_STREAM_END && result != Z_BUF_ERROR) {
          throw Error(ErrorCode::malformed, "The body is not gzip although its Content-Encoding says so.");
        }
        if (const std::size_t n = out.size() - stream_.avail_out; n > 0) take({out.data(), n});
      } while (stream_.avail_out == 0 && result != Z_STREAM_END);
      ended_ = result == Z_STREAM_END;
    }
  }
  bool ended() const { return ended_; }

 private:
  z_stream stream_{};
  bool ended_ = false;
};

class Deflater {
 public:
  Deflater() {
    if (deflateInit2(&stream_, 5, Z_DEFLATED, 16 + MAX_WBITS, 8, Z_DEFAULT_STRATEGY) != Z_OK) throw std::bad_alloc();
  }
  ~Deflater() { deflateEnd(&stream_); }
  Deflater(const Deflater&) = delete;
  Deflater& operator=(const Deflater&) = delete;

  std::string feed(std::string_view bytes, bool last) {
    std::string packed;
    stream_.next_in = reinterpret_cast<Bytef*>(const_cast<char*>(bytes.data()));
    stream_.avail_in = static_cast<uInt>(bytes.size());
    do {
      std::array<char, 1 << 14> out;
      stream_.next_out = reinterpret_cast<Bytef*>(out.data());
      stream_.avail_out = out.size();
      deflate(&stream_, last ? Z_FINISH : Z_NO_FLUSH);
      packed.append(out.data(), out.size() - stream_.avail_out);
    } while (stream_.avail_out == 0);
    return packed;
  }

 private:
  z_stream stream_{};
};

// The body's length by its headers. Throws malformed where two readers could see two different bodies.
struct Framing {
  bool present = false;
  std::uint64_t announced = 0;  // 0: chunked
};
Framing framing(const httplib::Request& request) {
  const auto refuse = [] {
    return Error(ErrorCode::malformed, "Send one Content-Length, or Transfer-Encoding: chunked, and not both.");
  };
  const std::size_t lengths = request.get_header_value_count("Content-Length");
  if (request.has_header("Transfer-Encoding")) {
    std::string coding = request.get_header_value("Transfer-Encoding");
    std::ranges::transform(coding, coding.begin(), [](unsigned char c) { return std::tolower(c); });
    // The library does not read the chunked body of a DELETE.
    if (coding != "chunked" || lengths > 0 || request.get_header_value_count("Transfer-Encoding") > 1 ||
        request.method == "DELETE") {
      throw refuse();
    }
    return {true, 0};
  }
  if (lengths == 0) return {};
  const std::string text = request.get_header_value("Content-Length");
  std::uint64_t length = 0;
  const auto [end, error] = std::from_chars(text.data(), text.data() + text.size(), length);
  if (lengths > 1 || error != std::errc{} || end != text.data() + text.size()) throw refuse();
  return {length > 0, length};
}

class HttpBody final : public api::Body {
 public:
  HttpBody(httplib::Request& request, const httplib::ContentReader* reader, const std::atomic<bool>& stopping)
      : request_(request), reader_(reader), stopping_(stopping), framing_(framing(request)) {
    // The library goes by these two to decide how to read.
    encoding_ = request.get_header_value("Content-Encoding");
    type_ = request.get_header_value("Content-Type");
    request.headers.erase("Content-Encoding");
    request.headers.erase("Content-Type");
  }

  bool present() const override { return framing_.present; }
  std::uint64_t announced() const override { return framing_.announced; }
  // Whether the connection stands at the start of the next request.
  bool finished() const { return !framing_.present || finished_; }

  void read(std::uint64_t limit, const Take& take) override {
    begin(limit);
    Counted counted{limit, take};
    if (encoding_.empty() || encoding_ == "identity") {
      receive([&](std::string_view piece) { counted(piece); });
      return;
    }
    if (encoding_ != "gzip") {
      throw Error(ErrorCode::unknown_format, "Send the body as it is, or with Content-Encoding: gzip.");
    }
    Inflater inflater;
    Counted packed{limit, [&](std::string_view piece) {
                     inflater.feed(piece, [&](std::string_view unpacked) { counted(unpacked); });
                   }};
    receive([&](std::string_view piece) { packed(piece); });
    if (!inflater.ended()) throw Error(ErrorCode::malformed, "The gzip body is cut short; send it again whole.");
  }

  void read_parts(std::uint64_t limit, const BeginPart& begin_part, const Take& take) override {
    if (!encoding_.empty() && encoding_ != "identity") {
      throw Error(ErrorCode::unknown_format, "Send multipart bodies without Content-Encoding.");
    }
    begin(limit);
    request_.headers.emplace("Content-Type", plain_multipart(type_));
    Counted counted{limit, take};
    finished_ = (*reader_)(
        [&](const httplib::MultipartFormData& part) { return guarded([&] { begin_part(part.name, part.filename); }); },
        [&](const char* data, std::size_t size) { return guarded([&] {
                                                    counted({data, size});
                                                  }); });
    request_.headers.erase("Content-Type");
    conclude("The multipart body is cut short or malformed; send it again whole.");
  }

  // Reads on, for nothing, unless that is much.
  void drain() {
    if (finished() || begun_ || reader_ == nullptr || framing_.announced > kDrainBytes) return;
    std::uint64_t rest = kDrainBytes;
    begun_ = true;
    finished_ = (*reader_)([&](const char*, std::size_t size) {
      if (size > rest || stopping_) return false;
      rest -= size;
      return true;
    });
  }

 private:
  struct Counted {
    std::uint64_t left;
    const Take& take;
    void operator()(std::string_view piece) {
      if (piece.size() > left) {
        throw Error(ErrorCode::too_large, "The body is larger than this server accepts; send less.");
      }
      left -= piece.size();
      take(piece);
    }
  };

  void begin(std::uint64_t limit) {
    if (framing_.announced > limit) {
      throw Error(ErrorCode::too_large, "The body is larger than the " + std::to_string(limit) +
                                            " bytes that this server accepts; send less.");
    }
    begun_ = true;
  }

  void receive(const Take& take) {
    if (!framing_.present) return;
    finished_ = (*reader_)([&](const char* data, std::size_t size) { return guarded([&] { take({data, size}); }); });
    conclude("The body is cut short; send it again whole.");
  }

  template <typename F>
  bool guarded(F&& f) {
    try {
      if (stopping_) throw Error(ErrorCode::busy, "The server is stopping; try again later.");
      f();
      return true;
    } catch (...) {
      error_ = std::current_exception();
      return false;
    }
  }

  void conclude(const char* cut) {
    if (error_) std::rethrow_exception(std::exchange(error_, nullptr));
    if (!finished_) throw Error(ErrorCode::malformed, cut);
  }

  // The library takes everything after "boundary=" for the boundary.
  static std::string plain_multipart(const std::string& type) {
    std::string boundary;
    if (const std::size_t at = type.find("boundary="); at != std::string::npos) {
      boundary = type.substr(at + 9);
      const bool quoted = boundary.starts_with('"');
      boundary =
          quoted ? boundary.substr(1, boundary.find('"', 1) - 1) : boundary.substr(0, boundary.find_first_of("; "));
    }
    if (boundary.empty()) {
      throw Error(ErrorCode::malformed, "Give the boundary of the multipart body in its Content-Type.");
    }
    return "multipart/form-data; boundary=" + boundary;
  }

  httplib::Request& request_;
  const httplib::ContentReader* reader_;
  const std::atomic<bool>& stopping_;
  Framing framing_;
  std::string encoding_, type_;
  bool begun_ = false, finished_ = false;
  std::exception_ptr error_;
};

bool compressible(std::string_view type) {
  return (type.starts_with("text/") && !type.starts_with("text/event-stream")) || type.find("json") != type.npos ||
         type.find("yaml") != type.npos;
}

bool accepts_gzip(std::string_view accept_encoding) {
  const std::size_t at = accept_encoding.find("gzip");
  if (at == std::string_view::npos) return false;
  std::string_view parameters = accept_encoding.substr(at + 4);
  parameters = parameters.substr(0, parameters.find(','));
  const std::size_t q = parameters.find("q=");
  return q == std::string_view::npos || parameters.substr(q + 2).find_first_of("123456789") != std::string_view::npos;
}

// Entity tags differ between encodings; the tag of the compressed form is the plain one's with this before its end.
constexpr std::string_view kPackedTag = "-gzip\"";

std::string plain_tags(std::string tags) {
  for (std::size_t at; (at = tags.find(kPackedTag)) != std::string::npos;) tags.replace(at, kPackedTag.size(), "\"");
  return tags;
}

bool is_method(std::string_view method) {
  constexpr std::array<std::string_view, 7> methods = {"GET", "HEAD", "POST", "PUT", "PATCH", "DELETE", "OPTIONS"};
  return std::ranges::find(methods, method) != methods.end();
}

// Set when the connection is to be closed after an answer: what to do between the two.
using Close = std::function<void()>;

// Takes in what the client still sends, for a while: a socket closed with unread bytes makes the client's side drop the
// answer that says why.
Close lingering(const httplib::ContentReader* reader) {
  if (reader == nullptr) return [] {};
  return [reader = *reader] {
    const auto end = std::chrono::steady_clock::now() + std::chrono::seconds(2);
    try {
      reader([end](const char*, std::size_t) { return std::chrono::steady_clock::now() < end; });
    } catch (...) {
      // The connection is closed in any case.
    }
  };
}

// Our own mark on answers; the library's own have none.
constexpr const char* kOurs = "X-Request-Id";

}  // namespace

struct Listener::State {
  ListenerOptions options;
  Handler handler;
  AccessLog log;
  httplib::Server http;
  std::uint16_t port = 0;
  std::atomic<bool> stopping{false}, finished{false};
  std::atomic<std::size_t> streams{0};

  void serve(httplib::Request& request, httplib::Response& response, const httplib::ContentReader* reader);
  void send(Response&& answer, bool packed, const Close& close, httplib::Response& response);
  void send_own(const httplib::Request& request, Response&& problem, httplib::Response& response);
};

namespace {

// Writes text and, when the connection is to be closed, fails: then the library closes it.
void set_text(httplib::Response& response, std::string text, const std::string& type, const Close& close) {
  if (!close) {
    response.set_content(text, type);
    return;
  }
  const std::size_t size = text.size();
  response.set_content_provider(size, type,
                                [text = std::move(text), close](std::size_t, std::size_t, httplib::DataSink& sink) {
                                  sink.write(text.data(), text.size());
                                  close();
                                  return false;
                                });
}

// A content provider cannot throw. When it fails it is too late to say why: the connection is closed before the end
// that was announced, which tells the client.
template <typename F>
bool succeeds(F&& f) {
  try {
    return f();
  } catch (...) {
    return false;
  }
}

void set_part(httplib::Response& response, api::ContentPart&& given, const std::string& type) {
  const auto part = std::make_shared<const api::ContentPart>(std::move(given));
  response.set_content_provider(part->length, type,
                                [part](std::size_t offset, std::size_t length, httplib::DataSink& sink) {
                                  return succeeds([&] {
                                    std::string piece(std::min(length, kPieceBytes), '\0');
                                    const std::size_t n = part->content.read_at(part->offset + offset, piece);
                                    return n > 0 && sink.write(piece.data(), n);
                                  });
                                });
}

void set_packed_part(httplib::Response& response, api::ContentPart&& given, const std::string& type) {
  struct Stream {
    api::ContentPart part;
    Deflater deflater;
    std::uint64_t at = 0;
  };
  const auto stream = std::make_shared<Stream>();
  stream->part = std::move(given);
  response.set_chunked_content_provider(type, [stream](std::size_t, httplib::DataSink& sink) {
    return succeeds([&] {
      std::string piece(std::min<std::uint64_t>(kPieceBytes, stream->part.length - stream->at), '\0');
      const std::size_t n = stream->part.content.read_at(stream->part.offset + stream->at, piece);
      if (n == 0) return false;
      stream->at += n;
      const bool last = stream->at == stream->part.length;
      const std::string packed = stream->deflater.feed({piece.data(), n}, last);
      const bool good = packed.empty() || sink.write(packed.data(), packed.size());
      if (last) sink.done();
      return good;
    });
  });
}

}  // namespace

// Hands an answer to the library.
void Listener::State::send(Response&& answer, bool packed, const Close& close, httplib::Response& response) {
  response.status = answer.status;
  const std::string type(answer.header("Content-Type"));
  auto* part = std::get_if<api::ContentPart>(&answer.body);
  auto* text = std::get_if<std::string>(&answer.body);
  const bool whole = answer.status >= 200 && answer.status != 204 && answer.status != 206 && answer.status != 304;
  const bool packable = compressible(type) && whole && !close;
  packed = packed && packable &&
           ((text != nullptr && text->size() >= kWorthCompressing) ||
            (part != nullptr && part->length >= kWorthCompressing));
  for (auto& [name, value] : answer.headers) {
    if (name == "Content-Type") continue;
    if (packed && name == "ETag") value.insert(value.size() - 1, kPackedTag.substr(0, kPackedTag.size() - 1));
    if (packed && name == "Accept-Ranges") value = "none";
    response.set_header(name, value);
  }
  if (packed) response.set_header("Content-Encoding", "gzip");
  if (packable) response.set_header("Vary", "Accept-Encoding");
  if (answer.header("Accept-Ranges").empty()) response.set_header("Accept-Ranges", "none");
  if (close) response.set_header("Connection", "close");

  if (auto* source = std::get_if<api::EventSource>(&answer.body)) {
    response.set_chunked_content_provider(
        type,
        [this, next = std::move(*source)](std::size_t, httplib::DataSink& sink) {
          return succeeds([&] {
            std::string piece;
            const bool more = !stopping && next(piece);
            const bool good = piece.empty() || sink.write(piece.data(), piece.size());
            if (!more) sink.done();
            return good;
          });
        },
        [this](bool) { --streams; });
  } else if (part != nullptr && part->length > 0) {
    packed ? set_packed_part(response, std::move(*part), type) : set_part(response, std::move(*part), type);
  } else if (text != nullptr && !text->empty()) {
    set_text(response, packed ? Deflater().feed(*text, true) : std::move(*text), type, close);
  } else if (!type.empty()) {
    response.set_header("Content-Type", type);
  }
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
    asked.headers.emplace_back(name, name == "If-None-Match" ? plain_tags(value) : value);
  }
  const bool packed = accepts_gzip(request.get_header_value("Accept-Encoding"));
  request.ranges.clear();
  request.headers.erase("Accept-Encoding");

  Response answer;
  Close close;
  try {
    HttpBody body(request, reader, stopping);
    if (reader == nullptr && body.present()) {
      // Without a reader there is no way past the body but to close; and no answer to HEAD closes.
      if (request.method == "HEAD") request.method = "GET";
      throw Error(ErrorCode::invalid_argument, "Send no body with this method.");
    }
    asked.body = &body;
    // What is deleted cannot be told with the text that closes a connection; so the body goes first.
    if (request.method == "DELETE") body.drain();
    if (request.method == "DELETE" && !body.finished()) {
      throw Error(ErrorCode::invalid_argument, "Send no body with this method.");
    }
    answer = handler(asked);
    body.drain();
    if (!body.finished()) close = lingering(reader);
  } catch (const Error& error) {
    close = [] {};
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
         seconds.count()});
  }
  send(std::move(answer), packed, close, response);
}

// What the library refuses by itself: requests that it cannot parse.
void Listener::State::send_own(const httplib::Request& request, Response&& problem, httplib::Response& response) {
  const std::string id(problem.header(kOurs));
  if (log) log({id, is_method(request.method) ? request.method : "?", {}, problem.status, 0});
  response.headers.clear();
  response.body.clear();
  send(
      std::move(problem), false, [] {}, response);
}

Listener::Listener(ListenerOptions options, Handler handler, AccessLog log) : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.options = std::move(options);
  s.handler = std::move(handler);
  s.log = std::move(log);
  const std::size_t threads = s.options.max_requests + s.options.max_streams;
  s.http.new_task_queue = [threads] { return new httplib::ThreadPool(threads); };
  s.http.set_read_timeout(static_cast<time_t>(s.options.read_timeout_s));
  s.http.set_write_timeout(static_cast<time_t>(s.options.write_timeout_s));
  s.http.set_keep_alive_timeout(static_cast<time_t>(s.options.keep_alive_timeout_s));
  s.http.set_keep_alive_max_count(1000);
  s.http.set_tcp_nodelay(true);

  const auto refuse = [&s](const httplib::Request& request, httplib::Response& response, int status) {
    const std::string id = random_id("req");
    Response problem = api::problem(status, id);
    problem.set(kOurs, id);
    if (status == 405) problem.set("Allow", "GET, HEAD, POST, DELETE, OPTIONS");
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
