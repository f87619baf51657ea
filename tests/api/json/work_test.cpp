// SPDX-License-Identifier: GPL-3.0-or-later
#include "api/json/work.h"

#include <gtest/gtest.h>

#include "api/paths.h"
#include "core/base/error.h"
#include "tests/api/stub.h"

namespace spherule::test {
namespace {

using namespace api;

// As a job has it after a restart.
template <typename Request>
Request through(const Request& request) {
  return std::get<Request>(work_from(kind_of(request).name, record_of(request)));
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

TEST(Requests, OfRequestsReadBack) {
  ModelRequest request{.volume = kVolume, .rule = {}};
  for (const auto kind : {ObjectRule::Kind::threshold, ObjectRule::Kind::range, ObjectRule::Kind::labels}) {
    request.rule = {};
    request.rule.kind = kind;
    request.rule.side = Side::below;
    request.rule.border = Border::open;
    if (kind == ObjectRule::Kind::labels) {
      request.rule.labels = {min_label, -9007199254740993, 9223372036854775807, max_label};
    } else {
      request.rule.lo = -1e-300;
      request.rule.hi = kind == ObjectRule::Kind::range ? 0.1 : 0;
    }
    const auto again = through<ModelRequest>(request);
    EXPECT_EQ(again.volume, request.volume);
    EXPECT_EQ(again.rule, request.rule);
  }
  const ObjectRule labels = request.rule;
  for (const DerivedRequest& derived : std::vector<DerivedRequest>{
           {kModel, MeasuresRequest{}},
           {kModel, ChecksRequest{}},
           {kModel, RenderRequest{{.width = 3, .height = 4, .style = Style::blobs, .views = {View::left}}}},
           {kModel, RenderRequest{.with = kImported}},
           {kModel, ExportRequest{SphereFormat::vtp}},
           {kModel, TreeRequest{{1, 8}}},
           {kModel, RenderRequest{.options = {.views = {View::left}}}, 5},
           {kModel, ContributionsRequest{}},
           {kModel, FileRequest{}},
           {kModel, FileRequest{FileFormat::urdf, {.density_kg_m3 = 2500, .link = "femur"}}},
           {kModel, FileRequest{FileFormat::glb, {.glb = {.style = GlbOptions::Style::mesh}}}},
           {kModel, FileRequest{FileFormat::nifti, {.voxel_mm = 0.5}}},
           {kVolume, SliceRequest{.axis = 0, .index = 3}},
           {kVolume, ValuesRequest{17}},
           {kRegistration, BeforeAfterRequest{.options = {.layout = Layout::overlaid}, .few = true}},
           {kRegistration, AppliedRequest{Applied::model}},
           {kVolume, SliceRequest{.object = labels,
                     .format = FigureFormat::svg,
                     .options = {.width = 5, .window = Window{3, 4}, .show = {Overlay::circles}}}}}) {
    EXPECT_EQ(path_of(through<DerivedRequest>(derived), {}), path_of(derived, {}));
    EXPECT_EQ(through<DerivedRequest>(derived).what.index(), derived.what.index());
  }
  const SphereListing listing{{SphereFigure::share, SphereFigure::index}, SphereOrder::contribution};
  const DerivedRequest listed{kModel, ExportRequest{SphereFormat::ply, listing}};
  EXPECT_EQ(path_of(through<DerivedRequest>(listed), {}),
            "/v1/models/" + kModel + "/exports/ply?columns=share,index&order=contribution");
  EXPECT_NE(identity_of(listed, "1"), identity_of(DerivedRequest{kModel, ExportRequest{SphereFormat::ply}}, "1"));
}

TEST(Requests, OfSimplificationsReadBack) {
  for (const SimplifyMethod& method : std::vector<SimplifyMethod>{
           SphericityOptions{.threshold = 0.1, .limit = 3, .representative = Representative::volume},
           SplittingOptions{.at = SplittingOptions::At::average, .k = 7, .representative = Representative::largest},
           PruneOptions{.buckets = {2, 5}, .bucket_count = 9}, PruneOptions{.least_radius_mm = 0.3},
           BestOptions{.mode = BestOptions::Mode::outer, .iou = 1.0 / 3}}) {
    const SimplificationRequest request{.model = kModel, .method = method};
    EXPECT_EQ(record_of(through<SimplificationRequest>(request)), record_of(request));
    EXPECT_EQ(through<SimplificationRequest>(request).method.index(), method.index());
  }
  const SimplificationRequest one{kModel, SplittingOptions{}}, other{kModel, SplittingOptions{.k = 255}};
  EXPECT_NE(identity_of(one, "1"), identity_of(other, "1"));
  EXPECT_EQ(identity_of(one, "1"),
            identity_of(SimplificationRequest{kModel, parse_method({{"method", "median"}})}, "1"))
      << "defaults";
  const DerivedRequest level{kModel,
                             ExportRequest{.format = SphereFormat::csv, .listing = {.rows = SphereRows::members}}, 4};
  EXPECT_EQ(path_of(through<DerivedRequest>(level), {}), "/v1/models/" + kModel + "/exports/csv?rows=members&level=4");
}

TEST(Requests, OfFilesDependOnWhatChangesTheFile) {
  const DerivedRequest plain{kModel, FileRequest{FileFormat::urdf, {}}};
  const DerivedRequest heavy{kModel, FileRequest{FileFormat::urdf, {.density_kg_m3 = 2500, .link = "femur"}}};
  const DerivedRequest same{kModel, FileRequest{FileFormat::urdf, {.voxel_mm = 3}}};
  EXPECT_EQ(path_of(heavy, {}), "/v1/models/" + kModel + "/exports/urdf?density=2500&link=femur");
  EXPECT_NE(identity_of(plain, "1"), identity_of(heavy, "1"));
  EXPECT_EQ(identity_of(plain, "1"), identity_of(same, "1"));
  EXPECT_NE(identity_of(plain, "1"), identity_of(DerivedRequest{kModel, FileRequest{FileFormat::srdf, {}}}, "1"));
}

// As one of an earlier version may be, whose options had other words.
TEST(Requests, ThatAreNotValidAnyMoreAreCorrupt) {
  std::string record = record_of(DerivedRequest{kModel, RenderRequest{{.width = 3, .height = 4}}});
  const std::size_t at = record.find("\"width\":\"3\"");
  ASSERT_NE(at, std::string::npos) << record;
  record.replace(at, 11, "\"width\":\"wide\"");
  EXPECT_EQ(refusal([&] { static_cast<void>(work_from("render", record)); }), ErrorCode::corrupt);
}

}  // namespace
}  // namespace spherule::test
