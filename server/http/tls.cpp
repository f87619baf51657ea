// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/http/tls.h"

#include <openssl/err.h>
#include <openssl/ssl.h>

#include <algorithm>
#include <limits>
#include <new>

#include "core/base/error.h"

namespace spherule::server {

namespace {

struct Free {
  void operator()(SSL_CTX* context) const { SSL_CTX_free(context); }
  void operator()(SSL* connection) const { SSL_free(connection); }
};

class TlsTransport final : public Transport {
 public:
  TlsTransport(SSL_CTX* context, int socket) : socket_(plain_transport(socket)), tls_(SSL_new(context)) {
    if (!tls_ || SSL_set_fd(tls_.get(), socket) != 1) throw std::bad_alloc();
    SSL_set_accept_state(tls_.get());
  }
  ~TlsTransport() override {
    ERR_clear_error();
    // Says that nothing was cut off. The peer's farewell is not waited for.
    if (SSL_is_init_finished(tls_.get()) != 0) SSL_shutdown(tls_.get());
  }
  int socket() const override { return socket_->socket(); }
  // The handshake is part of the first of these.
  ssize_t read(char* into, std::size_t size) override {
    return result([&] { return SSL_read(tls_.get(), into, most(size)); });
  }
  ssize_t write(const char* from, std::size_t size, bool /*more*/) override {
    return result([&] { return SSL_write(tls_.get(), from, most(size)); });
  }
  void end_writing() override {
    ERR_clear_error();
    if (SSL_is_init_finished(tls_.get()) != 0) SSL_shutdown(tls_.get());
    Transport::end_writing();
  }

 private:
  static int most(std::size_t size) {
    return static_cast<int>(std::min<std::size_t>(size, std::numeric_limits<int>::max()));
  }
  template <typename F>
  ssize_t result(F&& call) {
    // What an earlier call, of another connection, left in this thread's queue would be taken for this one's.
    ERR_clear_error();
    const int n = call();
    if (n > 0) return n;
    switch (SSL_get_error(tls_.get(), n)) {
      case SSL_ERROR_WANT_READ: return want_read;
      case SSL_ERROR_WANT_WRITE: return want_write;
      case SSL_ERROR_ZERO_RETURN: return 0;
      default: return broken;
    }
  }

  std::unique_ptr<Transport> socket_;
  std::unique_ptr<SSL, Free> tls_;  // goes before its socket
};

}  // namespace

MakeTransport tls_transport(const std::filesystem::path& certificate, const std::filesystem::path& key) {
  const std::shared_ptr<SSL_CTX> context(SSL_CTX_new(TLS_server_method()), Free());
  if (!context) throw std::bad_alloc();
  SSL_CTX_set_min_proto_version(context.get(), TLS1_2_VERSION);
  // A write that was not taken at once is tried again from wherever its bytes are by then.
  SSL_CTX_set_mode(context.get(), SSL_MODE_ENABLE_PARTIAL_WRITE | SSL_MODE_ACCEPT_MOVING_WRITE_BUFFER);
  if (SSL_CTX_use_certificate_chain_file(context.get(), certificate.c_str()) != 1 ||
      SSL_CTX_use_PrivateKey_file(context.get(), key.c_str(), SSL_FILETYPE_PEM) != 1 ||
      SSL_CTX_check_private_key(context.get()) != 1) {
    throw Error(ErrorCode::invalid_argument, "The TLS certificate and key cannot be read, or do not belong together.");
  }
  return [context](int socket) { return std::make_unique<TlsTransport>(context.get(), socket); };
}

}  // namespace spherule::server
