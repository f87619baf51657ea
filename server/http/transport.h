// SPDX-License-Identifier: GPL-3.0-or-later
//
// The two ends of a connection's bytes: a socket as it is, or something that speaks through it (TLS).
#pragma once

#include <sys/types.h>

#include <cstddef>
#include <cstdint>
#include <functional>
#include <memory>

namespace spherule::server {

/// Never blocks. One thread at a time.
class Transport {
 public:
  /// What read() and write() return besides a count: try again when the socket is readable, or writable; or never.
  static constexpr ssize_t want_read = -1, want_write = -2, broken = -3;

  virtual ~Transport() = default;
  Transport(const Transport&) = delete;
  Transport& operator=(const Transport&) = delete;

  /// For waiting and for addresses, not for bytes.
  virtual int socket() const = 0;
  /// Bytes read, 0 at the end of the connection, or one of the above.
  virtual ssize_t read(char* into, std::size_t size) = 0;
  /// Bytes written, more than 0, or one of the above. `more` says that others follow at once, with which they may go.
  virtual ssize_t write(const char* from, std::size_t size, bool more) = 0;
  /// As write(), with bytes of a file from `offset` on. This one reads them and writes them.
  virtual ssize_t write_file(int file, std::uint64_t offset, std::size_t size);
  /// Tells the peer that nothing more will be written. It may still be read.
  virtual void end_writing();

 protected:
  Transport() = default;
};

/// Takes over a connected socket and closes it in the end.
using MakeTransport = std::function<std::unique_ptr<Transport>(int socket)>;

/// The socket as it is.
std::unique_ptr<Transport> plain_transport(int socket);

}  // namespace spherule::server
