// SPDX-License-Identifier: GPL-3.0-or-later
//
// One function a row of the route table (routes.cpp): parse, validate, call the service, present.
#pragma once

#include <chrono>
#include <functional>
#include <string>
#include <string_view>
#include <vector>

#include "api/handlers/parameters.h"
#include "api/http/http.h"
#include "api/http/negotiation.h"
#include "api/http/query.h"
#include "core/render/plot.h"

namespace spherule::api {

struct Call {
  Service& service;
  const Request& request;
  std::vector<std::string> parameters;  ///< of the path, in order

  const std::string& id() const { return parameters.front(); }
};

// Of a volume, a model or a registration.
Response list_things(const Call& call, Collection collection);
Response get_thing(const Call& call, Collection collection);
Response delete_thing(const Call& call, Collection collection);

// /v1/volumes
Response post_volume(const Call& call);
Response get_volume_content(const Call& call);
Response get_volume_histogram(const Call& call);
Response get_slice(const Call& call);

// /v1/models
Response post_model(const Call& call);
Response get_spheres(const Call& call);
Response get_measures(const Call& call);
Response get_radius_histogram(const Call& call);
Response get_checks(const Call& call);
Response get_render(const Call& call);
Response get_export(const Call& call);
Response post_simplification(const Call& call);
Response get_tree(const Call& call);

// /v1/uploads
Response post_upload(const Call& call);
Response get_upload(const Call& call);
Response patch_upload(const Call& call);
Response delete_upload(const Call& call);

// /v1/registrations
Response post_registration(const Call& call);
Response get_registration(const Call& call);
Response get_registration_render(const Call& call);
Response get_applied(const Call& call);
Response post_apply(const Call& call);

// /v1/jobs
Response list_jobs(const Call& call);
Response get_job(const Call& call);
Response cancel_job(const Call& call);
Response get_job_events(const Call& call);

// Of the program itself.
Response get_livez(const Call& call);
Response get_readyz(const Call& call);
Response get_metrics(const Call& call);
Response get_version(const Call& call);
Response get_contract(const Call& call);
Response get_docs(const Call& call);

// What the head of a request must say of its body. Each throws HttpError 415.
void check_model_body(const Request& request);
void check_simplification_body(const Request& request);
void check_first_piece(const Request& request);
void check_piece(const Request& request);

// What several of them share.

/// A JSON answer. Throws HttpError 406 when the Accept header does not allow JSON.
Response json_response(const Call& call, std::string document, int status = 200);
/// How long the caller is made to wait for a job.
struct Wait {
  std::chrono::seconds granted;
  bool asked;  ///< by a Prefer header
};
/// What the caller prefers, capped; the cap itself without a preference where `waits_unasked`, else 0.
Wait agreed_wait(const Call& call, bool waits_unasked);
/// What the request makes, as `present` shows it, or 202 with the job and where to look for it; and what became of the
/// Prefer header.
using Present = std::function<Response(Made made)>;
Response worked(const Call& call, const WorkRequest& request, const Wait& wait, const Present& present);
/// 200 or 201 with a thing that was asked for, and where it is.
Response stored(const Call& call, std::string document, bool already_stored, const std::string& location);
/// A model or a registration that a request makes: does not wait unasked.
Response made(const Call& call, const WorkRequest& request);
/// The whole body of a request of JSON.
std::string json_body(const Call& call);
/// A stored content, or the part of it that a Range header asks for.
Response content_response(const Call& call, Content content, std::string media_type, const std::string& filename);
/// What is derived from something, once it is there: waits for it, or answers with its job. Throws HttpError 406 when
/// the Accept header does not allow `media_type`.
Response derived(const Call& call, const DerivedRequest& request, std::string_view media_type,
                 const std::string& filename = {});
/// All of a content.
std::string text_of(const Content& content);
/// Throws too_large for pictures of more pixels than the service allows.
void check_pixels(const Call& call, std::uint64_t pixels);
/// As what a histogram is asked for, and the size of its plot: `?width=` and `?height=`, which JSON does not have.
FigureFormat plot_format(const Call& call, const Query& query);
struct PlotSize {
  int width = 900, height = 560;
};
PlotSize plot_size(const Call& call, const Query& query);
/// A plot as PNG or SVG.
Response plotted(const Plot& plot, FigureFormat format, const PlotSize& size);
/// What OPTIONS tells of uploads.
void describe_uploads(Service& service, Response& response);
/// Adds a Link header to the next page of a list.
void link_next(Response& response, const std::string& path, const PageRequest& page, const std::string& next);

}  // namespace spherule::api
