// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/connections.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <deque>
#include <mutex>
#include <set>
#include <system_error>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

#include "core/base/error.h"

namespace spherule::server {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

namespace {

// How often deadlines and a stop are looked for; and whether others wait for threads.
constexpr milliseconds kTick{500}, kShortTick{100};
// What an answer that is being sent when the listener stops may still wait for its client.
constexpr milliseconds kFarewell{2000};
// Less than a second, in which everybody shall be answered, with the tick in between.
constexpr std::int64_t kPatienceMs = 250;
constexpr std::size_t kHeadBytes = 4096, kAheadBytes = 8192, kHeldBytes = 1 << 14, kReadBytes = 1 << 16;
// What an unread rest of a body may cost before the connection is closed instead.
constexpr std::uint64_t kDropBytes = 1 << 20;
constexpr std::size_t kHealthThreads = 2;

constexpr std::string_view kCut = "The body is cut short; send it again whole.";
constexpr std::string_view kBad = "The chunks of the body are malformed; send it again.";
constexpr HeadRefusal kLate{408, "Send the whole request without pauses."};

std::int64_t now_ms() { return std::chrono::duration_cast<milliseconds>(Clock::now().time_since_epoch()).count(); }

// Who is counted as one client: an IPv4 address, or the 64 bits of a network of IPv6. Empty for this machine, on which
// a proxy may stand for many, and for what has no address.
std::string address_of(int socket) {
  sockaddr_storage storage{};
  socklen_t size = sizeof storage;
  if (::getpeername(socket, reinterpret_cast<sockaddr*>(&storage), &size) != 0) return {};
  const auto four = [](const in_addr& address) {
    const auto* bytes = reinterpret_cast<const char*>(&address);
    return bytes[0] == 127 ? std::string() : std::string(bytes, sizeof address);
  };
  if (storage.ss_family == AF_INET) return four(reinterpret_cast<const sockaddr_in&>(storage).sin_addr);
  if (storage.ss_family != AF_INET6) return {};
  const in6_addr& six = reinterpret_cast<const sockaddr_in6&>(storage).sin6_addr;
  if (IN6_IS_ADDR_LOOPBACK(&six)) return {};
  const auto* bytes = reinterpret_cast<const char*>(&six);
  if (!IN6_IS_ADDR_V4MAPPED(&six)) return {bytes, 8};
  in_addr mapped{};
  std::copy(bytes + 12, bytes + 16, reinterpret_cast<char*>(&mapped));
  return four(mapped);
}

}  // namespace

struct Connection::Common {
  explicit Common(const ConnectionLimits& given) : limits(given) {}

  const ConnectionLimits limits;
  std::atomic<bool> stopping{false};
  std::atomic<std::uint64_t> received{0}, sent{0};  // bytes

  void enter(const std::string& address) {
    const std::lock_guard lock(mutex);
    ++of_address[address];
  }
  void leave(const std::string& address) {
    const std::lock_guard lock(mutex);
    if (--of_address[address] == 0) of_address.erase(address);
  }
  bool too_many(const std::string& address) {
    const std::lock_guard lock(mutex);
    return !address.empty() && of_address[address] > limits.of_one_address;
  }

 private:
  std::mutex mutex;
  std::unordered_map<std::string, std::size_t> of_address;
};

Connection::Connection(std::unique_ptr<Transport> transport, std::shared_ptr<Common> common)
    : transport_(std::move(transport)),
      common_(std::move(common)),
      address_(address_of(transport_->socket())),
      reader_(common_->limits.head_size) {
  common_->enter(address_);
}

Connection::~Connection() { common_->leave(address_); }

ssize_t Connection::fetch(std::size_t most) {
  in_.resize(most);
  at_ = 0;
  const ssize_t n = transport_->read(in_.data(), in_.size());
  in_.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
  if (n > 0) {
    moved_ += static_cast<std::uint64_t>(n);
    common_->received += static_cast<std::uint64_t>(n);
  } else if (n < 0) {
    wants_ = n;
  }
  return n;
}

Connection::Arrival Connection::receive_head() {
  for (;;) {
    at_ += reader_.feed(std::string_view(in_).substr(at_));
    if (reader_.refusal()) return Arrival::refused;
    if (reader_.complete()) {
      begin_request();
      return Arrival::whole;
    }
    const ssize_t n = fetch(kHeadBytes);
    if (n == 0 || n == Transport::broken) return Arrival::closed;
    if (n < 0) return Arrival::part;
  }
}

void Connection::begin_request() {
  head_ = reader_.take();
  framing_ = BodyFraming(head_);
  body_.clear();
  fault_ = {};
  most_ahead_ = common_->limits.body_bytes;
  invited_ = false;
  last_ = ++answered_ >= common_->limits.requests || !head_.persistent || common_->stopping;
  moved_ = settled_ = 0;
  waited_ms_ = lag_before_ms_ = 0;
  decode_body();
}

void Connection::decode_body() {
  while (at_ < in_.size() && body_.size() < most_ahead_) {
    const BodyFraming::Step step = framing_.next(std::string_view(in_).substr(at_));
    at_ += step.taken;
    body_ += step.content;
    if (step.taken == 0) break;
  }
  if (framing_.bad()) fault_ = kBad;
}

// What the last request has left behind.
void Connection::forget() {
  for (std::string* text : {&in_, &body_, &piece_, &held_}) std::string().swap(*text);
  at_ = 0;
}

bool Connection::is_gone() const {
  pollfd what{.fd = transport_->socket(), .events = POLLRDHUP, .revents = 0};
  return ::poll(&what, 1, 0) > 0;
}

Connection::Arrival Connection::receive_body() {
  for (;;) {
    decode_body();
    if (body_arrived()) return Arrival::whole;
    const ssize_t n = fetch(kAheadBytes);
    if (n == Transport::broken) return Arrival::closed;
    if (n == 0) fault_ = kCut;
    if (n < 0) return Arrival::part;
  }
}

// What is left of a body, or all that comes. Not for ever, since others wait for this thread.
Connection::Arrival Connection::receive_for_nothing(bool body) {
  for (std::uint64_t taken = 0; taken < kDropBytes;) {
    body_.clear();
    if (body) decode_body();
    if (body && framing_.finished()) return Arrival::whole;
    if (body && framing_.bad()) return Arrival::closed;
    if (body && at_ < in_.size()) continue;
    const ssize_t n = fetch(kReadBytes);
    if (n == 0 || n == Transport::broken) return Arrival::closed;
    if (n < 0) return Arrival::part;
    taken += static_cast<std::uint64_t>(n);
  }
  return Arrival::part;
}

bool Connection::drop_body() {
  do {
    body_.clear();
    decode_body();
  } while (!body_.empty());
  if (framing_.finished()) return true;
  // Who has not been asked for the body may not send it.
  const bool comes = !head_.expects_continue || invited_;
  return comes && fault_.empty() && !head_.chunked && head_.length <= kDropBytes;
}

void Connection::invite() {
  if (!head_.expects_continue || std::exchange(invited_, true)) return;
  send("HTTP/1.1 100 Continue\r\n\r\n", false);
}

std::string_view Connection::read_body() {
  piece_.clear();
  while (body_.empty()) {
    if (common_->stopping) throw Error(ErrorCode::busy, "The server is stopping; try again later.");
    decode_body();
    if (!body_.empty() || framing_.finished()) break;
    if (!fault_.empty()) throw Error(ErrorCode::malformed, std::string(fault_));
    const ssize_t n = fetch(kReadBytes);
    if (n == 0 || n == Transport::broken || (n < 0 && !wait(n))) fault_ = kCut;
  }
  piece_.swap(body_);
  return piece_;
}

bool Connection::wait(ssize_t want) {
  const bool reads = want == Transport::want_read;
  pollfd what{.fd = transport_->socket(), .events = static_cast<short>(reads ? POLLIN : POLLOUT), .revents = 0};
  const ConnectionLimits& limits = common_->limits;
  const std::int64_t longest = (reads ? limits.read : limits.write).count();
  const auto earned = static_cast<std::int64_t>(moved_ * 1000 / limits.slowest_bytes_per_second);
  const auto fair = static_cast<std::int64_t>((moved_ - settled_) * 1000 / limits.fair_bytes_per_second);
  settled_ = moved_;
  lag_before_ms_ = std::max<std::int64_t>(0, lag_before_ms_ - fair);
  const std::int64_t start = now_ms();
  waits_since_ms_ = start;
  bool ready = false;
  while (!ready && !cut_off_ && !(reads && common_->stopping)) {
    const std::int64_t waited = now_ms() - start;
    const std::int64_t patience = common_->stopping ? std::min<std::int64_t>(longest, kFarewell.count()) : longest;
    if (waited > patience || waited_ms_ + waited > longest + earned) break;
    ready = ::poll(&what, 1, static_cast<int>(kTick.count())) > 0;
  }
  waits_since_ms_ = 0;
  const std::int64_t waited = now_ms() - start;
  waited_ms_ += waited;
  lag_before_ms_ += waited;
  return ready && !cut_off_;
}

std::int64_t Connection::lag_ms() const {
  const std::int64_t since = waits_since_ms_;
  return since == 0 || cut_off_ ? -1 : lag_before_ms_ + now_ms() - since;
}

void Connection::cut_off() {
  cut_off_ = true;
  ::shutdown(transport_->socket(), SHUT_RDWR);
}

void Connection::hold(std::string_view text) { held_ += text; }

bool Connection::write(std::string_view text) {
  const std::size_t with = held_.empty() ? 0 : std::min(text.size(), kHeldBytes);
  held_.append(text.substr(0, with));
  return flush() && send(text.substr(with), false);
}

bool Connection::write_file(int file, std::uint64_t offset, std::size_t size) {
  return flush(size > 0) &&
         send_all(size, [&](std::size_t done) { return transport_->write_file(file, offset + done, size - done); });
}

bool Connection::send(std::string_view text, bool more) {
  return send_all(text.size(),
                  [&](std::size_t done) { return transport_->write(text.data() + done, text.size() - done, more); });
}

template <typename Write>
bool Connection::send_all(std::size_t size, Write&& write) {
  for (std::size_t done = 0; done < size;) {
    const ssize_t n = write(done);
    if (n > 0) {
      done += static_cast<std::size_t>(n);
      moved_ += static_cast<std::uint64_t>(n);
      common_->sent += static_cast<std::uint64_t>(n);
    } else if (n == Transport::broken || n == 0 || !wait(n)) {
      return false;
    }
  }
  return true;
}

bool Connection::flush(bool more) { return send(std::exchange(held_, {}), more); }

struct Connections::State {
  using Id = std::uint64_t;
  static constexpr Id kListening = 0;
  enum class Phase { idle, head, body, drop, linger };
  // A connection that waits for its client.
  struct Parked {
    std::unique_ptr<Connection> connection;
    Phase phase = Phase::idle;
    Clock::time_point deadline, since;
  };
  using Queue = std::set<std::pair<Clock::time_point, Id>>;

  State(const ConnectionLimits& given, Calls given_calls)
      : common(std::make_shared<Connection::Common>(given)), calls(std::move(given_calls)) {}

  const std::shared_ptr<Connection::Common> common;
  const ConnectionLimits& limits = common->limits;
  std::atomic<bool>& stopping = common->stopping;
  const Calls calls;
  const int epoll = ::epoll_create1(EPOLL_CLOEXEC);
  // Set once, before the watcher is told of it.
  int listening = -1;
  MakeTransport make;

  mutable std::mutex mutex;
  std::condition_variable work;
  std::unordered_map<Id, Parked> parked;
  Queue idle, arriving;  // by deadline; the second of all that are not idle
  // Requests that wait for a thread: about the server's health, whole ones, and those whose body is still coming.
  using Waiting = std::deque<std::unique_ptr<Connection>>;
  Waiting urgent, whole, partial;
  std::set<Connection*> answered;  // now
  std::size_t ordinary = 0, resting = 0;
  bool grows = true, deaf = false;
  Id next_id = kListening + 1;
  std::vector<std::thread> workers;
  std::thread watcher;

  std::size_t waiting() const { return urgent.size() + whole.size() + partial.size(); }
  std::size_t open() const { return parked.size() + waiting() + answered.size(); }

  // With the mutex held.

  Queue& queue_of(Phase phase) { return phase == Phase::idle ? idle : arriving; }

  // Sockets stay in the epoll set until they are closed, silent but while their connection is parked.
  void park(std::unique_ptr<Connection> connection, Phase phase, Clock::time_point deadline) {
    if (stopping) return;
    const bool known = connection->id_ != 0;
    if (!known) connection->id_ = next_id++;
    const Id id = connection->id_;
    const int socket = connection->transport_->socket();
    const std::uint32_t direction = connection->wants_ == Transport::want_write ? EPOLLOUT : EPOLLIN;
    epoll_event event{.events = direction | EPOLLRDHUP | EPOLLONESHOT, .data = {.u64 = id}};
    queue_of(phase).emplace(deadline, id);
    parked[id] = {std::move(connection), phase, deadline, Clock::now()};
    if (::epoll_ctl(epoll, known ? EPOLL_CTL_MOD : EPOLL_CTL_ADD, socket, &event) != 0) take(id);
  }

  Parked take(Id id) {
    const auto found = parked.find(id);
    if (found == parked.end()) return {};
    Parked entry = std::move(found->second);
    parked.erase(found);
    queue_of(entry.phase).erase({entry.deadline, id});
    return entry;
  }

  // The one that has been idle longest, or else that has not sent a request for longest; of this address, unless that
  // is empty.
  std::unique_ptr<Connection> take_oldest(const std::string& address) {
    for (const Queue* queue : {&idle, &arriving}) {
      const auto found = std::ranges::find_if(*queue, [&](const auto& entry) {
        return address.empty() || parked.at(entry.second).connection->address_ == address;
      });
      if (found != queue->end()) return std::move(take(found->second).connection);
    }
    return nullptr;
  }

  // What a thread is to take up next; null when there is nothing for it.
  Waiting* next_queue() {
    if (!urgent.empty()) return &urgent;
    if (ordinary >= limits.threads) return nullptr;
    return !whole.empty() ? &whole : !partial.empty() ? &partial : nullptr;
  }
  bool full() const { return !grows || workers.size() >= limits.threads + (urgent.empty() ? 0 : kHealthThreads); }

  void make_ready(std::unique_ptr<Connection> connection) {
    if (stopping) return;
    const bool health = calls.is_health(connection->head_) && !connection->head_.has_body();
    Waiting& queue = health ? urgent : connection->framing_.finished() ? whole : partial;
    queue.push_back(std::move(connection));
    if (resting < waiting() && !full()) {
      try {
        workers.emplace_back([this] { work_on(); });
      } catch (const std::system_error&) {
        grows = false;  // the machine has no more; those that are there go on
      }
    }
    work.notify_one();
  }

  // Others wait for threads: the clients that have kept theirs waiting longest make way.
  void make_room() {
    const bool none_rests = resting == 0 && full();
    std::size_t stuck = none_rests ? urgent.size() : 0;
    if (none_rests || ordinary >= limits.threads) stuck += whole.size() + partial.size();
    for (; stuck > 0; --stuck) {
      const auto slowest = std::ranges::max_element(answered, {}, [](const Connection* c) { return c->lag_ms(); });
      if (slowest == answered.end() || (*slowest)->lag_ms() < kPatienceMs) return;
      (*slowest)->cut_off();
    }
  }

  // Without it.

  Clock::time_point deadline_of_body(const Connection& connection) const {
    // The next piece must come in time, and so must all.
    const milliseconds left = limits.read + milliseconds(connection.moved_ * 1000 / limits.slowest_bytes_per_second) -
                              milliseconds(connection.waited_ms_);
    return Clock::now() + std::clamp(left, milliseconds(0), limits.read);
  }

  // Says why and closes.
  void refuse(std::unique_ptr<Connection> connection, const HeadRefusal& why) {
    // At once or not at all: nobody waits for who has been too slow.
    const std::string text = calls.refusal(why);
    connection->transport_->write(text.data(), text.size(), false);
    close_gently(std::move(connection));
  }

  void close_gently(std::unique_ptr<Connection> connection) {
    connection->transport_->end_writing();
    connection->wants_ = Transport::want_read;
    const std::lock_guard lock(mutex);
    park(std::move(connection), Phase::linger, Clock::now() + limits.linger);
  }

  // Looks at what has come, and parks the connection until more does.
  void go_on(std::unique_ptr<Connection> connection, Phase phase, Clock::time_point deadline) {
    Connection& c = *connection;
    using Arrival = Connection::Arrival;
    if (phase == Phase::drop) {
      switch (c.receive_for_nothing(true)) {
        case Arrival::whole: phase = Phase::idle; break;
        case Arrival::part: {
          deadline = deadline_of_body(c);
          const std::lock_guard lock(mutex);
          return park(std::move(connection), Phase::drop, deadline);
        }
        default: return;
      }
    }
    if (phase == Phase::linger) {
      if (c.receive_for_nothing(false) != Arrival::part) return;
      const std::lock_guard lock(mutex);
      return park(std::move(connection), Phase::linger, deadline);
    }
    const Arrival arrival = phase == Phase::body ? c.receive_body() : c.receive_head();
    switch (arrival) {
      case Arrival::closed: return;
      case Arrival::refused: return refuse(std::move(connection), *c.reader_.refusal());
      case Arrival::whole: {
        const std::lock_guard lock(mutex);
        return make_ready(std::move(connection));
      }
      case Arrival::part: break;
    }
    if (phase == Phase::body) {
      deadline = deadline_of_body(c);
    } else if (phase == Phase::idle) {
      // A head's time runs from its first byte.
      phase = c.reader_.begun() ? Phase::head : Phase::idle;
      c.forget();
      deadline = Clock::now() + (phase == Phase::head ? limits.head : limits.idle);
    }
    const std::lock_guard lock(mutex);
    park(std::move(connection), phase, deadline);
  }

  // The watcher's thread.

  // Something has arrived, or the peer has closed.
  void arrived(Id id) {
    Parked entry;
    {
      const std::lock_guard lock(mutex);
      entry = take(id);
    }
    if (!entry.connection) return;
    entry.connection->waited_ms_ += std::chrono::duration_cast<milliseconds>(Clock::now() - entry.since).count();
    go_on(std::move(entry.connection), entry.phase, entry.deadline);
  }

  void close_late() {
    std::vector<Parked> late;
    {
      const std::lock_guard lock(mutex);
      for (const Queue* queue : {&idle, &arriving}) {
        while (!queue->empty() && queue->begin()->first <= Clock::now()) late.push_back(take(queue->begin()->second));
      }
    }
    for (Parked& entry : late) {
      const bool said = entry.phase == Phase::body || (entry.phase == Phase::head && entry.connection->reader_.begun());
      if (said) refuse(std::move(entry.connection), kLate);
    }
  }

  void add(std::unique_ptr<Transport> transport) {
    std::unique_ptr<Connection> closed, other;
    auto connection = std::make_unique<Connection>(std::move(transport), common);
    const std::lock_guard lock(mutex);
    if (common->too_many(connection->address_)) {
      closed = take_oldest(connection->address_);
      if (!closed) return;
    }
    if (open() >= limits.connections) {
      other = take_oldest({});
      if (!other) return;  // all are being answered
    }
    // What says nothing at first has the time of a head.
    park(std::move(connection), Phase::head, Clock::now() + limits.head);
  }

  void accept() {
    deaf = true;
    for (int i = 0; i < 64; ++i) {
      const int socket = ::accept4(listening, nullptr, nullptr, SOCK_CLOEXEC | SOCK_NONBLOCK);
      if (socket >= 0) {
        const int yes = 1;
        ::setsockopt(socket, IPPROTO_TCP, TCP_NODELAY, &yes, sizeof yes);
        add(make(socket));
        continue;
      }
      if (errno == EAGAIN || errno == EWOULDBLOCK) break;
      if (errno == EINTR || errno == ECONNABORTED || errno == EPROTO) continue;
      if (errno != EMFILE && errno != ENFILE && errno != ENOBUFS && errno != ENOMEM) return;
      // Descriptors or memory are short: who is idle makes way. Else the newcomers wait in the kernel until the next
      // tick.
      std::unique_ptr<Connection> closed;
      const std::lock_guard lock(mutex);
      closed = take_oldest({});
      if (!closed) return;
    }
    deaf = false;
    epoll_event event{.events = EPOLLIN | EPOLLONESHOT, .data = {.u64 = kListening}};
    ::epoll_ctl(epoll, EPOLL_CTL_MOD, listening, &event);
  }

  void watch() {
    std::array<epoll_event, 64> events{};
    bool short_of_threads = false;
    while (!stopping) {
      const milliseconds tick = short_of_threads || deaf ? kShortTick : kTick;
      const int n = ::epoll_wait(epoll, events.data(), events.size(), static_cast<int>(tick.count()));
      try {
        for (int i = 0; i < n; ++i) {
          const Id id = events[static_cast<std::size_t>(i)].data.u64;
          id == kListening ? accept() : arrived(id);
        }
        if (deaf) accept();
        close_late();
      } catch (const std::bad_alloc&) {
        // The connection is gone; the others go on.
      }
      const std::lock_guard lock(mutex);
      short_of_threads = waiting() > 0;
      if (short_of_threads) make_room();
    }
  }

  // A worker's thread.

  void work_on() {
    std::unique_lock lock(mutex);
    for (;;) {
      ++resting;
      work.wait(lock, [&] { return next_queue() != nullptr || (stopping && waiting() == 0); });
      --resting;
      Waiting* const queue = next_queue();
      if (queue == nullptr) {
        // Others may have waited for what this one was the last to take up.
        work.notify_all();
        return;
      }
      const bool health = queue == &urgent;
      std::unique_ptr<Connection> connection = std::move(queue->front());
      queue->pop_front();
      if (!health) ++ordinary;
      Connection* const current = connection.get();
      answered.insert(current);
      lock.unlock();
      const Next next = answer(*connection);
      lock.lock();
      answered.erase(current);
      if (!health) --ordinary;
      lock.unlock();
      try {
        if (next == Next::close) {
          close_gently(std::move(connection));
        } else if (next != Next::broken) {
          // What has come meanwhile must be looked for: TLS may have it already, so that the socket stays silent.
          go_on(std::move(connection), next == Next::body ? Phase::body : Phase::drop, {});
        }
      } catch (const std::bad_alloc&) {
        // The connection is gone; the others go on.
      }
      connection.reset();
      lock.lock();
    }
  }

  Next answer(Connection& connection) {
    try {
      const Next next = calls.answer(connection);
      return connection.flush() && !connection.cut_off_ ? next : Next::broken;
    } catch (...) {
      return Next::broken;  // short of memory, for one; the other connections go on
    }
  }
};

Connections::Connections(const ConnectionLimits& limits, Calls calls)
    : state_(std::make_unique<State>(limits, std::move(calls))) {
  State& s = *state_;
  if (s.epoll < 0) throw std::system_error(errno, std::generic_category(), "epoll_create1");
  s.watcher = std::thread([&s] { s.watch(); });
}

Connections::~Connections() {
  stop();
  ::close(state_->epoll);
}

void Connections::accept_from(int socket, MakeTransport make) {
  State& s = *state_;
  const std::lock_guard lock(s.mutex);
  s.listening = socket;
  s.make = std::move(make);
  epoll_event event{.events = EPOLLIN | EPOLLONESHOT, .data = {.u64 = State::kListening}};
  if (::epoll_ctl(s.epoll, EPOLL_CTL_ADD, socket, &event) != 0) {
    throw std::system_error(errno, std::generic_category(), "epoll_ctl");
  }
}

void Connections::stop() {
  State& s = *state_;
  {
    const std::lock_guard lock(s.mutex);
    s.stopping = true;
  }
  s.work.notify_all();
  if (s.watcher.joinable()) s.watcher.join();
  std::vector<std::thread> workers;
  {
    const std::lock_guard lock(s.mutex);
    workers.swap(s.workers);
    s.parked.clear();
    s.idle.clear();
    s.arriving.clear();
  }
  for (std::thread& worker : workers) worker.join();
}

Connections::Load Connections::load() const {
  const State& s = *state_;
  const std::lock_guard lock(s.mutex);
  return {.open = s.open(),
          .waiting = s.waiting(),
          .answering = s.answered.size(),
          .threads = s.workers.size(),
          .received = s.common->received,
          .sent = s.common->sent};
}

}  // namespace spherule::server
