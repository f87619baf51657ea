// SPDX-License-Identifier: GPL-3.0-or-later
#include <array>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "api/http/query.h"
#include "api/json/bodies.h"
#include "api/json/documents.h"
#include "api/json/registration_documents.h"
#include "core/register/itk.h"

namespace spherule::api {

namespace {

Response applied(const Call& call, AppliedRequest request) {
  return derived(call, {.source = call.id(), .what = request}, "application/x-nifti",
                 call.id() + "-" + std::string(name(request.what)) + ".nii");
}

}  // namespace

Response post_registration(const Call& call) {
  const Query query(call.request, {});
  return made(call, registration_body(json_body(call)));
}

Response get_registration(const Call& call) {
  const Query query(call.request, {"format"});
  const auto format = query.choice("format", {"json", "itk"});
  const RegistrationInfo info = call.service.find<RegistrationInfo>(call.id());
  if (format != "itk") return json_response(call, info.document);
  constexpr std::array<std::string_view, 1> types = {"text/plain"};
  negotiate(call.request.header("Accept"), types);
  Response response{.status = 200, .body = itk_transform(inverse(info.moving_to_fixed))};
  response.set("Content-Type", "text/plain");
  response.set("Content-Disposition", "attachment; filename=\"" + info.id + ".tfm\"");
  return response;
}

Response get_registration_render(const Call& call) {
  const BeforeAfterRequest picture = before_after_request(call.request);
  check_pixels(call, 2 * pixels_of(picture.options, 2));
  return derived(call, {.source = call.id(), .what = picture}, "image/png");
}

Response get_applied(const Call& call) {
  const Query query(call.request, {"what"});
  return applied(call, {query.choice("what", {"volume", "model"}) == "model" ? Applied::model : Applied::volume});
}

Response post_apply(const Call& call) {
  const Query query(call.request, {});
  const Body* body = call.request.body;
  return applied(call, apply_body(body != nullptr && body->present() ? json_body(call) : std::string()));
}

}  // namespace spherule::api
