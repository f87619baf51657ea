// SPDX-License-Identifier: GPL-3.0-or-later
#include "tests/sockets.h"

#include <arpa/inet.h>
#include <poll.h>
#include <sys/resource.h>
#include <sys/socket.h>
#include <unistd.h>

#include <array>
#include <cerrno>
#include <utility>

namespace spherule::test {

using Clock = std::chrono::steady_clock;

Socket::Socket(int port, int receive_buffer) : socket_(::socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0)) {
  if (receive_buffer > 0) ::setsockopt(socket_, SOL_SOCKET, SO_RCVBUF, &receive_buffer, sizeof receive_buffer);
  sockaddr_in address{};
  address.sin_family = AF_INET;
  address.sin_port = htons(static_cast<std::uint16_t>(port));
  address.sin_addr.s_addr = htonl(INADDR_LOOPBACK);
  if (::connect(socket_, reinterpret_cast<const sockaddr*>(&address), sizeof address) != 0) {
    ::close(std::exchange(socket_, -1));
  }
}

Socket::Socket(Socket&& other) noexcept : socket_(std::exchange(other.socket_, -1)) {}

Socket::~Socket() {
  if (socket_ >= 0) ::close(socket_);
}

bool Socket::send(std::string_view text) const {
  while (!text.empty()) {
    const ssize_t n = ::send(socket_, text.data(), text.size(), MSG_NOSIGNAL);
    if (n <= 0) return false;
    text.remove_prefix(static_cast<std::size_t>(n));
  }
  return true;
}

bool Socket::try_send(std::string_view text) const {
  return ::send(socket_, text.data(), text.size(), MSG_NOSIGNAL | MSG_DONTWAIT) >= 0 || errno == EAGAIN;
}

std::string Socket::receive(std::string_view end, std::chrono::milliseconds patience) const {
  std::string text;
  const auto last = Clock::now() + patience;
  while (text.find(end) == std::string::npos) {
    pollfd what{.fd = socket_, .events = POLLIN, .revents = 0};
    const auto left = std::chrono::ceil<std::chrono::milliseconds>(last - Clock::now()).count();
    if (left <= 0 || ::poll(&what, 1, static_cast<int>(left)) <= 0) break;
    std::array<char, 4096> piece{};
    const ssize_t n = ::recv(socket_, piece.data(), piece.size(), 0);
    if (n <= 0) return text + "<closed>";
    text.append(piece.data(), static_cast<std::size_t>(n));
  }
  return text;
}

bool Socket::closed_within(std::chrono::milliseconds patience) const {
  return receive("<never>", patience).find("<closed>") != std::string::npos;
}

namespace {

rlimit limit() {
  rlimit now{};
  ::getrlimit(RLIMIT_NOFILE, &now);
  return now;
}

void set(std::size_t soft) {
  rlimit wanted = limit();
  wanted.rlim_cur = soft < wanted.rlim_max ? soft : wanted.rlim_max;
  ::setrlimit(RLIMIT_NOFILE, &wanted);
}

}  // namespace

Descriptors::Descriptors(std::size_t inherited) : before_(limit().rlim_cur) { set(inherited); }
Descriptors::~Descriptors() { set(before_); }
void Descriptors::raise() const { set(limit().rlim_max); }

}  // namespace spherule::test
