// SPDX-License-Identifier: GPL-3.0-or-later
//
// What every request passes before it is answered, and what is written down of it: does it come from where it may; is
// the key known and does it allow this; who did what to which object, and how did it end.
//
// Without keys, whoever reaches the server may do everything, and so might every page in a browser on this machine. A
// page can come by a name of its own that leads here (DNS rebinding): so the Host must be a loopback name, or one of
// `hosts`. And a page may send what it cannot read the answer of: so a request that changes something must not come
// from a page of another origin (Origin, Sec-Fetch-Site), unless that is one of `origins`. What is no browser sends
// neither header. With keys neither is needed, because a page has no key that it was not given; `hosts`, if there are
// any, are insisted on all the same.
//
// The audit log has one line for every request to /v1 that was refused here, changed something, or read data of a
// volume, a model or a registration (asking how jobs are is left out):
//
//   {"time":…,"event":"audit","who":"ward-3","action":"POST /v1/models","object":"mdl_…","outcome":"allowed",
//    "status":201,"request":"req_…","trace":"…"}
//
// `outcome` is allowed, denied (401, 403) or failed (any other status from 400 on). Lines of requests that change
// something are on the disk before the answer is sent; those of reads go along with the next of these.
#pragma once

#include <cstddef>
#include <functional>
#include <map>
#include <memory>
#include <mutex>
#include <optional>
#include <string>
#include <vector>

#include "api/http/cors.h"
#include "api/http/http.h"
#include "server/access/auth.h"
#include "server/base/log.h"

namespace spherule::server {

struct GateOptions {
  std::vector<ApiKey> keys{};           ///< none: everybody is the client "local", who may do everything
  std::vector<std::string> hosts{};     ///< names of this server besides those of loopback, in lower case
  api::AllowedOrigins origins{};        ///< whose pages may change something
  std::size_t streams_of_client = ~0U;  ///< event streams that one client may have open; further ones are refused (429)
};

/// Thread safe. `audit` outlives it.
class Gate {
 public:
  /// Answers an allowed request of this client.
  using Next = std::function<api::Response(const std::string& client)>;

  Gate(GateOptions options, AppendLog& audit) : options_(std::move(options)), audit_(audit) {}

  /// Why a request is not let through, if so; written down.
  std::optional<api::Response> refusal(const api::Request& request) const;
  api::Response pass(const api::Request& request, const Next& next) const;

 private:
  // Places for event streams, by client.
  struct Places {
    std::mutex mutex;
    std::map<std::string, std::size_t> taken;
  };
  struct Judgement {
    std::string client;  ///< empty: not known
    std::optional<api::Response> refused{};
  };

  Judgement judge(const api::Request& request) const;
  std::optional<api::Response> misplaced(const api::Request& request) const;
  api::Response with_place(const api::Request& request, api::Response response, const std::string& client) const;
  void write_down(const api::Request& request, const api::Response& response, const std::string& who) const;

  const GateOptions options_;
  AppendLog& audit_;
  const std::shared_ptr<Places> places_ = std::make_shared<Places>();
};

}  // namespace spherule::server
