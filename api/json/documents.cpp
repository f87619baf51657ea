// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/documents.h"

#include <algorithm>
#include <charconv>
#include <chrono>
#include <ctime>
#include <nlohmann/json.hpp>

#include "api/http/problem.h"
#include "api/json/parts.h"
#include "api/json/stored_json.h"
#include "api/paths.h"

namespace spherule::api {

namespace {

using Json = json_parts::Ordered;

constexpr const char* kFrame = "LPS";

// Indented for people who read it in a terminal; an array of plain values stays on its line.
void print(const Json& json, const std::string& indent, std::string& out) {
  const bool plain = std::ranges::none_of(json, [](const Json& child) { return child.is_structured(); });
  if (!json.is_structured() || json.empty() || (json.is_array() && plain)) {
    std::string line = json.is_array() ? "[" : json.dump(-1, ' ', false, Json::error_handler_t::replace);
    if (json.is_array()) {
      for (const Json& child : json) {
        line += (line.size() > 1 ? ", " : "") + child.dump(-1, ' ', false, Json::error_handler_t::replace);
      }
      line += "]";
    }
    out += line;
    return;
  }
  const std::string deeper = indent + "  ";
  const char* separator = "\n";
  out += json.is_object() ? "{" : "[";
  for (const auto& [key, child] : json.items()) {
    out += separator + deeper;
    if (json.is_object()) out += Json(key).dump() + ": ";
    print(child, deeper, out);
    separator = ",\n";
  }
  out += "\n" + indent + (json.is_object() ? "}" : "]");
}

std::string text(const Json& json) {
  std::string out;
  print(json, {}, out);
  return out + "\n";
}

// Of an answer that is kept.
std::string stored_text(const Json& json) {
  require_finite(json);
  return text(json);
}

Json triple(Vec3 v) { return json_parts::triple<Json>(v); }
Json matrix(const Mat3& m) { return Json::array({triple(m.rows[0]), triple(m.rows[1]), triple(m.rows[2])}); }

// Row-major, mapping (i, j, k, 1) to (x, y, z, 1).
Json index_to_lps(const Grid& grid) {
  Json rows = Json::array();
  for (int r = 0; r < 3; ++r) {
    const Vec3 axis = grid.direction.rows[static_cast<std::size_t>(r)];
    rows.push_back({axis.x * grid.spacing.x, axis.y * grid.spacing.y, axis.z * grid.spacing.z, grid.origin[r]});
  }
  rows.push_back({0, 0, 0, 1});
  return rows;
}

const char* side_name(Side side) { return side == Side::above ? "above" : "below"; }

Json parameters_json(const VolumeParameters& parameters) {
  Json json = Json::object();
  if (parameters.raw) {
    json["format"] = "raw";
    json["dims"] = parameters.raw->dims;
    json["dtype"] = name(parameters.raw->type);
    json["spacing_mm"] = triple(parameters.raw->spacing);
    json["origin_mm"] = triple(parameters.raw->origin);
    json["endian"] = parameters.raw->big_endian ? "big" : "little";
  }
  if (parameters.frame) json["frame"] = *parameters.frame;
  if (!parameters.grid.empty()) json["grid"] = parameters.grid;
  return json;
}

Json volume_json(const VolumeInfo& volume) {
  const std::string self = "/v1/volumes/" + volume.id;
  Json files = Json::array();
  for (const StoredFile& file : volume.files) files.push_back({{"bytes", file.bytes}, {"sha256", file.sha256}});
  Json json{
      {"id", volume.id},
      {"created", iso_time(volume.created)},
      {"format", volume.format},
      {"dims", volume.grid.dims},
      {"spacing_mm", triple(volume.grid.spacing)},
      {"origin_mm", triple(volume.grid.origin)},
      {"direction", Json::array()},
      {"index_to_lps_mm", index_to_lps(volume.grid)},
      {"dtype", name(volume.type)},
      {"slope", volume.slope},
      {"intercept", volume.intercept},
      {"range", {{"min", volume.range.min}, {"max", volume.range.max}, {"not_finite", volume.range.not_finite}}},
      {"inside_default", side_name(volume.natural_side)},
      {"bytes", volume.bytes()},
      {"files", std::move(files)},
      {"parameters", parameters_json(volume.parameters)},
      {"warnings", volume.warnings},
      {"links",
       {{"self", self}, {"content", self + "/content"}, {"histogram", self + "/histogram"}, {"models", "/v1/models"}}}};
  for (const Vec3& row : volume.grid.direction.rows) json["direction"].push_back(triple(row));
  if (volume.files.size() == 1) json["sha256"] = volume.files.front().sha256;
  return json;
}

Json bounds_json(const Box& box) {
  if (box.empty()) return nullptr;
  return {{"min", triple(box.min)}, {"max", triple(box.max)}};
}

// Words as words, numbers as numbers.
Json method_json(const SimplifyMethod& method) {
  Json json = Json::object();
  for (const auto& [name, text] : method_texts(method)) {
    if (name == "method" || name == "mode" || name == "representative") {
      json[name] = text;
    } else {
      json[name] = Json::parse(name == "buckets" ? "[" + text + "]" : text);
    }
  }
  return json;
}

Json achieved_json(const SimplificationInfo& s) {
  const Achieved& a = s.achieved;
  Json json{{"k", a.spheres},
            {"iou", a.iou},
            {"object_mm3", a.object_mm3},
            {"covered_mm3", a.covered_mm3},
            {"spilled_mm3", a.spilled_mm3},
            {"never_spills", a.never_spills},
            {"covers_all", a.covers_all},
            {"volume_mm3", a.volume_mm3},
            {"volume_error", a.volume_error},
            {"area_mm2", a.area_mm2},
            {"area_error", a.area_error},
            {"hausdorff", nullptr},
            {"betti_before", a.before.betti},
            {"betti_after", a.after.betti}};
  if (a.hausdorff) {
    json["hausdorff"] = {{"mm", a.hausdorff->mm},
                         {"of_diagonal", a.hausdorff->of_diagonal},
                         {"object_to_spheres_mm", a.hausdorff->to_spheres},
                         {"spheres_to_object_mm", a.hausdorff->to_object}};
  }
  if (s.optimality_gap) json["optimality_gap"] = *s.optimality_gap;
  json["seconds"] = s.seconds;
  return json;
}

std::string kind_of(const ModelInfo& model) {
  return model.source ? "raw" : model.simplification ? "simplified" : "imported";
}

Json model_json(const ModelInfo& model) {
  const std::string self = "/v1/models/" + model.id;
  Json json{{"id", model.id},
            {"kind", kind_of(model)},
            {"created", iso_time(model.created)},
            {"algorithm_version", model.algorithm_version}};
  Json counts{{"spheres", model.spheres}};
  Json links{{"self", self},
             {"spheres", self + "/spheres"},
             {"measures", self + "/measures"},
             {"histogram", self + "/histogram"},
             {"render", self + "/render"},
             {"simplifications", self + "/simplifications"},
             {"exports", Json::object()}};
  for (const SphereFormat f : {SphereFormat::csv, SphereFormat::npy, SphereFormat::ply, SphereFormat::vtp}) {
    links["exports"][std::string(name(f))] = self + "/exports/" + std::string(name(f));
  }
  for (std::size_t i = 0; i < file_format_count; ++i) {
    const std::string format(info(static_cast<FileFormat>(i)).name);
    links["exports"][format] = self + "/exports/" + format;
  }
  if (model.source) {
    json["source"] = {{"volume", model.source->volume}};
    json["parameters"] = json_parts::rule<Json>(model.source->rule);
    counts["boundary_points"] = model.boundary_points;
    counts["tetrahedra"] = model.tetrahedra;
    counts["inside_tetrahedra"] = model.inside_tetrahedra;
    links["volume"] = "/v1/volumes/" + model.source->volume;
    links["checks"] = self + "/checks";
  } else if (model.simplification) {
    const SimplificationInfo& s = *model.simplification;
    json["source"] = {{"model", s.request.model}};
    json["parameters"] = method_json(s.request.method);
    counts["levels"] = s.levels;
    counts["nodes"] = s.nodes;
    links["source"] = "/v1/models/" + s.request.model;
    links["tree"] = self + "/tree";
  } else {
    json["source"] = {{"format", model.imported_format}};
    json["parameters"] = Json::object();
  }
  json["counts"] = std::move(counts);
  if (model.source) json["boundary_point_density_mm"] = model.boundary_point_density_mm;
  if (model.simplification) json["achieved"] = achieved_json(*model.simplification);
  json["bounds_mm"] = bounds_json(model.bounds);
  json["frame"] = kFrame;
  json["timings_s"] = model.timings_s;
  json["warnings"] = model.warnings;
  json["links"] = std::move(links);
  return json;
}

// Adds the members that every solid has, in front of its topology.
void put_mass(Json& json, const MassProperties& mass, double area_mm2) {
  json["volume_mm3"] = mass.volume_mm3;
  json["area_mm2"] = area_mm2;
  json["centroid_mm"] = mass.volume_mm3 > 0 ? triple(mass.centroid_mm) : Json(nullptr);
  json["inertia_mm5"] = matrix(mass.inertia_mm5);
  json["principal_moments_mm5"] = mass.principal_moments_mm5;
  json["principal_axes"] = matrix(mass.principal_axes);
}

void put_topology(Json& json, const Topology& topology) {
  json["betti"] = topology.betti;
  json["euler_characteristic"] = topology.euler_characteristic;
}

Json spheres_json(const SpheresMeasures& spheres, bool raw) {
  Json json{
      {"count", spheres.count}, {"radius_min_mm", spheres.radius_min_mm}, {"radius_max_mm", spheres.radius_max_mm}};
  put_mass(json, spheres.mass, spheres.area_mm2);
  json["bounds_mm"] = bounds_json(spheres.bounds);
  put_topology(json, spheres.topology);
  json["topology_method"] =
      raw ? "pieces, tunnels and voids of the inside tetrahedra, exact; those of the balls themselves would depend on "
            "the rounding of radii, which leaves pin-holes where many balls meet in a point"
          : "pieces, tunnels and voids of the union of closed balls, from the dual complex of their power diagram with "
            "exact predicates: tolerance 0, balls that touch are joined";
  json["method"] =
      raw ? "union of the inside circumspheres: the inside tetrahedra plus, beyond each of their boundary "
            "facets, the part of one ball, in closed form; relative error below 1e-9"
          : "union of the balls, each within its cell of the power diagram, in closed form; relative error "
            "about 1e-14 a ball";
  return json;
}

Json tetrahedra_json(const TetrahedraMeasures& t) {
  Json json = Json::object();
  put_mass(json, mass_properties(t.moments), t.area_mm2);
  // The moments' own volume has been through a change of axes.
  json["volume_mm3"] = t.volume_mm3;
  json["boundary_facets"] = t.boundary_facets;
  put_topology(json, t.topology);
  json["topology_method"] =
      "pieces, tunnels and voids of the closed simplicial complex, exact: tolerance 0, pieces that share a corner are "
      "one";
  json["method"] =
      "inside Delaunay tetrahedra: volume and moments summed exactly on the integer lattice; area of the facets "
      "between inside and outside";
  return json;
}

Json marching_cubes_json(const MarchingCubesMeasures& m) {
  return {
      {"volume_mm3", m.volume_mm3},
      {"area_mm2", m.area_mm2},
      {"triangles", m.triangles},
      {"euler_characteristic", m.euler_characteristic},
      {"method",
       "triangle surface through the boundary points, ambiguous faces decided by the saddle of their values; volume "
       "summed exactly on the integer lattice; Euler characteristic of the solid"}};
}

Json observations_json(const Observations& o) {
  const auto with_slack = [](int number, const Observation& seen, const std::string& unit, const char* method) {
    return Json{{"observation", number},
                {"value" + unit, seen.value},
                {"bound" + unit, seen.bound},
                {"slack" + unit, seen.slack()},
                {"method", method}};
  };
  return {
      {"excess_volume",
       with_slack(3, o.excess_volume_mm3, "_mm3",
                  "volume of the spheres beyond that of the tetrahedra; bound: N - 2 balls of the boundary point "
                  "density as radius, with N boundary points")},
      {"boundary_point_density",
       with_slack(5, o.density_mm, "_mm",
                  "largest distance from a boundary point to its nearest other one; bound: the diagonal of a voxel, "
                  "plus one lattice unit for rounding")}};
}

Json sphere_json(const Sphere& sphere, const std::string& method) {
  return {{"centre_mm", triple(sphere.centre)}, {"radius_mm", sphere.radius}, {"method", method}};
}

Json thickness_json(const LocalThickness& t) {
  Json percentiles = Json::object();
  for (std::size_t i = 0; i < t.percentiles_mm.size(); ++i) {
    percentiles["p" + std::to_string(LocalThickness::percents[i])] = t.percentiles_mm[i];
  }
  return {{"mean_mm", t.mean_mm},
          {"sd_mm", t.sd_mm},
          {"min_mm", t.min_mm},
          {"max_mm", t.max_mm},
          {"percentiles_mm", std::move(percentiles)},
          {"histogram", {{"min_mm", t.min_mm}, {"max_mm", t.max_mm}, {"volumes_mm3", t.volumes_mm3}}},
          {"samples", t.samples},
          {"spacing_mm", t.spacing_mm},
          {"sampled_volume_mm3", t.sampled_volume_mm3},
          {"method",
           "at each point of an oblique cubic lattice with about 2^22 points in the union, the diameter of the largest "
           "sphere of the model that holds it; the distance of sampled_volume_mm3 from the union's exact volume shows "
           "the sampling error"}};
}

Json components_json(const std::vector<Component>& components, bool raw) {
  Json items = Json::array();
  for (std::size_t i = 0; i < std::min(components.size(), listed_components); ++i) {
    const Component& c = components[i];
    items.push_back({{"spheres", c.spheres},
                     {"first_sphere", c.first_sphere},
                     {"volume_mm3", c.volume_mm3},
                     {"area_mm2", c.area_mm2},
                     {"bounds_mm", bounds_json(c.bounds)}});
  }
  return {
      {"count", components.size()},
      {"items", std::move(items)},
      {"method", raw ? "spheres whose tetrahedra share a corner are joined; volume and area of their part of the "
                       "union, bounds of their boundary points; the largest first"
                     : "balls that overlap or touch are joined; volume, area and bounds of their union; the largest "
                       "first"}};
}

Json optional_time(const std::optional<Time>& time) { return time ? Json(iso_time(*time)) : Json(nullptr); }

Json job_json(const JobInfo& job) {
  const std::string self = "/v1/jobs/" + job.id;
  Json json{{"id", job.id},
            {"kind", job.kind},
            {"state", name(job.state)},
            {"stage", job.stage},
            {"progress", job.progress},
            {"queue_position", job.queue_position ? Json(*job.queue_position) : Json(nullptr)},
            {"created", iso_time(job.created)},
            {"started", optional_time(job.started)},
            {"finished", optional_time(job.finished)},
            {"elapsed_s", job.elapsed_s},
            {"remaining_s", job.remaining_s ? Json(*job.remaining_s) : Json(nullptr)},
            {"warnings", job.warnings}};
  if (job.state == JobState::failed) {
    const bool told = job.error && job.error->code;
    json["error"] = Json::parse(told ? problem_document(Error(*job.error->code, job.error->sentence), {})
                                     : std::get<std::string>(problem(500, {}).body));
  }
  Json links{{"self", self}, {"events", self + "/events"}};
  if (!is_over(job.state)) links["cancel"] = self + "/cancel";
  if (job.state == JobState::succeeded && job.request) links["result"] = path_of(*job.request, job.result_id);
  json["links"] = std::move(links);
  return json;
}

// As an item of a list.
struct Item {
  Json operator()(const VolumeInfo& volume) const { return volume_json(volume); }
  Json operator()(const ModelInfo& model) const { return model_json(model); }
  Json operator()(const RegistrationInfo& info) const {
    Json item = Json::parse(info.document);
    for (const char* heavy : {"other_poses", "spheres", "pairs"}) item.erase(heavy);
    return item;
  }
};

template <typename T, typename F>
Json list_json(std::string_view what, const Page<T>& page, F&& item) {
  Json items = Json::array();
  for (const T& x : page.items) items.push_back(item(x));
  Json json;
  json[std::string(what)] = std::move(items);
  json["next_cursor"] = page.next.empty() ? Json(nullptr) : Json(page.next);
  if (!page.damaged.empty()) json["damaged"] = page.damaged;
  return json;
}

}  // namespace

std::uint64_t VolumeInfo::bytes() const {
  std::uint64_t sum = 0;
  for (const StoredFile& file : files) sum += file.bytes;
  return sum;
}

std::string document_of(const Thing& thing) {
  struct Visitor {
    std::string operator()(const VolumeInfo& volume) const { return text(volume_json(volume)); }
    std::string operator()(const ModelInfo& model) const { return text(model_json(model)); }
    std::string operator()(const RegistrationInfo& info) const { return info.document; }
  };
  return std::visit(Visitor{}, thing);
}

std::string upload_document(const UploadInfo& upload) {
  const std::string self = "/v1/uploads/" + upload.id;
  Json json{{"id", upload.id},
            {"length", upload.length},
            {"offset", upload.offset},
            {"created", iso_time(upload.created)},
            {"expires", iso_time(upload.expires)},
            {"links", {{"self", self}}}};
  if (upload.offset == upload.length) json["links"]["volume"] = "/v1/volumes?upload=" + upload.id;
  return text(json);
}

std::string stored_volume_document(const Stored<VolumeInfo>& stored) {
  Json json = volume_json(stored.thing);
  json["already_stored"] = stored.already_stored;
  return text(json);
}

std::string job_document(const JobInfo& job) { return text(job_json(job)); }
std::string job_list_document(const Page<JobInfo>& page) { return text(list_json("jobs", page, job_json)); }

std::string list_document(Collection collection, const Page<Thing>& page) {
  const Json json = list_json(name(collection), page, [](const Thing& thing) { return std::visit(Item{}, thing); });
  // Registrations are long, and compact by themselves.
  return collection == Collection::registrations ? json.dump() + "\n" : text(json);
}

std::string sphere_page_document(const std::string& model, const SpherePage& page, std::uint64_t offset) {
  Json columns{"x", "y", "z", "r"};
  for (const SphereColumn& column : page.columns) columns.push_back(column.name);
  Json spheres = Json::array();
  for (std::size_t i = 0; i < page.spheres.size(); ++i) {
    const Sphere& s = page.spheres[i];
    Json row{s.centre.x, s.centre.y, s.centre.z, s.radius};
    for (const SphereColumn& column : page.columns) row.push_back(column.values[i]);
    spheres.push_back(std::move(row));
  }
  Json json{{"model", model},
            {"frame", kFrame},
            {"unit", "mm"},
            {"columns", std::move(columns)},
            {"total", page.total},
            {"offset", offset},
            {"spheres", std::move(spheres)}};
  if (page.members) json["members"] = *page.members;
  json["links"] = {{"model", "/v1/models/" + model}};
  // Compact: a page can hold many thousands of rows.
  return json.dump() + "\n";
}

std::string value_histogram_document(const VolumeInfo& volume, std::span<const std::uint64_t> counts) {
  return text({{"volume", volume.id},
               {"min", volume.range.min},
               {"max", volume.range.max},
               {"not_finite", volume.range.not_finite},
               {"counts", std::vector<std::uint64_t>(counts.begin(), counts.end())}});
}

std::string radius_histogram_document(const std::string& model, const RadiusHistogram& histogram) {
  const bool logarithmic = histogram.scale == RadiusScale::logarithmic;
  Json json{{"model", model},
            {"unit", "mm"},
            {"scale", logarithmic ? "log" : "linear"},
            {"min_mm", histogram.min_mm},
            {"max_mm", histogram.max_mm},
            {"counts", histogram.counts}};
  if (logarithmic) json["zero_radius"] = histogram.zero_radius;
  return text(json);
}

std::string measures_document(const std::string& model, const ModelMeasures& measures) {
  const bool raw = measures.tetrahedra.has_value();
  Json json{{"model", model}, {"spheres", spheres_json(measures.spheres, raw)}};
  if (measures.tetrahedra) json["tetrahedra"] = tetrahedra_json(*measures.tetrahedra);
  if (measures.marching_cubes) json["marching_cubes"] = marching_cubes_json(*measures.marching_cubes);
  if (measures.voxels) {
    json["voxels"] = {{"count", measures.voxels->count},
                      {"volume_mm3", measures.voxels->volume_mm3},
                      {"method", "number of inside samples times the volume of one voxel"}};
  }
  if (measures.observations) json["observations"] = observations_json(*measures.observations);
  json["smallest_enclosing_sphere"] =
      sphere_json(measures.smallest_enclosing,
                  "smallest ball around all balls, in double arithmetic: never too small, and larger than the least by "
                  "no more than rounding");
  json["largest_inscribed_sphere"] =
      sphere_json(measures.largest_inscribed,
                  raw ? "largest inside circumsphere: by the empty-sphere property the largest ball centred inside the "
                        "object that holds no boundary point"
                  : measures.spheres.count <= largest_inscribed_limit
                      ? "largest ball within the union, to a relative 1e-9, by the Voronoi vertices of its corners"
                      : "largest member, as there are more than " + std::to_string(largest_inscribed_limit) +
                            ": the union may hold a larger ball that spans several members");
  json["local_thickness"] = thickness_json(measures.thickness);
  json["components"] = components_json(measures.components, raw);
  json["units"] = {{"length", "mm"}, {"area", "mm2"}, {"volume", "mm3"}, {"inertia", "mm5, for density 1 per mm3"}};
  json["frame"] = kFrame;
  json["links"] = {{"model", "/v1/models/" + model},
                   {"ranking", "/v1/models/" + model + "/spheres?order=contribution"}};
  return stored_text(json);
}

std::string with_components(std::string_view measures_document, std::size_t count) {
  Json json = Json::parse(measures_document);
  Json& items = json.at("components").at("items");
  if (items.size() > count) items.erase(items.begin() + static_cast<std::ptrdiff_t>(count), items.end());
  return text(json);
}

std::string tree_document(const std::string& model, const std::string& source, std::span<const std::uint32_t> levels,
                          std::span<const TreeLevel> tree, const MemberLists& members) {
  Json items = Json::array();
  for (std::size_t l = 0; l < tree.size(); ++l) {
    Json spheres = Json::array(), parents = Json::array();
    for (const Sphere& s : tree[l].spheres) spheres.push_back({s.centre.x, s.centre.y, s.centre.z, s.radius});
    for (const std::uint32_t p : tree[l].parents) parents.push_back(p == no_parent ? Json(nullptr) : Json(p));
    items.push_back({{"level", levels[l]}, {"spheres", std::move(spheres)}, {"parents", std::move(parents)}});
  }
  Json lists = Json::array();
  for (std::size_t i = 0; i < members.count(); ++i) {
    const auto list = members.of(i);
    lists.push_back(std::vector<std::uint32_t>(list.begin(), list.end()));
  }
  const std::string self = "/v1/models/";
  return write_stored(Json{{"model", model},
                           {"source", source},
                           {"frame", kFrame},
                           {"unit", "mm"},
                           {"columns", {"x", "y", "z", "r"}},
                           {"levels", std::move(items)},
                           {"members", std::move(lists)},
                           {"links", {{"model", self + model}, {"source", self + source}}}}) +
         "\n";
}

std::string checks_document(const std::string& model, const ModelChecks& checks) {
  const CriteriaReport& c = checks.criteria;
  const BoundsReport& b = checks.bounds;
  return stored_text({{"model", model},
                      {"violations", c.violations()},
                      {"criteria",
                       {{"inside_samples_not_covered", c.inside_samples_not_covered},
                        {"outside_samples_covered", c.outside_samples_covered},
                        {"boundary_points_inside_balls", c.boundary_points_inside_balls},
                        {"boundary_points_on_no_ball", c.boundary_points_on_no_ball}}},
                      {"bounds",
                       {{"density_mm", b.density_mm},
                        {"density_bound_mm", b.density_bound_mm},
                        {"density_holds", b.density_mm <= b.density_bound_mm},
                        {"cells_per_point", b.cells_per_point},
                        {"tetrahedra_volume_mm3", b.tetrahedra_volume_mm3},
                        {"spheres_volume_bound_mm3", b.spheres_volume_bound_mm3}}},
                      {"links", {{"model", "/v1/models/" + model}}}});
}

namespace {

// Rows of numbers, written straight into the text: a slice may have a million.
template <typename Range, typename Row>
void append_rows(std::string& out, std::string_view name, const Range& range, Row row) {
  out += ",\n  \"" + std::string(name) + "\": [";
  const char* before = "\n    [";
  for (const auto& item : range) {
    out += before;
    const char* comma = "";
    for (const auto number : row(item)) {
      std::array<char, 32> digits;
      out += comma;
      out.append(digits.data(), std::to_chars(digits.data(), digits.data() + digits.size(), number).ptr);
      comma = ", ";
    }
    out += ']';
    before = ",\n    [";
  }
  out += std::ranges::empty(range) ? "]" : "\n  ]";
}

}  // namespace

std::string slice_document(const std::string& volume, const SliceRequest& request, const Grid& slice,
                           const PlaneModel* model) {
  const SlicePlane plane = plane_of(slice);
  const std::array<std::string, 2> axes{request.axis == 0 ? "j" : "i", request.axis == 2 ? "j" : "k"};
  const std::size_t across = plane.across == 0 ? 0 : 1;
  const std::array<Vec3, 2> steps{slice.spacing.x * slice.direction.column(0),
                                  slice.spacing.y * slice.direction.column(1)};
  Json json{{"volume", volume},
            {"axis", std::string(1, "ijk"[request.axis])},
            {"index", request.index},
            {"plane", plane.name},
            {"origin", triple(slice.origin)},
            {"axes",
             {{{"axis", axes[0]}, {"samples", slice.dims[0]}, {"step", triple(steps[0])}},
              {{"axis", axes[1]}, {"samples", slice.dims[1]}, {"step", triple(steps[1])}}}},
            {"picture",
             {{"across", axes[across]},
              {"left", plane.left},
              {"right", plane.right},
              {"top", plane.top},
              {"bottom", plane.bottom}}},
            {"links",
             {{"self", path_of(DerivedRequest{.source = volume, .what = request}, {})},
              {"volume", "/v1/volumes/" + volume}}}};
  if (model == nullptr) return stored_text(json);
  json["object"] = json_parts::rule<Json>(*request.object);
  json["inside_samples"] = model->inside_samples;
  json["area_mm2"] = model->area_mm2;
  json["inside_triangles"] = model->inside_count;
  std::string out = stored_text(json);
  out.erase(out.rfind('}'));
  while (out.back() == '\n' || out.back() == ' ') out.pop_back();
  append_rows(out, "boundary_points", model->points, [&](LatticePoint p) {
    const Vec3 at = model->lattice.to_patient(p);
    return std::array{at.x + 0.0, at.y + 0.0, at.z + 0.0};
  });
  append_rows(out, "contour", model->contour, [](const auto& edge) { return edge; });
  append_rows(out, "triangles", model->triangles, [](const auto& triangle) { return triangle; });
  append_rows(out, "circles", model->circles, [](const Sphere& c) {
    return std::array{c.centre.x + 0.0, c.centre.y + 0.0, c.centre.z + 0.0, c.radius};
  });
  return out + "\n}\n";
}

std::string about_document(const About& about) {
  return text({{"version", about.version}, {"algorithm_version", about.algorithm_version}, {"api", "v1"}});
}

std::string status_document(std::string_view status) { return text({{"status", status}}); }

std::string event_data(const JobEvent& event) {
  Json json{{"state", name(event.state)}};
  if (!event.stage.empty()) json["stage"] = event.stage;
  if (event.type != JobEvent::Type::warning) json["progress"] = event.progress;
  if (!event.warning.empty()) json["warning"] = event.warning;
  return json.dump(-1, ' ', false, Json::error_handler_t::replace);
}

std::string_view name(JobState state) {
  constexpr std::array<std::string_view, 6> names = {"queued",    "running", "cancelling",
                                                     "succeeded", "failed",  "cancelled"};
  return names[static_cast<std::size_t>(state)];
}

std::string iso_time(Time time) {
  const auto ms = std::chrono::floor<std::chrono::milliseconds>(time);
  const auto s = std::chrono::floor<std::chrono::seconds>(ms);
  const std::time_t t = std::chrono::system_clock::to_time_t(std::chrono::system_clock::time_point(s));
  std::tm utc{};
  gmtime_r(&t, &utc);
  std::array<char, 40> second{};
  std::strftime(second.data(), second.size(), "%Y-%m-%dT%H:%M:%S.", &utc);
  const std::string fraction = std::to_string(1000 + (ms - s).count());
  return second.data() + fraction.substr(1) + "Z";
}

std::string_view name(Collection collection) {
  constexpr std::array<std::string_view, 3> names = {"volumes", "models", "registrations"};
  return names[static_cast<std::size_t>(collection)];
}

}  // namespace spherule::api
