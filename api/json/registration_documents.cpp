// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/registration_documents.h"

#include <nlohmann/json.hpp>

#include "api/json/documents.h"
#include "api/json/parts.h"
#include "api/json/stored_json.h"
#include "api/json/work.h"

namespace spherule::api {

namespace {

using json_parts::Json;
using json_parts::Ordered;

Ordered triple(Vec3 v) { return json_parts::triple<Ordered>(v); }
Ordered matrix(const AffineMap& m) {
  Ordered rows = Ordered::array();
  for (int r = 0; r < 3; ++r) {
    const Vec3 row = m.linear.rows[static_cast<std::size_t>(r)];
    rows.push_back({row.x, row.y, row.z, m.shift[r]});
  }
  rows.push_back({0, 0, 0, 1});
  return rows;
}
AffineMap map_from(const Json& rows) {
  AffineMap map;
  for (std::size_t r = 0; r < 3; ++r) {
    map.linear.rows[r] = {rows.at(r).at(0), rows.at(r).at(1), rows.at(r).at(2)};
    map.shift[static_cast<int>(r)] = rows.at(r).at(3);
  }
  return map;
}
Ordered spheres_json(std::span<const Sphere> spheres) {
  Ordered rows = Ordered::array();
  for (const Sphere& s : spheres) rows.push_back({s.centre.x, s.centre.y, s.centre.z, s.radius});
  return rows;
}
std::vector<Sphere> spheres_from(const Json& rows) {
  std::vector<Sphere> spheres;
  for (const Json& row : rows) spheres.push_back({{row.at(0), row.at(1), row.at(2)}, row.at(3)});
  return spheres;
}
Ordered overlap_json(const UnionOverlap& overlap) {
  return {{"dice", overlap.dice}, {"iou", overlap.iou}, {"method", overlap.exact ? "exact" : "samples"}};
}

}  // namespace

std::string registration_document(const std::string& id, Time created, const std::string& algorithm_version,
                                  const RegistrationRequest& request, const Registration& found) {
  const AffineMap& map = found.moving_to_fixed;
  const Decomposition parts = decompose(map, found.centre);
  const Quaternion& q = parts.quaternion;
  Ordered pairs = Ordered::array(), others = Ordered::array(), seconds = Ordered::object();
  for (const SpherePair& p : found.pairs) pairs.push_back({p.moving, p.fixed});
  for (const FoundPose& pose : found.others) {
    others.push_back({{"moving_to_fixed", matrix(pose.moving_to_fixed)},
                      {"agreement", pose.surfaces.agreement},
                      {"mean_mm", pose.surfaces.mean_mm},
                      {"p95_mm", pose.surfaces.p95_mm}});
  }
  for (const StageTime& time : found.timings) seconds[time.stage] = time.seconds;
  const std::string path = "/v1/registrations/" + id;
  const Ordered json{
      {"id", id},
      {"created", iso_time(created)},
      {"algorithm_version", algorithm_version},
      {"parameters", json_parts::parameters<Ordered>(request)},
      {"frame", "LPS"},
      {"unit", "mm"},
      {"moving_to_fixed", matrix(map)},
      {"fixed_to_moving", matrix(inverse(map))},
      {"decomposition",
       {{"centre", triple(parts.centre)},
        {"translation", triple(parts.translation)},
        {"quaternion_wxyz", {q.w, q.x, q.y, q.z}},
        {"axis", triple(parts.axis)},
        {"angle_deg", parts.angle_deg},
        {"euler_xyz_deg", triple(parts.euler_xyz_deg)},
        {"scale", scale_of(map)},
        {"scales", triple(parts.scales)},
        {"shear_xy_xz_yz", triple(parts.shear)}}},
      {"quality",
       {{"poor", found.poor},
        {"overlap", overlap_json(found.overlap)},
        {"spheres_overlap", overlap_json(found.spheres_overlap)},
        {"surface_distance",
         {{"mean_mm", found.surfaces.mean_mm},
          {"p95_mm", found.surfaces.p95_mm},
          {"within_mm", found.reach_mm},
          {"fixed_within", found.surfaces.fixed_within},
          {"moving_within", found.surfaces.moving_within},
          {"agreement", found.surfaces.agreement}}},
        {"matched_share", found.matched_share},
        {"residual_rms_mm", found.residual_rms_mm},
        {"radius_ratio", found.radius_ratio}}},
      {"other_poses", std::move(others)},
      {"spheres", {{"fixed", spheres_json(found.fixed_spheres)}, {"moving", spheres_json(found.moving_spheres)}}},
      {"pairs", std::move(pairs)},
      {"seconds", std::move(seconds)},
      {"warnings", found.warnings},
      {"links",
       {{"self", path},
        {"fixed", "/v1/models/" + request.fixed},
        {"moving", "/v1/models/" + request.moving},
        {"itk", path + "?format=itk"},
        {"render", path + "/render"},
        {"apply", path + "/apply"}}}};
  return write_stored(json) + "\n";
}

RegistrationInfo registration_from(std::string_view document, std::string_view request_record) {
  RegistrationInfo info = read_stored(document, [&](const Json& json) {
    return RegistrationInfo{.id = json.at("id"),
                            .request = {},
                            .moving_to_fixed = map_from(json.at("moving_to_fixed")),
                            .fixed_spheres = spheres_from(json.at("spheres").at("fixed")),
                            .moving_spheres = spheres_from(json.at("spheres").at("moving")),
                            .document = std::string(document)};
  });
  info.request = std::get<RegistrationRequest>(work_from("registration", request_record));
  return info;
}

}  // namespace spherule::api
