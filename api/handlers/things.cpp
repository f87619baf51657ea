// SPDX-License-Identifier: GPL-3.0-or-later
//
// What volumes, models and registrations have in common: they are listed, told of and deleted.
#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "api/json/documents.h"

namespace spherule::api {

Response list_things(const Call& call, Collection collection) {
  const PageRequest wanted = page_request(Query(call.request, {"limit", "cursor"}));
  const Page<Thing> page = call.service.list(collection, wanted);
  Response response = json_response(call, list_document(collection, page));
  link_next(response, "/v1/" + std::string(name(collection)), wanted, page.next);
  return response;
}

Response get_thing(const Call& call, Collection collection) {
  const Query query(call.request, {});
  return json_response(call, document_of(call.service.find(collection, call.id())));
}

Response delete_thing(const Call& call, Collection collection) {
  const Query query(call.request, {});
  call.service.remove(collection, call.id());
  return {.status = 204};
}

}  // namespace spherule::api
