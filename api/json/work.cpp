// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/work.h"

#include <algorithm>
#include <nlohmann/json.hpp>
#include <utility>

#include "api/json/label_json.h"
#include "api/json/parts.h"
#include "api/json/stored_json.h"
#include "core/render/options.h"

namespace spherule::api {

namespace {

using json_parts::Json;

// Options are kept as the texts that a query has.
Json texts_json(const OptionTexts& texts) {
  Json json;
  for (const auto& [name, text] : texts) json[name] = text;
  return json;
}
OptionTexts texts_from(const Json& json, const char* member) {
  OptionTexts texts;
  if (json.contains(member)) {
    for (const auto& [name, text] : json.at(member).items()) texts.emplace_back(name, text.get<std::string>());
  }
  return texts;
}

// The one of `words` whose name the JSON is; `words` as the enumerators go. Throws corrupt.
template <typename E, std::size_t n>
E one_of(const std::array<E, n>& words, const Json& json) {
  for (const E word : words)
    if (json == name(word)) return word;
  throw Error(ErrorCode::corrupt, "The server's record has a word that it does not know.");
}
constexpr std::array kSphereFormats{SphereFormat::csv, SphereFormat::npy, SphereFormat::ply, SphereFormat::vtp};
constexpr std::array kOrders{SphereOrder::index, SphereOrder::contribution};
constexpr std::array kRows{SphereRows::spheres, SphereRows::nodes, SphereRows::members};
constexpr std::array kTransforms{TransformKind::rigid, TransformKind::similarity, TransformKind::affine};
constexpr std::array kRegistrationMethods{RegistrationMethod::global, RegistrationMethod::matching};
constexpr std::array kApplied{Applied::volume, Applied::model};

// A pair of functions a kind of request: its members, and the request of them.

void write(Json& json, const ModelRequest& request) {
  json = json_parts::rule<Json>(request.rule);
  json["volume"] = request.volume;
}
void read(const Json& json, ModelRequest& request) {
  request.volume = json.at("volume");
  request.rule = json_parts::rule_from(json);
}

void write(Json& json, const SimplificationRequest& request) {
  json["model"] = request.model;
  json["method"] = texts_json(method_texts(request.method));
}
void read(const Json& json, SimplificationRequest& request) {
  request.model = json.at("model");
  request.method = parse_method(texts_from(json, "method"));
}

void write(Json& json, const RegistrationRequest& request) {
  json["parameters"] = json_parts::parameters<Json>(request);
}
void read(const Json& json, RegistrationRequest& request) {
  const Json& p = json.at("parameters");
  const Json& w = p.at("weights");
  request.fixed = p.at("fixed");
  request.moving = p.at("moving");
  RegistrationOptions& o = request.options;
  o.transform = one_of(kTransforms, p.at("transform"));
  o.method = one_of(kRegistrationMethods, p.at("method"));
  o.k = p.at("k");
  o.inits = p.at("inits");
  o.min_scale = p.at("scale_bounds").at(0);
  o.max_scale = p.at("scale_bounds").at(1);
  o.weights = {w.at("position"), w.at("size"), w.at("shape"), w.at("alone")};
  o.refine = p.at("refine");
  o.seed = p.at("seed");
}

void write(Json&, const MeasuresRequest&) {}
void read(const Json&, MeasuresRequest&) {}
void write(Json&, const ChecksRequest&) {}
void read(const Json&, ChecksRequest&) {}
void write(Json&, const ContributionsRequest&) {}
void read(const Json&, ContributionsRequest&) {}

void write(Json& json, const RenderRequest& request) {
  json["options"] = texts_json(render_option_texts(request.options));
  if (!request.with.empty()) json["with"] = request.with;
}
void read(const Json& json, RenderRequest& request) {
  request.options = parse_render_options(texts_from(json, "options"));
  request.with = json.value("with", "");
}

void write(Json& json, const ExportRequest& request) {
  json["format"] = name(request.format);
  const SphereListing& listing = request.listing;
  for (const SphereFigure figure : listing.columns) json["columns"].push_back(name(figure));
  if (listing.order != SphereOrder::index) json["order"] = name(listing.order);
  if (listing.rows != SphereRows::spheres) json["rows"] = name(listing.rows);
}
void read(const Json& json, ExportRequest& request) {
  request.format = one_of(kSphereFormats, json.at("format"));
  SphereListing& listing = request.listing;
  for (const Json& column : json.value("columns", Json::array()))
    listing.columns.push_back(one_of(sphere_figures, column));
  if (json.contains("order")) listing.order = one_of(kOrders, json.at("order"));
  if (json.contains("rows")) listing.rows = one_of(kRows, json.at("rows"));
}

void write(Json& json, const TreeRequest& request) { json["levels"] = request.levels; }
void read(const Json& json, TreeRequest& request) {
  request.levels = json.at("levels").get<std::vector<std::uint32_t>>();
}

void write(Json& json, const FileRequest& request) {
  json["format"] = info(request.format).name;
  const OptionTexts texts = file_option_texts(request.format, request.options);
  if (!texts.empty()) json["options"] = texts_json(texts);
}
void read(const Json& json, FileRequest& request) {
  const auto format = file_format(json.at("format").get<std::string>());
  if (!format) throw Error(ErrorCode::corrupt, "The server's record names a format that it does not know.");
  request = {.format = *format, .options = parse_file_options(*format, texts_from(json, "options"))};
}

void write(Json& json, const SliceRequest& request) {
  json["axis"] = request.axis;
  json["index"] = request.index;
  json["format"] = media_type(request.format);
  if (request.object) write(json["object"], ModelRequest{json.at("volume"), *request.object});
  json["options"] = texts_json(slice_option_texts(request.options));
}
void read(const Json& json, SliceRequest& request) {
  request.axis = json.at("axis");
  request.index = json.at("index");
  for (const FigureFormat format : figure_formats)
    if (json.at("format") == media_type(format)) request.format = format;
  if (json.contains("object")) request.object = json_parts::rule_from(json.at("object"));
  request.options = parse_slice_options(texts_from(json, "options"));
}

void write(Json& json, const ValuesRequest& request) { json["buckets"] = request.buckets; }
void read(const Json& json, ValuesRequest& request) { request.buckets = json.at("buckets"); }

void write(Json& json, const BeforeAfterRequest& request) {
  json["few"] = request.few;
  json["options"] = texts_json(render_option_texts(request.options));
}
void read(const Json& json, BeforeAfterRequest& request) {
  request.few = json.at("few");
  request.options = parse_render_options(texts_from(json, "options"));
}

// One kind for two things, told apart by the word itself.
void write(Json& json, const AppliedRequest& request) { json["what"] = name(request.what); }
void read(const Json& json, AppliedRequest& request) { request.what = one_of(kApplied, json.at("what")); }

void write(Json& json, const DerivedRequest& request) {
  const Kind& kind = kind_of(request);
  json[std::string(kind.source)] = request.source;
  json["what"] = kind.record;
  std::visit([&](const auto& what) { write(json, what); }, request.what);
  if (request.level > 0) json["level"] = request.level;
}

// The alternative of DerivedRequest::what that `json` is a record of, by number from `i` on.
template <std::size_t i = 0>
DerivedRequest derived_from(const Json& json) {
  using What = decltype(DerivedRequest::what);
  if constexpr (i == std::variant_size_v<What>) {
    throw Error(ErrorCode::corrupt, "The server's record is of a kind that it does not know.");
  } else {
    DerivedRequest request{.source = {}, .what = What(std::in_place_index<i>), .level = json.value("level", 0U)};
    const Kind& kind = kind_of(request);
    const std::string source(kind.source);
    const bool same = json.at("what") == kind.record || std::holds_alternative<AppliedRequest>(request.what);
    if (!same || !json.contains(source)) return derived_from<i + 1>(json);
    request.source = json.at(source);
    read(json, std::get<i>(request.what));
    return request;
  }
}

template <typename Request>
WorkRequest read_as(const Json& json) {
  Request request;
  read(json, request);
  return request;
}

std::string identity(Json&& what, const std::string& algorithm_version) {
  what["algorithm_version"] = algorithm_version;
  return what.dump(-1, ' ', false, Json::error_handler_t::replace);
}

}  // namespace

Json json_parts::request(const WorkRequest& request) {
  Json json = Json::object();
  std::visit([&](const auto& wanted) { write(json, wanted); }, request);
  if (const int edition = kind_of(request).edition; edition > 0) json["edition"] = edition;
  return json;
}

WorkRequest json_parts::request_from(std::string_view kind, const Json& json) {
  if (kind == "model") return read_as<ModelRequest>(json);
  if (kind == "simplification") return read_as<SimplificationRequest>(json);
  if (kind == "registration") return read_as<RegistrationRequest>(json);
  return derived_from(json);
}

std::string record_of(const WorkRequest& request) { return write_stored(json_parts::request(request)); }

WorkRequest work_from(std::string_view kind, std::string_view record) {
  return read_stored(record, [&](const Json& json) { return json_parts::request_from(kind, json); });
}

std::string identity_of(const WorkRequest& request, const std::string& algorithm_version) {
  return identity({{"request", json_parts::request(request)}}, algorithm_version);
}

std::string identity_of(std::span<const StoredFile> files, const VolumeParameters& parameters) {
  return Json{{"files", json_parts::files(files, files.size() > 1)}, {"parameters", json_parts::parameters(parameters)}}
      .dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string identity_of(const StoredFile& file, SphereFormat format, const std::string& algorithm_version) {
  return identity({{"imported", file.sha256}, {"format", name(format)}}, algorithm_version);
}

}  // namespace spherule::api
