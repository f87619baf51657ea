// SPDX-License-Identifier: GPL-3.0-or-later
//
// Values that several documents and records have in them, as JSON. Templates where both orders of members are wanted:
// that of the text, for people, and the canonical one.
#pragma once

#include <nlohmann/json.hpp>
#include <span>
#include <string_view>

#include "api/json/label_json.h"
#include "api/things.h"
#include "api/work.h"

namespace spherule::api {

/// "rigid", "similarity", "affine".
std::string_view name(TransformKind kind);
/// "global", "matching".
std::string_view name(RegistrationMethod method);

}  // namespace spherule::api

namespace spherule::api::json_parts {

/// Members ascend, which with dump() is the canonical form.
using Json = nlohmann::json;
using Ordered = nlohmann::ordered_json;

/// [x, y, z].
template <typename AnyJson>
AnyJson triple(Vec3 v) {
  return AnyJson::array({v.x, v.y, v.z});
}
/// What triple() gives.
Vec3 triple_from(const Json& json);

/// Its threshold, range or labels, and inside and border.
template <typename AnyJson>
AnyJson rule(const ObjectRule& rule) {
  AnyJson json = AnyJson::object();
  // Adding 0 turns -0 into 0, which means the same.
  switch (rule.kind) {
    case ObjectRule::Kind::threshold: json["threshold"] = rule.lo + 0.0; break;
    case ObjectRule::Kind::range: json["range"] = {rule.lo + 0.0, rule.hi + 0.0}; break;
    case ObjectRule::Kind::labels: json["labels"] = labels_json(rule.labels); break;
  }
  json["inside"] = rule.side == Side::above ? "above" : "below";
  json["border"] = rule.border == Border::closed ? "closed" : "open";
  return json;
}
/// What rule() gives.
ObjectRule rule_from(const Json& json);

/// Of a registration.
template <typename AnyJson>
AnyJson parameters(const RegistrationRequest& request) {
  const RegistrationOptions& o = request.options;
  return {{"fixed", request.fixed},
          {"moving", request.moving},
          {"transform", name(o.transform)},
          {"method", name(o.method)},
          {"k", o.k},
          {"inits", o.inits},
          {"scale_bounds", {o.min_scale, o.max_scale}},
          {"weights",
           {{"position", o.weights.position},
            {"size", o.weights.size},
            {"shape", o.weights.shape},
            {"alone", o.weights.alone}}},
          {"refine", o.refine},
          {"seed", o.seed}};
}

/// Of a volume, as its id has them.
Json parameters(const VolumeParameters& parameters);
VolumeParameters parameters_from(const Json& json);

/// Their digests and sizes.
Json files(std::span<const StoredFile> files, bool with_names);

/// As in json/work.h.
Json request(const WorkRequest& request);
WorkRequest request_from(std::string_view kind, const Json& json);

}  // namespace spherule::api::json_parts
