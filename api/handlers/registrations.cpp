// SPDX-License-Identifier: GPL-3.0-or-later
#include <array>

#include "api/handlers/handlers.h"
#include "api/http/problem.h"
#include "api/json/documents.h"
#include "api/json/registration_documents.h"
#include "api/requests.h"
#include "core/register/itk.h"

namespace spherule::api {

namespace {

// The answer's bytes once they are there, else 202 with the job.
Response answered(const Call& call, const RegistrationAnswerRequest& request, std::string_view type,
                  const std::string& filename) {
  negotiate(call.request.header("Accept"), std::span(&type, 1));
  const Wait wait = agreed_wait(call, true);
  Outcome<Content> outcome = call.service.derive_from(request, wait.granted);
  auto* content = std::get_if<Content>(&outcome);
  Response response = content != nullptr ? content_response(call, std::move(*content), std::string(type), filename)
                                         : accepted(std::get<JobInfo>(outcome));
  wait.state(response, outcome);
  return response;
}

Response applied(const Call& call, Applied what) {
  return answered(call, {.registration = call.id(), .what = what}, "application/x-nifti",
                  call.id() + "-" + std::string(name(what)) + ".nii");
}

}  // namespace

Response list_registrations(const Call& call) {
  return listed(call, "/v1/registrations", &Service::registrations, registration_list_document);
}

Response post_registration(const Call& call) {
  const Query query(call.request, {});
  const Wait wait = agreed_wait(call, false);
  const auto outcome = call.service.register_pair(registration_wish(json_body(call)), wait.granted);
  Response response;
  if (const auto* stored = std::get_if<StoredRegistration>(&outcome)) {
    response = json_response(call, stored->registration.document, stored->already_stored ? 200 : 201);
    response.set("Location", "/v1/registrations/" + stored->registration.id);
  } else {
    response = accepted(std::get<JobInfo>(outcome));
  }
  wait.state(response, outcome);
  return response;
}

Response get_registration(const Call& call) {
  const Query query(call.request, {"format"});
  const auto format = query.choice("format", {"json", "itk"});
  const RegistrationInfo info = call.service.registration(call.id());
  if (format != "itk") return json_response(call, info.document);
  constexpr std::array<std::string_view, 1> types = {"text/plain"};
  negotiate(call.request.header("Accept"), types);
  Response response{.status = 200, .body = itk_transform(inverse(info.moving_to_fixed))};
  response.set("Content-Type", "text/plain");
  response.set("Content-Disposition", "attachment; filename=\"" + info.id + ".tfm\"");
  return response;
}

Response delete_registration(const Call& call) {
  const Query query(call.request, {});
  call.service.delete_registration(call.id());
  return {.status = 204};
}

Response get_registration_render(const Call& call) {
  const BeforeAfterRequest picture = before_after_request(call.request);
  check_pixels(call, 2 * pixels_of(picture.options, 2));
  return answered(call, {.registration = call.id(), .what = picture}, "image/png", {});
}

Response get_applied(const Call& call) {
  const Query query(call.request, {"what"});
  return applied(call, query.choice("what", {"volume", "model"}) == "model" ? Applied::model : Applied::volume);
}

Response post_apply(const Call& call) {
  const Query query(call.request, {});
  const Body* body = call.request.body;
  return applied(call, applied_wish(body != nullptr && body->present() ? json_body(call) : std::string()));
}

}  // namespace spherule::api
