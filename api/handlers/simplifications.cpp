// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "api/http/query.h"
#include "api/json/bodies.h"

namespace spherule::api {

void check_simplification_body(const Request& request) {
  if (!is_json(request)) throw HttpError(415, "Send application/json.", {{"Accept-Post", "application/json"}});
}

Response post_simplification(const Call& call) {
  const Query query(call.request, {});
  const Body* body = call.request.body;
  if (body == nullptr || !body->present()) {
    throw Error(ErrorCode::invalid_argument, "Send a JSON object such as {\"method\": \"best\", \"k\": 64}.");
  }
  check_simplification_body(call.request);
  return made(call, SimplificationRequest{.model = call.id(), .method = simplification_body(json_body(call))});
}

Response get_tree(const Call& call) {
  const Query query(call.request, {"levels"});
  return derived(call, {.source = call.id(), .what = TreeRequest{tree_levels(query)}}, "application/json");
}

}  // namespace spherule::api
