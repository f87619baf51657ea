// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/parts.h"

namespace spherule::api {

std::string_view name(TransformKind kind) {
  return kind == TransformKind::rigid ? "rigid" : kind == TransformKind::similarity ? "similarity" : "affine";
}
std::string_view name(RegistrationMethod method) {
  return method == RegistrationMethod::global ? "global" : "matching";
}

}  // namespace spherule::api

namespace spherule::api::json_parts {

Vec3 triple_from(const Json& json) { return {json.at(0), json.at(1), json.at(2)}; }

ObjectRule rule_from(const Json& json) {
  ObjectRule rule;
  rule.side = json.at("inside") == "above" ? Side::above : Side::below;
  rule.border = json.at("border") == "closed" ? Border::closed : Border::open;
  if (json.contains("threshold")) {
    rule.lo = json.at("threshold");
  } else if (json.contains("range")) {
    rule.kind = ObjectRule::Kind::range;
    rule.lo = json.at("range").at(0);
    rule.hi = json.at("range").at(1);
  } else {
    rule.kind = ObjectRule::Kind::labels;
    for (const Json& label : json.at("labels")) {
      rule.labels.push_back(label.is_number_unsigned() ? Label{label.get<std::uint64_t>()}
                                                       : Label{label.get<std::int64_t>()});
    }
  }
  return rule;
}

Json parameters(const VolumeParameters& parameters) {
  Json json = Json::object();
  if (parameters.raw) {
    json["raw"] = {{"dims", parameters.raw->dims},
                   {"dtype", name(parameters.raw->type)},
                   {"spacing", triple<Json>(parameters.raw->spacing)},
                   {"origin", triple<Json>(parameters.raw->origin)},
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
                               .spacing = triple_from(raw.at("spacing")),
                               .origin = triple_from(raw.at("origin")),
                               .big_endian = raw.at("big_endian")};
  }
  if (json.contains("frame")) parameters.frame = json.at("frame").get<int>();
  if (json.contains("grid")) parameters.grid = json.at("grid");
  return parameters;
}

Json files(std::span<const StoredFile> files, bool with_names) {
  Json json = Json::array();
  for (const StoredFile& file : files) {
    json.push_back({{"sha256", file.sha256}, {"bytes", file.bytes}});
    if (with_names) json.back()["name"] = file.name;
  }
  return json;
}

}  // namespace spherule::api::json_parts
