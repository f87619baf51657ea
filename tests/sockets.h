// SPDX-License-Identifier: GPL-3.0-or-later
//
// Clients that say exactly what they are told to, and are as slow as they like.
#pragma once

#include <chrono>
#include <string>
#include <string_view>

namespace spherule::test {

/// A connection to a server on this machine. Movable.
class Socket {
 public:
  /// `receive_buffer` bytes (0: the system's choice) are what the kernel takes in for a client that does not read.
  explicit Socket(int port, int receive_buffer = 0);
  Socket(Socket&& other) noexcept;
  Socket& operator=(Socket&&) = delete;
  ~Socket();

  bool connected() const { return socket_ >= 0; }
  /// All of it; false when the server has closed.
  bool send(std::string_view text) const;
  /// As much as goes at once; false when the server has closed.
  bool try_send(std::string_view text) const;
  /// What comes until `end` is in it, the server closes ("<closed>" stands for that), or the patience is over.
  std::string receive(std::string_view end, std::chrono::milliseconds patience = std::chrono::seconds(5)) const;
  bool closed_within(std::chrono::milliseconds patience) const;

 private:
  int socket_;
};

/// Lets this process open as many descriptors as the system allows, and what it starts begin with `inherited`.
class Descriptors {
 public:
  explicit Descriptors(std::size_t inherited);
  ~Descriptors();
  Descriptors(const Descriptors&) = delete;
  Descriptors& operator=(const Descriptors&) = delete;
  /// From now on this process may have as many as there may be.
  void raise() const;

 private:
  std::size_t before_;
};

}  // namespace spherule::test
