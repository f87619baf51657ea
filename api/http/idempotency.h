// SPDX-License-Identifier: GPL-3.0-or-later
//
// Idempotency-Key on POST (draft-ietf-httpapi-idempotency-key-header): the same request again, after a break in the
// network, has no further effect and gets the same answer.
#pragma once

#include <functional>

#include "api/http/http.h"

namespace spherule::api {

/// Answers by `answer`, or as the first request with this key was answered, which the answer then says by
/// Idempotency-Replayed. Requests without a key, and other methods, go straight through; so do refusals: nothing was
/// done, and a mended request may use the key again. Throws HttpError 422 for a key that came with another request,
/// Error conflict while that is under way, invalid_argument for a malformed key.
Response answer_once(Service& service, const Request& request, const std::function<Response(const Request&)>& answer);

}  // namespace spherule::api
