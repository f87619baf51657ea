// SPDX-License-Identifier: GPL-3.0-or-later
//
// Each kind of thing is described once, by a template over its form: the same list of members is written and read.
#include "api/json/records.h"

#include <limits>
#include <nlohmann/json.hpp>
#include <type_traits>
#include <utility>

#include "api/json/parts.h"
#include "api/json/stored_json.h"

namespace spherule::api {

namespace {

using json_parts::Json;

// How a kind of value is written and read, where the library does not know it.

template <typename T>
Json written(const T& value) {
  return value;
}
template <typename T>
void read(const Json& json, T& value) {
  json.get_to(value);
}

Json written(Time time) { return time.time_since_epoch().count(); }
void read(const Json& json, Time& time) {
  // Counted in nanoseconds it must fit 64 bits.
  constexpr std::int64_t latest = std::numeric_limits<std::int64_t>::max() / 1000;
  const auto microseconds = json.get<std::int64_t>();
  if (microseconds < -latest || microseconds > latest) throw Error(ErrorCode::corrupt, "This is no time.");
  time = Time(std::chrono::microseconds(microseconds));
}

Json written(Vec3 v) { return json_parts::triple<Json>(v); }
void read(const Json& json, Vec3& v) { v = json_parts::triple_from(json); }

Json written(const Mat3& m) { return {written(m.rows[0]), written(m.rows[1]), written(m.rows[2])}; }
void read(const Json& json, Mat3& m) {
  for (std::size_t r = 0; r < 3; ++r) read(json.at(r), m.rows[r]);
}

Json written(const Box& box) { return {written(box.min), written(box.max)}; }
void read(const Json& json, Box& box) {
  read(json.at(0), box.min);
  read(json.at(1), box.max);
}

Json written(VoxelType type) { return name(type); }
void read(const Json& json, VoxelType& type) { type = voxel_type(json.get<std::string>()); }

// Of the range alone; how many values are not finite is a member of its own.
Json written(const ValueRange& range) { return {range.min, range.max}; }
void read(const Json& json, ValueRange& range) {
  range.min = json.at(0);
  range.max = json.at(1);
}

// As the answer to whether it is below.
Json written(Side side) { return side == Side::below; }
void read(const Json& json, Side& side) { side = json.get<bool>() ? Side::below : Side::above; }

Json written(const std::vector<StoredFile>& files) { return json_parts::files(files, true); }
void read(const Json& json, std::vector<StoredFile>& files) {
  for (const Json& file : json)
    files.push_back({.name = file.at("name"), .sha256 = file.at("sha256"), .bytes = file.at("bytes")});
}

Json written(const VolumeParameters& parameters) { return json_parts::parameters(parameters); }
void read(const Json& json, VolumeParameters& parameters) { parameters = json_parts::parameters_from(json); }

Json written(const ModelRequest& request) { return json_parts::request(request); }
void read(const Json& json, ModelRequest& request) {
  request = std::get<ModelRequest>(json_parts::request_from("model", json));
}

Json written(const SimplificationRequest& request) { return json_parts::request(request); }
void read(const Json& json, SimplificationRequest& request) {
  request = std::get<SimplificationRequest>(json_parts::request_from("simplification", json));
}

Json written(const Topology& t) { return {{"betti", t.betti}, {"euler", t.euler_characteristic}}; }
void read(const Json& json, Topology& t) { t = {.betti = json.at("betti"), .euler_characteristic = json.at("euler")}; }

Json written(const VoxelMeasures& v) { return {{"count", v.count}, {"volume", v.volume_mm3}}; }
void read(const Json& json, VoxelMeasures& v) { v = {json.at("count"), json.at("volume")}; }

Json written(const Achieved::Hausdorff& h) { return {h.mm, h.to_spheres, h.to_object, h.of_diagonal}; }
void read(const Json& json, Achieved::Hausdorff& h) {
  h = {.mm = json.at(0), .to_spheres = json.at(1), .to_object = json.at(2), .of_diagonal = json.at(3)};
}

// What is not there has no member.
template <typename T>
bool is_absent(const T&) {
  return false;
}
bool is_absent(const Box& box) { return box.empty(); }

class Writer;
class Reader;
template <typename T>
Json described(const T& value);
template <typename T>
void read_described(const Json& json, T& value);

Json written(const SimplificationInfo& s) { return described(s); }
void read(const Json& json, SimplificationInfo& s) { read_described(json, s); }

class Writer {
 public:
  explicit Writer(Json& json) : json_(json) {}
  template <typename T>
  void operator()(const char* name, const T& value) {
    if (!is_absent(value)) json_[name] = written(value);
  }
  template <typename T>
  void operator()(const char* name, const std::optional<T>& value) {
    if (value) (*this)(name, *value);
  }

 private:
  Json& json_;
};

class Reader {
 public:
  explicit Reader(const Json& json) : json_(json) {}
  template <typename T>
  void operator()(const char* name, T& value) {
    if (json_.contains(name) || !is_absent(T{})) read(json_.at(name), value);
  }
  template <typename T>
  void operator()(const char* name, std::optional<T>& value) {
    if (!json_.contains(name)) return;
    T member{};
    read(json_.at(name), member);
    value = std::move(member);
  }

 private:
  const Json& json_;
};

template <typename Form, typename Volume>
requires std::is_same_v<std::remove_const_t<Volume>, VolumeInfo>
void describe(Form&& form, Volume& v) {
  form("id", v.id);
  form("created", v.created);
  form("files", v.files);
  form("parameters", v.parameters);
  form("format", v.format);
  form("dims", v.grid.dims);
  form("spacing", v.grid.spacing);
  form("origin", v.grid.origin);
  form("direction", v.grid.direction);
  form("dtype", v.type);
  form("slope", v.slope);
  form("intercept", v.intercept);
  form("range", v.range);
  form("not_finite", v.range.not_finite);
  form("below", v.natural_side);
  form("warnings", v.warnings);
}

template <typename Form, typename Info>
requires std::is_same_v<std::remove_const_t<Info>, SimplificationInfo>
void describe(Form&& form, Info& s) {
  form("request", s.request);
  form("levels", s.levels);
  form("nodes", s.nodes);
  form("seconds", s.seconds);
  form("gap", s.optimality_gap);
  auto& a = s.achieved;
  form("spheres", a.spheres);
  form("iou", a.iou);
  form("object_mm3", a.object_mm3);
  form("covered_mm3", a.covered_mm3);
  form("spilled_mm3", a.spilled_mm3);
  form("never_spills", a.never_spills);
  form("covers_all", a.covers_all);
  form("volume_mm3", a.volume_mm3);
  form("volume_error", a.volume_error);
  form("area_mm2", a.area_mm2);
  form("area_error", a.area_error);
  form("hausdorff", a.hausdorff);
  form("before", a.before);
  form("after", a.after);
}

template <typename Form, typename Model>
requires std::is_same_v<std::remove_const_t<Model>, ModelInfo>
void describe(Form&& form, Model& m) {
  form("id", m.id);
  form("created", m.created);
  form("algorithm_version", m.algorithm_version);
  form("source", m.source);
  form("simplification", m.simplification);
  form("imported_format", m.imported_format);
  form("boundary_points", m.boundary_points);
  form("tetrahedra", m.tetrahedra);
  form("inside_tetrahedra", m.inside_tetrahedra);
  form("spheres", m.spheres);
  form("density", m.boundary_point_density_mm);
  form("voxels", m.voxels);
  form("bounds", m.bounds);
  form("timings", m.timings_s);
  form("warnings", m.warnings);
}

template <typename T>
Json described(const T& value) {
  Json json = Json::object();
  describe(Writer(json), value);
  return json;
}

template <typename T>
void read_described(const Json& json, T& value) {
  describe(Reader(json), value);
}

template <typename T>
T from_record(std::string_view record) {
  return read_stored(record, [](const Json& json) {
    T value;
    read_described(json, value);
    return value;
  });
}

}  // namespace

std::string record_of(const VolumeInfo& volume) { return write_stored(described(volume)); }
VolumeInfo volume_from(std::string_view record) { return from_record<VolumeInfo>(record); }

std::string record_of(const ModelInfo& model) { return write_stored(described(model)); }
ModelInfo model_from(std::string_view record) { return from_record<ModelInfo>(record); }

std::string record_of(std::span<const std::uint64_t> counts) { return Json(counts).dump(); }
std::vector<std::uint64_t> counts_from(std::string_view record) {
  return read_stored(record, [](const Json& json) { return json.get<std::vector<std::uint64_t>>(); });
}

}  // namespace spherule::api
