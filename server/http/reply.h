// SPDX-License-Identifier: GPL-3.0-or-later
//
// Writes an answer as a value to a connection.
#pragma once

#include <functional>
#include <string>

#include "api/http/http.h"
#include "server/http/connections.h"
#include "server/http/encoding.h"

namespace spherule::server {

struct ReplyOptions {
  Encoding encoding = Encoding::identity;  ///< what the client likes best
  std::string known_tags{};                ///< its If-None-Match field, as it came
  std::string keep_alive{};                ///< what to say of it; empty: the connection is closed after the answer
  std::function<bool()> stopping{};        ///< asked between events; true ends a stream
};

/// The first line and the fields of an answer, up to the empty line. For answers that no request leads to, too.
std::string head_text(int status, const std::vector<std::pair<std::string, std::string>>& fields);

/// False when the client has not taken all of it.
bool send(api::Response&& answer, const ReplyOptions& options, Connection& connection);

}  // namespace spherule::server
