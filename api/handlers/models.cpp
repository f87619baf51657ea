// SPDX-License-Identifier: GPL-3.0-or-later
#include <algorithm>
#include <array>

#include "api/handlers/handlers.h"
#include "api/handlers/parameters.h"
#include "api/http/negotiation.h"
#include "api/http/problem.h"
#include "api/http/query.h"
#include "api/json/bodies.h"
#include "api/json/documents.h"

namespace spherule::api {

namespace {

// In the order of SphereFormat.
constexpr std::array<std::string_view, 4> kSphereTypes = {"text/csv", "application/x-npy", "application/x-ply",
                                                          "application/x-vtk-polydata"};

Response import_spheres(const Call& call, SphereFormat format) {
  std::unique_ptr<Upload> upload = call.service.start_upload(call.request.body->announced());
  upload->begin_file({});
  call.request.body->read(call.service.limits().upload_bytes, [&](std::string_view piece) { upload->write(piece); });
  const Stored<ModelInfo> model = call.service.import_model(std::move(upload), format);
  return stored(call, document_of(model.thing), model.already_stored, "/v1/models/" + model.thing.id);
}

Response make_model(const Call& call) {
  const ModelBody body = model_body(json_body(call));
  ModelRequest request{.volume = body.volume, .rule = body.rule};
  if (!body.side_given && body.rule.kind == ObjectRule::Kind::threshold) {
    request.rule.side = call.service.find<VolumeInfo>(body.volume).natural_side;
  }
  return made(call, request);
}

Response exported(const Call& call, const ExportRequest& wanted, std::uint32_t level) {
  Response response = derived(call, {.source = call.id(), .what = wanted, .level = level},
                              kSphereTypes[static_cast<std::size_t>(wanted.format)],
                              call.id() + "." + std::string(name(wanted.format)));
  // For the formats that cannot say so themselves.
  response.set("Spherule-Frame", "LPS");
  response.set("Spherule-Unit", "mm");
  return response;
}

Response get_file(const Call& call, FileFormat format) {
  const FileFormatInfo& about = info(format);
  const auto [file, level] = file_request(call.request, format);
  Response response = derived(call, {.source = call.id(), .what = file, .level = level}, about.media_type,
                              call.id() + "." + std::string(about.extension));
  response.set("Spherule-Frame", std::string(about.frame));
  response.set("Spherule-Unit", std::string(about.unit));
  return response;
}

std::optional<SphereFormat> sphere_format(std::string_view word) {
  for (std::size_t i = 0; i < kSphereTypes.size(); ++i) {
    if (word == name(static_cast<SphereFormat>(i))) return static_cast<SphereFormat>(i);
  }
  return std::nullopt;
}

// Of the spheres in the body; none when it is JSON. Throws HttpError 415.
std::optional<SphereFormat> body_format(const Request& request) {
  const Query query(request, {"format"});
  const auto given = query.choice("format", {"csv", "npy"});
  const std::string type = media_type(request.header("Content-Type"));
  if (given == "csv" || (!given && type == "text/csv")) return SphereFormat::csv;
  if (given == "npy" || (!given && type == "application/x-npy")) return SphereFormat::npy;
  if (is_json(request)) return {};
  throw HttpError(415, "Send application/json, or spheres as text/csv or application/x-npy (or add format=csv or npy).",
                  {{"Accept-Post", "application/json, text/csv, application/x-npy"}});
}

std::uint32_t level_of(const Query& query) {
  return static_cast<std::uint32_t>(query.integer("level", ranges::level).value_or(0));
}

struct PageOfSpheres {
  SphereListing listing;
  std::uint32_t level;
  bool members;
  std::uint64_t offset;
  std::size_t limit;
};

Response page_of_spheres(const Call& call, const Query& query, const PageOfSpheres& wanted) {
  const SpherePage page =
      call.service.spheres(call.id(), wanted.level, wanted.offset, wanted.limit, wanted.listing, wanted.members);
  Response response{.status = 200, .body = sphere_page_document(call.id(), page, wanted.offset)};
  response.set("Content-Type", "application/json");
  response.set("Vary", "Accept");
  const std::uint64_t end = wanted.offset + page.spheres.size();
  if (end < page.total) {
    std::string next = "/v1/models/" + call.id() + "/spheres?format=json";
    for (const char* name : {"level", "rows", "columns", "order", "members"}) {
      if (const auto text = query.text(name)) next += std::string("&") + name + "=" + *text;
    }
    response.set("Link", "<" + next + "&offset=" + std::to_string(end) + "&limit=" + std::to_string(wanted.limit) +
                             ">; rel=\"next\"");
  }
  return response;
}

std::string export_names() {
  std::string names = "csv, npy, ply, vtp";
  for (std::size_t i = 0; i < file_format_count; ++i)
    names += ", " + std::string(info(static_cast<FileFormat>(i)).name);
  return names;
}

}  // namespace

void check_model_body(const Request& request) { static_cast<void>(body_format(request)); }

Response post_model(const Call& call) {
  const std::optional<SphereFormat> format = body_format(call.request);
  const Body* body = call.request.body;
  if (body == nullptr || !body->present()) {
    throw Error(ErrorCode::invalid_argument,
                "Send a JSON object such as {\"volume\": id, \"threshold\": 60.5}, or spheres as CSV or NPY.");
  }
  return format ? import_spheres(call, *format) : make_model(call);
}

Response get_spheres(const Call& call) {
  const Query query(call.request, {"format", "level", "rows", "columns", "order", "members", "offset", "limit"});
  const auto given = query.choice("format", {"json", "csv", "npy", "ply", "vtp"});
  const SphereListing listing = sphere_listing(query);
  const std::uint32_t level = level_of(query);
  const auto members = query.choice("members", {"true", "false"});
  const auto offset = query.integer("offset", ranges::row);
  const auto limit = query.integer("limit", ranges::rows);
  std::optional<SphereFormat> format;
  if (given) {
    format = sphere_format(*given);
  } else {
    std::array<std::string_view, 5> types = {"application/json"};
    std::ranges::copy(kSphereTypes, types.begin() + 1);
    const std::size_t best = negotiate(call.request.header("Accept"), types);
    if (best > 0) format = static_cast<SphereFormat>(best - 1);
  }
  if (format) {
    if (offset || limit) {
      throw Error(ErrorCode::invalid_argument, "Only JSON comes in pages; leave offset and limit out.",
                  {{offset ? "offset" : "limit", "This is for format=json."}});
    }
    if (members) {
      throw Error(ErrorCode::invalid_argument, "Only JSON lists members; ask for the rows=members instead.",
                  {{"members", "This is for format=json; rows=members lists each member with its cluster."}});
    }
    return exported(call, {*format, listing}, level);
  }
  if (members == "true" && listing.rows != SphereRows::spheres) {
    throw Error(ErrorCode::invalid_argument, "Members are of the spheres of a level; leave rows out.",
                {{"members", "This is for rows=spheres."}});
  }
  const PageOfSpheres wanted{.listing = listing,
                             .level = level,
                             .members = members == "true",
                             .offset = static_cast<std::uint64_t>(offset.value_or(0)),
                             .limit = static_cast<std::size_t>(limit.value_or(1000))};
  if (!listing.needs_contributions()) return page_of_spheres(call, query, wanted);
  return worked(call, DerivedRequest{.source = call.id(), .what = ContributionsRequest{}, .level = level},
                agreed_wait(call, true), [&](const Made&) { return page_of_spheres(call, query, wanted); });
}

Response get_measures(const Call& call) {
  const Query query(call.request, {"components", "level"});
  const auto components = query.integer("components", {0, static_cast<std::int64_t>(listed_components)}).value_or(10);
  constexpr std::array<std::string_view, 1> types = {"application/json"};
  negotiate(call.request.header("Accept"), types);
  const DerivedRequest request{.source = call.id(), .what = MeasuresRequest{}, .level = level_of(query)};
  return worked(call, request, agreed_wait(call, true), [&](const Made& made) {
    return json_response(call, with_components(text_of(std::get<Content>(made)), static_cast<std::size_t>(components)));
  });
}

Response get_radius_histogram(const Call& call) {
  const Query query(call.request, {"buckets", "scale", "format", "width", "height"});
  const auto buckets = static_cast<std::size_t>(query.integer("buckets", ranges::buckets).value_or(40));
  const auto scale = query.choice("scale", {"linear", "log"}) == "log" ? RadiusScale::logarithmic : RadiusScale::linear;
  const FigureFormat format = plot_format(call, query);
  const PlotSize size = plot_size(call, query);
  const RadiusHistogram histogram = call.service.radius_histogram(call.id(), buckets, scale);
  return format == FigureFormat::json ? json_response(call, radius_histogram_document(call.id(), histogram))
                                      : plotted(plot_of_radii(histogram), format, size);
}

Response get_checks(const Call& call) {
  const Query query(call.request, {});
  return derived(call, {.source = call.id(), .what = ChecksRequest{}}, "application/json");
}

Response get_render(const Call& call) {
  const auto [render, level] = render_request(call.request);
  check_pixels(call, pixels_of(render.options, render.with.empty() ? 1 : 2));
  const char* type = render.options.turntable > 0 ? "image/gif" : "image/png";
  return derived(call, {.source = call.id(), .what = render, .level = level}, type);
}

Response get_export(const Call& call) {
  if (const auto file = file_format(call.parameters[1])) return get_file(call, *file);
  const Query query(call.request, {"level", "rows", "columns", "order"});
  const auto format = sphere_format(call.parameters[1]);
  if (!format) throw Error(ErrorCode::not_found, "There is no such export; there are " + export_names() + ".");
  return exported(call, {*format, sphere_listing(query)}, level_of(query));
}

}  // namespace spherule::api
