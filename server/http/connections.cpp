// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/connections.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <poll.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <deque>
#include <list>
#include <mutex>
#include <system_error>
#include <thread>
#include <unordered_map>
#include <utility>
#include <vector>

namespace spherule::server {

using Clock = std::chrono::steady_clock;
using std::chrono::milliseconds;

namespace {

thread_local Connection* answering = nullptr;

// How often deadlines and a stop are looked for.
constexpr milliseconds kTick{500};
// What an answer that is being sent when the listener stops may still wait for its client.
constexpr milliseconds kFarewell{2000};
constexpr std::size_t kHeadBytes = 4096, kHeldBytes = 1 << 14, kReadBytes = 1 << 16;

// Where the head ends at the latest: the library goes by lines.
bool has_head(std::string_view in) { return in.find("\n\r\n") != in.npos || in.find("\n\n") != in.npos; }

}  // namespace

Connection* Connection::current() { return answering; }

bool Connection::is_gone() const {
  pollfd what{.fd = transport_->socket(), .events = POLLRDHUP, .revents = 0};
  return ::poll(&what, 1, 0) > 0;
}

void Connection::take_from_file(int file, std::uint64_t offset) {
  file_ = file;
  file_offset_ = offset;
}

Connection::Arrival Connection::receive(std::size_t head_bytes) {
  in_.erase(0, std::exchange(at_, 0));
  while (!has_head(in_)) {
    if (in_.size() > head_bytes) return Arrival::too_long;
    const std::size_t had = in_.size();
    in_.resize(had + kHeadBytes);
    const ssize_t n = transport_->read(in_.data() + had, kHeadBytes);
    in_.resize(had + (n > 0 ? static_cast<std::size_t>(n) : 0));
    if (n > 0) common_.received += static_cast<std::uint64_t>(n);
    if (n == 0 || n == Transport::broken) return Arrival::closed;
    if (n < 0) {
      wants_ = n;
      return Arrival::part;
    }
  }
  return Arrival::head;
}

bool Connection::wait(ssize_t want) {
  const bool reads = want == Transport::want_read;
  pollfd what{.fd = transport_->socket(), .events = static_cast<short>(reads ? POLLIN : POLLOUT), .revents = 0};
  const milliseconds longest = reads ? common_.limits.read : common_.limits.write;
  const milliseconds earned(moved_ * 1000 / common_.limits.slowest_bytes_per_second);
  const auto start = Clock::now();
  bool ready = false;
  while (!ready && !(reads && common_.stopping)) {
    const auto now = Clock::now();
    const auto patience = common_.stopping ? std::min(longest, kFarewell) : longest;
    if (now - start > patience || waited_ + (now - start) > longest + earned) return false;
    ready = ::poll(&what, 1, static_cast<int>(kTick.count())) > 0;
  }
  waited_ += Clock::now() - start;
  return ready;
}

ssize_t Connection::read(char* into, std::size_t size) {
  while (at_ == in_.size()) {
    in_.resize(kReadBytes);
    at_ = 0;
    const ssize_t n = transport_->read(in_.data(), in_.size());
    in_.resize(n > 0 ? static_cast<std::size_t>(n) : 0);
    if (n > 0) common_.received += static_cast<std::uint64_t>(n);
    if (n == 0) return 0;
    if (n < 0) {
      // An interim answer (100) goes out before we wait; the answer's own head is still to come.
      if (!held_.empty()) begun_ = false;
      if (n == Transport::broken || !flush() || !wait(n)) return -1;
    }
  }
  const std::size_t n = std::min(size, in_.size() - at_);
  in_.copy(into, n, at_);
  at_ += n;
  moved_ += n;
  return static_cast<ssize_t>(n);
}

ssize_t Connection::write(const char* from, std::size_t size) {
  const auto count = static_cast<ssize_t>(size);
  const int file = std::exchange(file_, -1);
  if (!std::exchange(begun_, true)) {
    held_.assign(from, size);
    return count;
  }
  if (!held_.empty() && file < 0) {
    const std::size_t with = std::min(size, kHeldBytes);
    held_.append(from, with);
    from += with;
    size -= with;
  }
  const bool sent =
      file < 0 ? flush() && send(from, size, false) : flush(size > 0) && send_file(file, file_offset_, size);
  return sent ? count : -1;
}

bool Connection::send(const char* from, std::size_t size, bool more) {
  return send_all(size, [&](std::size_t done) { return transport_->write(from + done, size - done, more); });
}

bool Connection::send_file(int file, std::uint64_t offset, std::size_t size) {
  return send_all(size, [&](std::size_t done) { return transport_->write_file(file, offset + done, size - done); });
}

template <typename Write>
bool Connection::send_all(std::size_t size, Write&& write) {
  for (std::size_t done = 0; done < size;) {
    const ssize_t n = write(done);
    if (n > 0) {
      done += static_cast<std::size_t>(n);
      moved_ += static_cast<std::uint64_t>(n);
      common_.sent += static_cast<std::uint64_t>(n);
    } else if (n == Transport::broken || !wait(n)) {
      return false;
    }
  }
  return true;
}

bool Connection::flush(bool more) {
  const std::string text = std::exchange(held_, {});
  return send(text.data(), text.size(), more);
}

void Connection::get_remote_ip_and_port(std::string& ip, int& port) const {
  sockaddr_storage storage{};
  socklen_t size = sizeof storage;
  if (::getpeername(transport_->socket(), reinterpret_cast<sockaddr*>(&storage), &size) != 0) return;
  std::array<char, INET6_ADDRSTRLEN> text{};
  if (storage.ss_family == AF_INET6) {
    const auto& address = reinterpret_cast<const sockaddr_in6&>(storage);
    ::inet_ntop(AF_INET6, &address.sin6_addr, text.data(), text.size());
    port = ntohs(address.sin6_port);
  } else if (storage.ss_family == AF_INET) {
    const auto& address = reinterpret_cast<const sockaddr_in&>(storage);
    ::inet_ntop(AF_INET, &address.sin_addr, text.data(), text.size());
    port = ntohs(address.sin_port);
  }
  ip = text.data();
}

struct Connections::State {
  using Id = std::uint64_t;
  // A connection that waits for a request, or for the rest of a head.
  struct Parked {
    std::unique_ptr<Connection> connection;
    bool arriving = false;  // which queue
    Clock::time_point deadline;
    std::list<Id>::iterator place;
  };

  Connection::Common common;
  const ConnectionLimits& limits = common.limits;
  std::atomic<bool>& stopping = common.stopping;
  Answer answer;
  Refusal refusal;
  const int epoll = ::epoll_create1(EPOLL_CLOEXEC);

  mutable std::mutex mutex;
  std::condition_variable work;
  std::unordered_map<Id, Parked> parked;
  std::list<Id> idle, arriving;  // by deadline
  std::deque<std::unique_ptr<Connection>> ready;
  std::size_t answering_now = 0, resting = 0;
  Id next_id = 1;
  std::vector<std::thread> workers;
  std::thread watcher;

  std::size_t open() const { return parked.size() + ready.size() + answering_now; }

  // With the mutex held.

  // Sockets stay in the epoll set until they are closed, silent but while their connection is parked.
  void park(std::unique_ptr<Connection> connection, bool is_arriving, Clock::time_point deadline) {
    const bool known = connection->id_ != 0;
    if (!known) connection->id_ = next_id++;
    const Id id = connection->id_;
    const int socket = connection->transport_->socket();
    const std::uint32_t direction = connection->wants_ == Transport::want_write ? EPOLLOUT : EPOLLIN;
    epoll_event event{.events = direction | EPOLLRDHUP | EPOLLONESHOT, .data = {.u64 = id}};
    auto& queue = is_arriving ? arriving : idle;
    auto place = queue.end();
    while (place != queue.begin() && parked[*std::prev(place)].deadline > deadline) --place;
    parked[id] = {std::move(connection), is_arriving, deadline, queue.insert(place, id)};
    if (::epoll_ctl(epoll, known ? EPOLL_CTL_MOD : EPOLL_CTL_ADD, socket, &event) != 0) take(id);
  }

  std::unique_ptr<Connection> take(Id id) {
    const auto found = parked.find(id);
    if (found == parked.end()) return nullptr;
    Parked entry = std::move(found->second);
    parked.erase(found);
    (entry.arriving ? arriving : idle).erase(entry.place);
    return std::move(entry.connection);
  }

  void make_ready(std::unique_ptr<Connection> connection) {
    ready.push_back(std::move(connection));
    if (resting < ready.size() && workers.size() < limits.threads) {
      try {
        workers.emplace_back([this] { serve(); });
      } catch (const std::system_error&) {
        // The machine has no more; those that are there go on.
      }
    }
    work.notify_one();
  }

  // Without it.

  void refuse(Connection& connection, int status) {
    // At once or not at all: nobody waits for who has been too slow.
    const std::string text = refusal(status);
    connection.transport_->write(text.data(), text.size(), false);
  }

  // The watcher's thread: something has arrived, or the peer has closed.
  void arrived(Id id) {
    std::unique_ptr<Connection> connection;
    bool was_arriving = false;
    Clock::time_point deadline;
    {
      const std::lock_guard lock(mutex);
      const auto found = parked.find(id);
      if (found == parked.end()) return;  // closed meanwhile
      was_arriving = found->second.arriving;
      deadline = found->second.deadline;
      connection = take(id);
    }
    switch (connection->receive(limits.head_bytes)) {
      case Connection::Arrival::closed: break;
      case Connection::Arrival::too_long: refuse(*connection, 431); break;
      case Connection::Arrival::head: {
        const std::lock_guard lock(mutex);
        make_ready(std::move(connection));
        break;
      }
      case Connection::Arrival::part: {
        // A head's time runs from its first byte.
        if (!was_arriving) deadline = Clock::now() + limits.head;
        const std::lock_guard lock(mutex);
        park(std::move(connection), true, deadline);
      }
    }
  }

  void close_late() {
    std::vector<std::unique_ptr<Connection>> late;
    {
      const std::lock_guard lock(mutex);
      const auto now = Clock::now();
      while (!idle.empty() && parked[idle.front()].deadline <= now) take(idle.front());
      while (!arriving.empty() && parked[arriving.front()].deadline <= now) late.push_back(take(arriving.front()));
    }
    for (const auto& connection : late) {
      if (!connection->in_.empty()) refuse(*connection, 408);
    }
  }

  void watch() {
    std::array<epoll_event, 64> events{};
    while (!stopping) {
      const int n = ::epoll_wait(epoll, events.data(), events.size(), static_cast<int>(kTick.count()));
      for (int i = 0; i < n; ++i) arrived(events[static_cast<std::size_t>(i)].data.u64);
      close_late();
    }
  }

  // A worker's thread.
  void serve() {
    std::unique_lock lock(mutex);
    for (;;) {
      ++resting;
      work.wait(lock, [&] { return !ready.empty() || stopping; });
      --resting;
      if (ready.empty()) return;
      std::unique_ptr<Connection> connection = std::move(ready.front());
      ready.pop_front();
      ++answering_now;
      lock.unlock();
      // What has come meanwhile must be looked for: TLS may have it already, so that the socket stays silent.
      const Connection::Arrival next =
          serve(*connection) && !stopping ? connection->receive(limits.head_bytes) : Connection::Arrival::closed;
      if (next == Connection::Arrival::too_long) refuse(*connection, 431);
      const bool goes_on = next == Connection::Arrival::head || next == Connection::Arrival::part;
      if (!goes_on) connection.reset();
      lock.lock();
      --answering_now;
      if (!goes_on || stopping) continue;
      if (next == Connection::Arrival::head) {
        make_ready(std::move(connection));
      } else {
        const bool begun = !connection->in_.empty();
        park(std::move(connection), begun, Clock::now() + (begun ? limits.head : limits.idle));
      }
    }
  }

  bool serve(Connection& connection) {
    connection.moved_ = 0;
    connection.waited_ = {};
    connection.begun_ = false;
    answering = &connection;
    const bool goes_on = answer(connection, stopping || ++connection.answered_ >= limits.requests);
    answering = nullptr;
    return connection.flush() && goes_on;
  }
};

Connections::Connections(const ConnectionLimits& limits, Answer answer, Refusal refusal)
    : state_(std::make_unique<State>()) {
  State& s = *state_;
  s.common.limits = limits;
  s.answer = std::move(answer);
  s.refusal = std::move(refusal);
  if (s.epoll < 0) throw std::system_error(errno, std::generic_category(), "epoll_create1");
  s.watcher = std::thread([&s] { s.watch(); });
}

Connections::~Connections() {
  stop();
  ::close(state_->epoll);
}

void Connections::add(std::unique_ptr<Transport> transport) {
  State& s = *state_;
  std::unique_ptr<Connection> closed;
  const std::lock_guard lock(s.mutex);
  if (s.stopping) return;
  if (s.open() >= s.limits.connections) {
    std::list<State::Id>& longest = s.idle.empty() ? s.arriving : s.idle;
    if (longest.empty()) return;  // all are being answered
    closed = s.take(longest.front());
  }
  // What says nothing at first has the time of a head.
  auto connection = std::make_unique<Connection>(std::move(transport), s.common);
  s.park(std::move(connection), true, Clock::now() + s.limits.head);
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
  return {s.open(), s.ready.size(), s.answering_now, s.workers.size(), s.common.received, s.common.sent};
}

}  // namespace spherule::server
