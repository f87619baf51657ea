// SPDX-License-Identifier: GPL-3.0-or-later
#include <gtest/gtest.h>

#include <limits>

#include "api/json/documents.h"
#include "api/json/records.h"
#include "core/base/error.h"
#include "tests/api/stub.h"

namespace spherule::test {
namespace {

using namespace api;

TEST(Records, OfVolumesReadBack) {
  VolumeInfo v = StubService::volume_info();
  v.parameters.raw.emplace();
  v.parameters.raw->dims = {1, 2, 3};
  v.parameters.raw->type = VoxelType::float64;
  v.parameters.raw->spacing = {0.1, 0.2, 0.3};
  v.parameters.raw->big_endian = true;
  v.parameters.frame = 4;
  v.parameters.grid = "dichte";
  v.grid.direction.rows[0] = {0.6, -0.8, 0};
  v.slope = 1.0 / 3;
  const VolumeInfo w = volume_from(record_of(v));
  EXPECT_EQ(record_of(w), record_of(v));
  EXPECT_EQ(w.created, v.created);
  EXPECT_EQ(w.files[1].name, "Doe^Jane.img");
  EXPECT_EQ(w.grid.direction, v.grid.direction);
  EXPECT_EQ(w.slope, v.slope);
  EXPECT_EQ(w.natural_side, Side::below);
  EXPECT_EQ(w.parameters.raw->type, VoxelType::float64);
  EXPECT_TRUE(w.parameters.raw->big_endian);
}

// The bindings name every member: a new one does not compile until it is told of here, with a value of its own.
TEST(Records, LoseNoMember) {
  VolumeInfo v = StubService::volume_info();
  v.format = "nrrd";
  v.slope = 2;
  v.intercept = -3;
  v.range = {-1.5, 255, 7};
  const VolumeInfo w = volume_from(record_of(v));
  const auto& [id, created, files, parameters, format, grid, type, slope, intercept, range, side, warnings] = w;
  EXPECT_EQ(id, v.id);
  EXPECT_EQ(created, v.created);
  ASSERT_EQ(files.size(), v.files.size());
  for (std::size_t i = 0; i < files.size(); ++i) {
    const auto& [name, sha256, bytes] = files[i];
    EXPECT_EQ(name, v.files[i].name);
    EXPECT_EQ(sha256, v.files[i].sha256);
    EXPECT_EQ(bytes, v.files[i].bytes);
  }
  const auto& [raw, frame, name_of_grid] = parameters;
  EXPECT_FALSE(raw || frame || !name_of_grid.empty());
  EXPECT_EQ(format, v.format);
  const auto& [dims, spacing, origin, direction] = grid;
  EXPECT_EQ(dims, v.grid.dims);
  EXPECT_EQ(spacing, v.grid.spacing);
  EXPECT_EQ(origin, v.grid.origin);
  EXPECT_EQ(direction, v.grid.direction);
  EXPECT_EQ(type, v.type);
  EXPECT_EQ(slope, v.slope);
  EXPECT_EQ(intercept, v.intercept);
  const auto& [least, most, not_finite] = range;
  EXPECT_EQ(least, v.range.min);
  EXPECT_EQ(most, v.range.max);
  EXPECT_EQ(not_finite, v.range.not_finite);
  EXPECT_EQ(side, v.natural_side);
  EXPECT_EQ(warnings, v.warnings);
}

TEST(Records, LoseNoMemberOfAModel) {
  ModelInfo m = StubService::model_info();
  m.simplification = StubService::simplified_info().simplification;  // never both; here they do not disturb each other
  m.imported_format = "npy";
  m.warnings = {"A sentence."};
  Achieved& a = m.simplification->achieved;
  a = {.spheres = 3,
       .iou = 0.1,
       .object_mm3 = 2,
       .covered_mm3 = 3,
       .spilled_mm3 = 4,
       .never_spills = true,
       .covers_all = true,
       .volume_mm3 = 5,
       .volume_error = 6,
       .area_mm2 = 7,
       .area_error = 8,
       .hausdorff = Achieved::Hausdorff{1, 2, 3, 4},
       .before = {{1, 2, 3}, 4},
       .after = {{5, 6, 7}, 8}};
  const ModelInfo n = model_from(record_of(m));
  const auto& [id, created, version, source, simplification, imported, points, cells, inside, spheres, density, voxels,
               bounds, timings, warnings] = n;
  EXPECT_EQ(id, m.id);
  EXPECT_EQ(created, m.created);
  EXPECT_EQ(version, m.algorithm_version);
  EXPECT_EQ(source->volume, m.source->volume);
  EXPECT_EQ(source->rule, m.source->rule);
  EXPECT_EQ(imported, m.imported_format);
  EXPECT_EQ(points, m.boundary_points);
  EXPECT_EQ(cells, m.tetrahedra);
  EXPECT_EQ(inside, m.inside_tetrahedra);
  EXPECT_EQ(spheres, m.spheres);
  EXPECT_EQ(density, m.boundary_point_density_mm);
  EXPECT_EQ(voxels->count, m.voxels->count);
  EXPECT_EQ(voxels->volume_mm3, m.voxels->volume_mm3);
  EXPECT_EQ(bounds.min, m.bounds.min);
  EXPECT_EQ(bounds.max, m.bounds.max);
  EXPECT_EQ(timings, m.timings_s);
  EXPECT_EQ(warnings, m.warnings);
  const auto& [request, levels, nodes, achieved, gap, seconds] = *simplification;
  EXPECT_EQ(request.model, m.simplification->request.model);
  EXPECT_EQ(method_texts(request.method), method_texts(m.simplification->request.method));
  EXPECT_EQ(levels, m.simplification->levels);
  EXPECT_EQ(nodes, m.simplification->nodes);
  EXPECT_EQ(gap, m.simplification->optimality_gap);
  EXPECT_EQ(seconds, m.simplification->seconds);
  const auto& [count, iou, object, covered, spilled, never_spills, covers_all, volume, volume_error, area, area_error,
               hausdorff, before, after] = achieved;
  EXPECT_EQ(count, a.spheres);
  EXPECT_EQ(iou, a.iou);
  EXPECT_EQ(object, a.object_mm3);
  EXPECT_EQ(covered, a.covered_mm3);
  EXPECT_EQ(spilled, a.spilled_mm3);
  EXPECT_TRUE(never_spills && covers_all);
  EXPECT_EQ(volume, a.volume_mm3);
  EXPECT_EQ(volume_error, a.volume_error);
  EXPECT_EQ(area, a.area_mm2);
  EXPECT_EQ(area_error, a.area_error);
  const auto& [mm, to_spheres, to_object, of_diagonal] = *hausdorff;
  EXPECT_EQ((std::array{mm, to_spheres, to_object, of_diagonal}), (std::array<double, 4>{1, 2, 3, 4}));
  EXPECT_EQ(before.betti, a.before.betti);
  EXPECT_EQ(before.euler_characteristic, 4);
  EXPECT_EQ(after.betti, a.after.betti);
  EXPECT_EQ(after.euler_characteristic, 8);
}

TEST(Records, OfModelsReadBack) {
  for (const ModelInfo& m : {StubService::model_info(), StubService::imported_info(), StubService::simplified_info()}) {
    EXPECT_EQ(record_of(model_from(record_of(m))), record_of(m));
    EXPECT_EQ(document_of(model_from(record_of(m))), document_of(m));
  }
}

template <typename F>
ErrorCode refusal(F&& f) {
  try {
    f();
  } catch (const Error& error) {
    return error.code();
  }
  ADD_FAILURE() << "accepted";
  return {};
}

// JSON has no such numbers: what was written would be damaged for whoever reads it.
TEST(Records, HoldFiniteNumbersOnly) {
  for (const double bad : {std::numeric_limits<double>::infinity(), std::numeric_limits<double>::quiet_NaN()}) {
    const auto volume = [](auto&& spoil) {
      VolumeInfo v = StubService::volume_info();
      spoil(v);
      return refusal([&] { static_cast<void>(record_of(v)); });
    };
    EXPECT_EQ(volume([&](VolumeInfo& v) { v.grid.spacing.y = bad; }), ErrorCode::unusable);
    EXPECT_EQ(volume([&](VolumeInfo& v) { v.grid.direction.rows[2].z = bad; }), ErrorCode::unusable);
    EXPECT_EQ(volume([&](VolumeInfo& v) { v.range.max = bad; }), ErrorCode::unusable);
    EXPECT_EQ(volume([&](VolumeInfo& v) { v.slope = bad; }), ErrorCode::unusable);
    const auto model = [](auto&& spoil) {
      ModelInfo m = StubService::simplified_info();
      spoil(m);
      return refusal([&] { static_cast<void>(record_of(m)); });
    };
    EXPECT_EQ(model([&](ModelInfo& m) { m.bounds.max.x = bad; }), ErrorCode::unusable);
    EXPECT_EQ(model([&](ModelInfo& m) { m.boundary_point_density_mm = bad; }), ErrorCode::unusable);
    EXPECT_EQ(model([&](ModelInfo& m) { m.voxels = VoxelMeasures{5, bad}; }), ErrorCode::unusable);
    EXPECT_EQ(model([&](ModelInfo& m) { m.simplification->achieved.volume_mm3 = bad; }), ErrorCode::unusable);
    ModelMeasures measures;
    measures.spheres.mass.volume_mm3 = bad;
    EXPECT_EQ(refusal([&] { static_cast<void>(measures_document(kModel, measures)); }), ErrorCode::unusable);
  }
}

TEST(Records, OfTimesThatNoClockShowsAreCorrupt) {
  std::string record = record_of(StubService::volume_info());
  const std::size_t at = record.find("\"created\":") + 10;
  record.replace(at, record.find(',', at) - at, "9223372036854775807");
  EXPECT_EQ(refusal([&] { static_cast<void>(volume_from(record)); }), ErrorCode::corrupt);
}

TEST(Records, ThatAreDamagedAreCorrupt) {
  for (const char* text : {"", "{", "{}", "[]", R"({"id": 5})"}) {
    try {
      static_cast<void>(volume_from(text));
      ADD_FAILURE() << text;
    } catch (const Error& error) {
      EXPECT_EQ(error.code(), ErrorCode::corrupt);
    }
  }
}

TEST(Identity, OfAVolumeIsItsBytesAndParameters) {
  const std::vector<StoredFile> one = {{.name = {}, .sha256 = std::string(64, '1'), .bytes = 5}};
  std::vector<StoredFile> renamed = one;
  renamed[0].name = "other";
  EXPECT_EQ(identity_of(one, {}), identity_of(renamed, {})) << "one file needs no name";
  EXPECT_EQ(identity_of(one, {}),
            R"({"files":[{"bytes":5,"sha256":")" + std::string(64, '1') + R"("}],"parameters":{}})");
  VolumeParameters parameters;
  parameters.frame = 0;
  EXPECT_NE(identity_of(one, {}), identity_of(one, parameters));
  std::vector<StoredFile> two = {one[0], one[0]};
  two[0].name = "a";
  two[1].name = "b";
  std::vector<StoredFile> other = two;
  other[1].name = "c";
  EXPECT_NE(identity_of(two, {}), identity_of(other, {})) << "a header names its data";
}

TEST(Identity, OfAModelIsWhatWasAskedAndTheAlgorithm) {
  ModelRequest request{.volume = kVolume, .rule = {}};
  request.rule.lo = 0.0;
  const std::string identity = identity_of(request, "1");
  EXPECT_EQ(identity,
            R"({"algorithm_version":"1","request":{"border":"closed","inside":"above","threshold":0.0,"volume":")" +
                kVolume + R"("}})");
  EXPECT_NE(identity, identity_of(request, "2"));
  request.rule.lo = -0.0;
  EXPECT_EQ(identity, identity_of(request, "1")) << "minus zero is zero";
  request.rule.border = Border::open;
  EXPECT_NE(identity, identity_of(request, "1"));
}

TEST(Times, AreIsoUtcToTheMillisecond) {
  EXPECT_EQ(iso_time(Time(std::chrono::milliseconds(0))), "1970-01-01T00:00:00.000Z");
  EXPECT_EQ(iso_time(Time(std::chrono::milliseconds(1'700'000'000'007))), "2023-11-14T22:13:20.007Z");
}

}  // namespace
}  // namespace spherule::test
