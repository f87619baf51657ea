// SPDX-License-Identifier: GPL-3.0-or-later
#include <limits>
#include <nlohmann/json.hpp>

#include "api/json/documents.h"
#include "api/json/label_json.h"
#include "api/json/stored_json.h"
#include "api/requests.h"
#include "core/render/options.h"

namespace spherule::api {

namespace {

// Changes when pictures do, so that those kept by an older program are drawn anew.
constexpr int kPictureEdition = 8;
// Changes with the bytes of tables of spheres: 2 has float64 wherever numbers are binary.
constexpr int kTableEdition = 3;
// Changes with what any file for another program holds.
constexpr int kFileEdition = 3;

// Members ascend, which with dump() is the canonical form.
using Json = nlohmann::json;

// Changes when the document of measures does, so that answers kept by an older program are made anew.
constexpr int kMeasuresEdition = 5;

Json to_json(Vec3 v) { return Json::array({v.x, v.y, v.z}); }
Vec3 vec_from(const Json& json) { return {json.at(0), json.at(1), json.at(2)}; }

std::int64_t microseconds(Time time) {
  return std::chrono::duration_cast<std::chrono::microseconds>(time.time_since_epoch()).count();
}
Time time_from(const Json& json) {
  // Counted in nanoseconds it must fit 64 bits.
  constexpr std::int64_t latest = std::numeric_limits<std::int64_t>::max() / 1000;
  const auto microseconds = json.get<std::int64_t>();
  if (microseconds < -latest || microseconds > latest) throw Error(ErrorCode::corrupt, "This is no time.");
  return Time(std::chrono::duration_cast<Time::duration>(std::chrono::microseconds(microseconds)));
}

Json to_json(const VolumeParameters& parameters) {
  Json json = Json::object();
  if (parameters.raw) {
    json["raw"] = {{"dims", parameters.raw->dims},
                   {"dtype", name(parameters.raw->type)},
                   {"spacing", to_json(parameters.raw->spacing)},
                   {"origin", to_json(parameters.raw->origin)},
                   {"big_endian", parameters.raw->big_endian}};
  }
  if (parameters.frame) json["frame"] = *parameters.frame;
  if (!parameters.grid.empty()) json["grid"] = parameters.grid;
  return json;
}

VolumeParameters parameters_from(const Json& json) {
  VolumeParameters parameters;
  if (json.contains("raw")) {
    const Json& raw = json.at("raw");
    parameters.raw = RawLayout{.dims = raw.at("dims"),
                               .type = voxel_type(raw.at("dtype").get<std::string>()),
                               .spacing = vec_from(raw.at("spacing")),
                               .origin = vec_from(raw.at("origin")),
                               .big_endian = raw.at("big_endian")};
  }
  if (json.contains("frame")) parameters.frame = json.at("frame").get<int>();
  if (json.contains("grid")) parameters.grid = json.at("grid");
  return parameters;
}

Json to_json(const ModelRequest& request) {
  const ObjectRule& rule = request.rule;
  Json json{{"volume", request.volume},
            {"inside", rule.side == Side::above ? "above" : "below"},
            {"border", rule.border == Border::closed ? "closed" : "open"}};
  // Adding 0 turns -0 into 0, which means the same.
  switch (rule.kind) {
    case ObjectRule::Kind::threshold: json["threshold"] = rule.lo + 0.0; break;
    case ObjectRule::Kind::range: json["range"] = {rule.lo + 0.0, rule.hi + 0.0}; break;
    case ObjectRule::Kind::labels: json["labels"] = labels_json(rule.labels); break;
  }
  return json;
}

ModelRequest model_request_from_json(const Json& json) {
  ModelRequest request{.volume = json.at("volume"), .rule = {}};
  request.rule.side = json.at("inside") == "above" ? Side::above : Side::below;
  request.rule.border = json.at("border") == "closed" ? Border::closed : Border::open;
  if (json.contains("threshold")) {
    request.rule.lo = json.at("threshold");
  } else if (json.contains("range")) {
    request.rule.kind = ObjectRule::Kind::range;
    request.rule.lo = json.at("range").at(0);
    request.rule.hi = json.at("range").at(1);
  } else {
    request.rule.kind = ObjectRule::Kind::labels;
    for (const Json& label : json.at("labels")) {
      request.rule.labels.push_back(label.is_number_unsigned() ? Label{label.get<std::uint64_t>()}
                                                               : Label{label.get<std::int64_t>()});
    }
  }
  return request;
}

Json to_json(const DerivedRequest& request) {
  Json json{{"model", request.model}};
  if (std::holds_alternative<MeasuresRequest>(request.what)) {
    json["what"] = "measures";
    json["edition"] = kMeasuresEdition;
  }
  if (std::holds_alternative<ContributionsRequest>(request.what)) json["what"] = "contributions";
  if (std::holds_alternative<ChecksRequest>(request.what)) json["what"] = "checks";
  if (const auto* render = std::get_if<RenderRequest>(&request.what)) {
    json["what"] = "render";
    json["edition"] = kPictureEdition;
    for (const auto& [name, text] : render_option_texts(render->options)) json["options"][name] = text;
    if (!render->with.empty()) json["with"] = render->with;
  }
  if (const auto* format = std::get_if<ExportRequest>(&request.what)) {
    json["what"] = "export";
    json["edition"] = kTableEdition;
    json["format"] = name(format->format);
    const SphereListing& listing = format->listing;
    for (const SphereFigure figure : listing.columns) json["columns"].push_back(name(figure));
    if (listing.order == SphereOrder::contribution) json["order"] = name(listing.order);
    if (listing.rows != SphereRows::spheres) json["rows"] = name(listing.rows);
  }
  if (const auto* tree = std::get_if<TreeRequest>(&request.what)) {
    json["what"] = "tree";
    json["levels"] = tree->levels;
  }
  if (const auto* slice = std::get_if<SliceRequest>(&request.what)) {
    json = {{"what", "slice"},     {"edition", kPictureEdition}, {"volume", slice->volume},
            {"axis", slice->axis}, {"index", slice->index},      {"format", media_type(slice->format)}};
    if (slice->object) json["object"] = to_json(ModelRequest{slice->volume, *slice->object});
    for (const auto& [name, text] : slice_option_texts(slice->options)) json["options"][name] = text;
  }
  if (const auto* values = std::get_if<ValuesRequest>(&request.what)) {
    json = {{"what", "histogram"}, {"volume", values->volume}, {"buckets", values->buckets}};
  }
  if (const auto* file = std::get_if<FileRequest>(&request.what)) {
    json["what"] = "file";
    json["edition"] = kFileEdition;
    json["format"] = info(file->format).name;
    for (const auto& [name, text] : file_option_texts(file->format, file->options)) json["options"][name] = text;
  }
  if (request.level > 0) json["level"] = request.level;
  return json;
}

Json to_json(const SimplificationRequest& request) {
  Json json{{"model", request.model}, {"edition", simplify_edition}};
  for (const auto& [name, text] : method_texts(request.method)) json["method"][name] = text;
  return json;
}

SimplificationRequest simplification_request_from_json(const Json& json) {
  OptionTexts texts;
  for (const auto& [name, text] : json.at("method").items()) texts.emplace_back(name, text.get<std::string>());
  return {.model = json.at("model"), .method = parse_method(texts)};
}

Json to_json(const Topology& t) { return {{"betti", t.betti}, {"euler", t.euler_characteristic}}; }
Topology topology_from(const Json& json) {
  return {.betti = json.at("betti"), .euler_characteristic = json.at("euler")};
}

Json to_json(const SimplificationInfo& s) {
  const Achieved& a = s.achieved;
  Json json{{"request", to_json(s.request)},  {"levels", s.levels},           {"nodes", s.nodes},
            {"seconds", s.seconds},           {"spheres", a.spheres},         {"iou", a.iou},
            {"object_mm3", a.object_mm3},     {"covered_mm3", a.covered_mm3}, {"spilled_mm3", a.spilled_mm3},
            {"never_spills", a.never_spills}, {"covers_all", a.covers_all},   {"volume_mm3", a.volume_mm3},
            {"volume_error", a.volume_error}, {"area_mm2", a.area_mm2},       {"area_error", a.area_error},
            {"before", to_json(a.before)},    {"after", to_json(a.after)}};
  if (s.optimality_gap) json["gap"] = *s.optimality_gap;
  if (a.hausdorff) {
    json["hausdorff"] = {a.hausdorff->mm, a.hausdorff->to_spheres, a.hausdorff->to_object, a.hausdorff->of_diagonal};
  }
  return json;
}

SliceRequest slice_from(const Json& json) {
  SliceRequest slice{.volume = json.at("volume"), .axis = json.at("axis"), .index = json.at("index")};
  if (json.contains("object")) slice.object = model_request_from_json(json.at("object")).rule;
  for (const FigureFormat format : {FigureFormat::json, FigureFormat::png, FigureFormat::svg})
    if (json.at("format") == media_type(format)) slice.format = format;
  OptionTexts texts;
  for (const auto& [name, text] : json.at("options").items()) texts.emplace_back(name, text.get<std::string>());
  slice.options = parse_slice_options(texts);
  return slice;
}

SimplificationInfo simplification_from(const Json& json) {
  SimplificationInfo s;
  s.request = simplification_request_from_json(json.at("request"));
  s.levels = json.at("levels");
  s.nodes = json.at("nodes");
  s.seconds = json.at("seconds");
  if (json.contains("gap")) s.optimality_gap = json.at("gap").get<double>();
  Achieved& a = s.achieved;
  a.spheres = json.at("spheres");
  a.iou = json.at("iou");
  a.object_mm3 = json.at("object_mm3");
  a.covered_mm3 = json.at("covered_mm3");
  a.spilled_mm3 = json.at("spilled_mm3");
  a.never_spills = json.at("never_spills");
  a.covers_all = json.at("covers_all");
  a.volume_mm3 = json.at("volume_mm3");
  a.volume_error = json.at("volume_error");
  a.area_mm2 = json.at("area_mm2");
  a.area_error = json.at("area_error");
  a.before = topology_from(json.at("before"));
  a.after = topology_from(json.at("after"));
  if (json.contains("hausdorff")) {
    const Json& h = json.at("hausdorff");
    a.hausdorff = {.mm = h.at(0), .to_spheres = h.at(1), .to_object = h.at(2), .of_diagonal = h.at(3)};
  }
  return s;
}

SphereListing listing_from(const Json& json) {
  SphereListing listing;
  for (const Json& column : json.value("columns", Json::array())) {
    for (const SphereFigure figure : sphere_figures) {
      if (column == name(figure)) listing.columns.push_back(figure);
    }
  }
  if (json.contains("order")) listing.order = SphereOrder::contribution;
  for (const SphereRows rows : {SphereRows::nodes, SphereRows::members}) {
    if (json.value("rows", "") == name(rows)) listing.rows = rows;
  }
  return listing;
}

Json to_json(std::span<const StoredFile> files, bool with_names) {
  Json json = Json::array();
  for (const StoredFile& file : files) {
    json.push_back({{"sha256", file.sha256}, {"bytes", file.bytes}});
    if (with_names) json.back()["name"] = file.name;
  }
  return json;
}

}  // namespace

std::string record_of(const VolumeInfo& v) {
  const Mat3& d = v.grid.direction;
  return write_stored(Json{{"id", v.id},
                           {"created", microseconds(v.created)},
                           {"files", to_json(v.files, true)},
                           {"parameters", to_json(v.parameters)},
                           {"format", v.format},
                           {"dims", v.grid.dims},
                           {"spacing", to_json(v.grid.spacing)},
                           {"origin", to_json(v.grid.origin)},
                           {"direction", {to_json(d.rows[0]), to_json(d.rows[1]), to_json(d.rows[2])}},
                           {"dtype", name(v.type)},
                           {"slope", v.slope},
                           {"intercept", v.intercept},
                           {"range", {v.range.min, v.range.max}},
                           {"not_finite", v.range.not_finite},
                           {"below", v.natural_side == Side::below},
                           {"warnings", v.warnings}});
}

VolumeInfo volume_from(std::string_view record) {
  return read_stored(record, [](const Json& json) {
    VolumeInfo v;
    v.id = json.at("id");
    v.created = time_from(json.at("created"));
    for (const Json& file : json.at("files")) {
      v.files.push_back({.name = file.at("name"), .sha256 = file.at("sha256"), .bytes = file.at("bytes")});
    }
    v.parameters = parameters_from(json.at("parameters"));
    v.format = json.at("format");
    v.grid.dims = json.at("dims");
    v.grid.spacing = vec_from(json.at("spacing"));
    v.grid.origin = vec_from(json.at("origin"));
    for (std::size_t r = 0; r < 3; ++r) v.grid.direction.rows[r] = vec_from(json.at("direction").at(r));
    v.type = voxel_type(json.at("dtype").get<std::string>());
    v.slope = json.at("slope");
    v.intercept = json.at("intercept");
    v.range = {json.at("range").at(0), json.at("range").at(1), json.at("not_finite")};
    v.natural_side = json.at("below").get<bool>() ? Side::below : Side::above;
    v.warnings = json.at("warnings").get<std::vector<std::string>>();
    return v;
  });
}

std::string record_of(const ModelInfo& m) {
  Json json{{"id", m.id},
            {"created", microseconds(m.created)},
            {"algorithm_version", m.algorithm_version},
            {"imported_format", m.imported_format},
            {"boundary_points", m.boundary_points},
            {"tetrahedra", m.tetrahedra},
            {"inside_tetrahedra", m.inside_tetrahedra},
            {"spheres", m.spheres},
            {"density", m.boundary_point_density_mm},
            {"timings", m.timings_s},
            {"warnings", m.warnings}};
  if (m.source) json["source"] = to_json(*m.source);
  if (m.simplification) json["simplification"] = to_json(*m.simplification);
  if (m.voxels) json["voxels"] = {{"count", m.voxels->count}, {"volume", m.voxels->volume_mm3}};
  if (!m.bounds.empty()) json["bounds"] = {to_json(m.bounds.min), to_json(m.bounds.max)};
  return write_stored(json);
}

ModelInfo model_from(std::string_view record) {
  return read_stored(record, [](const Json& json) {
    ModelInfo m;
    m.id = json.at("id");
    m.created = time_from(json.at("created"));
    m.algorithm_version = json.at("algorithm_version");
    m.imported_format = json.at("imported_format");
    m.boundary_points = json.at("boundary_points");
    m.tetrahedra = json.at("tetrahedra");
    m.inside_tetrahedra = json.at("inside_tetrahedra");
    m.spheres = json.at("spheres");
    m.boundary_point_density_mm = json.at("density");
    m.timings_s = json.at("timings").get<std::map<std::string, double>>();
    m.warnings = json.at("warnings").get<std::vector<std::string>>();
    if (json.contains("source")) m.source = model_request_from_json(json.at("source"));
    if (json.contains("simplification")) m.simplification = simplification_from(json.at("simplification"));
    if (json.contains("voxels")) m.voxels = {json.at("voxels").at("count"), json.at("voxels").at("volume")};
    if (json.contains("bounds")) m.bounds = {vec_from(json.at("bounds").at(0)), vec_from(json.at("bounds").at(1))};
    return m;
  });
}

std::string record_of(const DerivedRequest& request) { return to_json(request).dump(); }

DerivedRequest derived_from(std::string_view record) {
  return read_stored(record, [](const Json& json) {
    const std::string what = json.at("what");
    if (what == "slice") return DerivedRequest{.model = {}, .what = slice_from(json)};
    if (what == "histogram") {
      return DerivedRequest{.model = {}, .what = ValuesRequest{json.at("volume"), json.at("buckets")}};
    }
    DerivedRequest request{.model = json.at("model"), .what = {}, .level = json.value("level", 0U)};
    if (what == "measures") {
      request.what = MeasuresRequest{};
    } else if (what == "checks") {
      request.what = ChecksRequest{};
    } else if (what == "contributions") {
      request.what = ContributionsRequest{};
    } else if (what == "render") {
      OptionTexts texts;
      for (const auto& [name, text] : json.at("options").items()) texts.emplace_back(name, text.get<std::string>());
      request.what = RenderRequest{.options = parse_render_options(texts), .with = json.value("with", "")};
    } else if (what == "tree") {
      request.what = TreeRequest{json.at("levels").get<std::vector<std::uint32_t>>()};
    } else if (what == "file") {
      const auto format = file_format(json.at("format").get<std::string>());
      if (!format) throw Error(ErrorCode::corrupt, "The server's record names a format that it does not know.");
      OptionTexts texts;
      if (json.contains("options")) {
        for (const auto& [name, text] : json.at("options").items()) texts.emplace_back(name, text.get<std::string>());
      }
      request.what = FileRequest{.format = *format, .options = parse_file_options(*format, texts)};
    } else {
      ExportRequest wanted;
      for (const SphereFormat format : {SphereFormat::csv, SphereFormat::npy, SphereFormat::ply, SphereFormat::vtp}) {
        if (json.at("format") == name(format)) wanted.format = format;
      }
      wanted.listing = listing_from(json);
      request.what = wanted;
    }
    return request;
  });
}

std::string record_of(std::span<const std::uint64_t> counts) { return Json(counts).dump(); }

std::vector<std::uint64_t> counts_from(std::string_view record) {
  return read_stored(record, [](const Json& json) { return json.get<std::vector<std::uint64_t>>(); });
}

std::string record_of(const ModelRequest& request) { return to_json(request).dump(); }

ModelRequest model_request_from(std::string_view record) { return read_stored(record, model_request_from_json); }

std::string record_of(const SimplificationRequest& request) { return to_json(request).dump(); }

SimplificationRequest simplification_request_from(std::string_view record) {
  return read_stored(record, simplification_request_from_json);
}

std::string identity_of(std::span<const StoredFile> files, const VolumeParameters& parameters) {
  return Json{{"files", to_json(files, files.size() > 1)}, {"parameters", to_json(parameters)}}.dump(
      -1, ' ', false, Json::error_handler_t::replace);
}

std::string identity_of(const ModelRequest& request, const std::string& algorithm_version) {
  return Json{{"algorithm_version", algorithm_version}, {"request", to_json(request)}}.dump();
}

std::string identity_of(const SimplificationRequest& request, const std::string& algorithm_version) {
  return Json{{"algorithm_version", algorithm_version}, {"request", to_json(request)}}.dump();
}

std::string identity_of(const DerivedRequest& request, const std::string& algorithm_version) {
  return Json{{"algorithm_version", algorithm_version}, {"request", to_json(request)}}.dump();
}

std::string identity_of(const StoredFile& file, SphereFormat format, const std::string& algorithm_version) {
  return Json{{"algorithm_version", algorithm_version}, {"imported", file.sha256}, {"format", name(format)}}.dump();
}

}  // namespace spherule::api
