// SPDX-License-Identifier: GPL-3.0-or-later
//
// The body of a request on the network: counted, unpacked and taken apart as it comes.
#pragma once

#include <cstdint>

#include "api/http/http.h"
#include "server/http/connections.h"

namespace spherule::server {

class HttpBody final : public api::Body {
 public:
  /// Of the request that `connection` is answering now; it outlives the body.
  explicit HttpBody(Connection& connection) : connection_(connection) {}

  bool present() const override { return connection_.head().has_body(); }
  std::uint64_t announced() const override { return connection_.head().length; }
  void read(std::uint64_t limit, const Take& take) override;
  void read_parts(std::uint64_t limit, const BeginPart& begin_part, const Take& take) override;

 private:
  void check_announced(std::uint64_t limit) const;

  Connection& connection_;
};

}  // namespace spherule::server
