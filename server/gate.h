// SPDX-License-Identifier: GPL-3.0-or-later
//
// What every request passes before it is answered, and what is written down of it: is the key known and does it allow
// this; who did what to which object, and how did it end.
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

#include <functional>
#include <string>
#include <vector>

#include "api/http.h"
#include "server/auth.h"
#include "server/log.h"

namespace spherule::server {

/// Thread safe. `audit` outlives it.
class Gate {
 public:
  /// Answers an allowed request of this client.
  using Next = std::function<api::Response(const std::string& client)>;

  /// Without keys everybody is the client "local", who may do everything.
  Gate(std::vector<ApiKey> keys, AppendLog& audit) : keys_(std::move(keys)), audit_(audit) {}

  api::Response pass(const api::Request& request, const Next& next) const;

 private:
  void write_down(const api::Request& request, const api::Response& response, const std::string& who) const;

  const std::vector<ApiKey> keys_;
  AppendLog& audit_;
};

}  // namespace spherule::server
