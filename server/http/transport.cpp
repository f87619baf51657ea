// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/transport.h"

#include <fcntl.h>
#include <sys/sendfile.h>
#include <sys/socket.h>
#include <unistd.h>

#include <algorithm>
#include <cerrno>
#include <vector>

namespace spherule::server {

namespace {

class PlainTransport final : public Transport {
 public:
  explicit PlainTransport(int socket) : socket_(socket) {
    // sendfile has no flag of its own for this.
    ::fcntl(socket_, F_SETFL, ::fcntl(socket_, F_GETFL) | O_NONBLOCK);
  }
  ~PlainTransport() override {
    ::shutdown(socket_, SHUT_RDWR);
    ::close(socket_);
  }
  int socket() const override { return socket_; }
  ssize_t read(char* into, std::size_t size) override {
    return result([&] { return ::recv(socket_, into, size, 0); }, want_read);
  }
  ssize_t write(const char* from, std::size_t size, bool more) override {
    return result([&] { return ::send(socket_, from, size, MSG_NOSIGNAL | (more ? MSG_MORE : 0)); }, want_write);
  }
  ssize_t write_file(int file, std::uint64_t offset, std::size_t size) override {
    auto at = static_cast<off_t>(offset);
    const ssize_t n = result([&] { return ::sendfile(socket_, file, &at, size); }, want_write);
    return n == 0 ? broken : n;  // the file ends early
  }

 private:
  template <typename F>
  static ssize_t result(F&& call, ssize_t would_block) {
    for (;;) {
      const ssize_t n = call();
      if (n >= 0) return n;
      if (errno == EAGAIN || errno == EWOULDBLOCK) return would_block;
      if (errno != EINTR) return broken;
    }
  }

  int socket_;
};

}  // namespace

ssize_t Transport::write_file(int file, std::uint64_t offset, std::size_t size) {
  std::vector<char> piece(std::min<std::size_t>(size, 1 << 16));
  const ssize_t n = ::pread(file, piece.data(), piece.size(), static_cast<off_t>(offset));
  return n > 0 ? write(piece.data(), static_cast<std::size_t>(n), false) : broken;
}

void Transport::end_writing() { ::shutdown(socket(), SHUT_WR); }

std::unique_ptr<Transport> plain_transport(int socket) { return std::make_unique<PlainTransport>(socket); }

}  // namespace spherule::server
