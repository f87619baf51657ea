// SPDX-License-Identifier: GPL-3.0-or-later
//
// Hands an answer as a value over to the HTTP library.
#pragma once

#include <httplib.h>

#include <functional>
#include <string>

#include "api/http.h"
#include "server/http/encoding.h"

namespace spherule::server {

/// Set when the connection is to be closed after an answer: what to do between the two. The library closes by itself
/// only when a content provider fails.
using Close = std::function<void()>;

/// Takes in what the client still sends, for a while: a socket closed with unread bytes makes the client's side drop
/// the answer that says why.
Close lingering(const httplib::ContentReader* reader);

struct ReplyOptions {
  Encoding encoding = Encoding::identity;  ///< what the client likes best
  std::string known_tags{};                ///< its If-None-Match header, as it came
  Close close{};
  std::function<bool()> stopping{};  ///< asked between events; true ends a stream
  std::function<void()> streamed{};  ///< called when an event stream is over
};

void send(api::Response&& answer, ReplyOptions options, httplib::Response& response);

}  // namespace spherule::server
