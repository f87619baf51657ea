// SPDX-License-Identifier: GPL-3.0-or-later
//
// A service that knows one volume, two models and one job, and remembers what it was asked.
#pragma once

#include <map>
#include <optional>
#include <stdexcept>
#include <string>
#include <vector>

#include "api/http/http.h"
#include "api/json/documents.h"
#include "api/json/records.h"
#include "api/json/registration_documents.h"
#include "api/json/work.h"
#include "api/service.h"

namespace spherule::test {

inline const std::string kVolume = "vol_" + std::string(32, 'a');
inline const std::string kModel = "mdl_" + std::string(32, 'b');
inline const std::string kImported = "mdl_" + std::string(32, 'c');
inline const std::string kSimplified = "mdl_" + std::string(32, 'e');
inline const std::string kUpload = "upl_" + std::string(32, 'f');
inline const std::string kRegistration = "reg_" + std::string(32, 'f');
inline const std::string kJob = "job_" + std::string(32, 'd');

class StubService final : public api::Service {
 public:
  // What to do.
  bool finished = true;        ///< requests give results, not jobs
  bool already_stored = true;  ///< what uploads and models say
  std::optional<Error> failure;
  bool defect = false;
  bool may_cancel = true;
  bool awaited = true;  ///< what the job of a model says
  api::JobEvents events;

  // What was asked.
  std::vector<std::pair<std::string, std::string>> files;  ///< name, bytes
  api::VolumeParameters parameters;
  std::optional<api::ModelRequest> made;
  std::optional<api::SimplificationRequest> simplified;
  std::optional<api::DerivedRequest> derived;
  std::uint64_t image_pixels = 1'000'000;
  std::optional<api::RegistrationRequest> registered;
  std::optional<api::SphereFormat> imported;
  api::SphereListing listing;
  std::uint32_t level = 0;
  bool members = false;
  double waited = -1;
  api::PageRequest page;
  std::uint64_t announced = 0;
  std::vector<std::string> deleted;
  api::UploadInfo resumable{.id = kUpload, .filename = {}, .length = 10, .offset = 0, .created = {}, .expires = {}};
  std::string uploaded;                     ///< its bytes
  std::map<std::string, std::string> kept;  ///< replies, by key
  std::vector<std::string> reserved;

  static api::VolumeInfo volume_info() {
    api::VolumeInfo v;
    v.id = kVolume;
    v.created = api::Time(std::chrono::milliseconds(1'700'000'000'123));
    v.files = {{.name = "Doe^Jane.hdr", .sha256 = std::string(64, '1'), .bytes = 348},
               {.name = "Doe^Jane.img", .sha256 = std::string(64, '2'), .bytes = 1000}};
    v.format = "nifti";
    v.grid.dims = {10, 10, 10};
    v.grid.spacing = {1, 2, 3};
    v.grid.origin = {-4, 5, 6.5};
    v.type = VoxelType::uint8;
    v.range = {0, 255, 0};
    v.natural_side = Side::below;
    v.warnings = {"The header says two things; the sform was used."};
    return v;
  }
  static api::ModelInfo model_info() {
    api::ModelInfo m;
    m.id = kModel;
    m.created = api::Time(std::chrono::milliseconds(1'700'000'000'456));
    m.algorithm_version = "1";
    m.source.emplace();
    m.source->volume = kVolume;
    m.source->rule.lo = 60.5;
    m.boundary_points = 100;
    m.tetrahedra = 600;
    m.inside_tetrahedra = 350;
    m.spheres = 350;
    m.boundary_point_density_mm = 0.75;
    m.voxels = {400, 2400};
    m.bounds.include(Vec3{-1, -2, -3});
    m.bounds.include(Vec3{1, 2, 3});
    m.timings_s = {{"boundary", 0.25}};
    return m;
  }
  static api::ModelInfo imported_info() {
    api::ModelInfo m;
    m.id = kImported;
    m.algorithm_version = "1";
    m.imported_format = "csv";
    m.spheres = 2;
    return m;
  }
  static api::ModelInfo simplified_info() {
    api::ModelInfo m;
    m.id = kSimplified;
    m.algorithm_version = "1";
    m.spheres = 3;
    api::SimplificationInfo& s = m.simplification.emplace();
    s.request = {.model = kModel, .method = BestOptions{.mode = BestOptions::Mode::inner, .k = 3}};
    s.levels = 3;
    s.nodes = 5;
    s.achieved.spheres = 3;
    s.achieved.iou = 0.75;
    s.achieved.never_spills = true;
    s.achieved.hausdorff = {.mm = 2, .to_spheres = 2, .to_object = 0.5, .of_diagonal = 0.125};
    s.achieved.before.betti = {1, 2, 0};
    s.optimality_gap = 0.25;
    s.seconds = 1.5;
    return m;
  }
  static api::JobInfo job_info() {
    api::JobInfo j;
    j.id = kJob;
    j.kind = "model";
    j.state = api::JobState::running;
    j.stage = "delaunay";
    j.progress = 0.5;
    j.started = api::Time(std::chrono::seconds(1'700'000'000));
    j.elapsed_s = 2;
    j.remaining_s = 2;
    j.awaited = true;
    return j;
  }
  // Of a raw model, with more components than are listed.
  static ModelMeasures measures() {
    ModelMeasures m;
    m.voxels = VoxelMeasures{4, 8.5};
    m.tetrahedra.emplace();
    m.marching_cubes.emplace();
    m.observations.emplace();
    m.spheres.bounds.include(Vec3{1, 2, 3});
    for (std::uint32_t i = 0; i < 1200; ++i) {
      m.components.push_back({.spheres = 1, .first_sphere = i, .volume_mm3 = 9.5, .area_mm2 = 2, .bounds = {}});
    }
    return m;
  }
  // Of a slice of 3 x 3 samples with one inside.
  static std::string slice_document(const api::SliceRequest& request) {
    Volume slice;
    slice.grid.dims = {3, 3, 1};
    slice.voxels.resize(9);
    slice.voxels[4] = std::byte{100};
    ObjectRule rule;
    rule.lo = 50;
    const PlaneModel model = build_plane_model(slice, rule);
    return api::slice_document(kVolume, request, slice.grid, request.object ? &model : nullptr);
  }
  static api::Content content(std::string bytes) {
    return {.bytes = bytes.size(),
            .sha256 = std::string(64, 'e'),
            .read_at = [bytes = std::move(bytes)](std::uint64_t offset, std::span<char> out) {
              return bytes.copy(out.data(), out.size(), static_cast<std::size_t>(offset));
            }};
  }

  api::About about() const override { return {"0.1.0", "1"}; }
  api::Limits limits() const override {
    return {.upload_bytes = 1000, .image_pixels = image_pixels, .longest_wait = std::chrono::seconds(60)};
  }
  api::Readiness readiness() const override {
    return failure ? api::Readiness{false, "The disk is full."} : api::Readiness{true, {}};
  }
  std::unique_ptr<api::Upload> start_upload(std::uint64_t bytes) override {
    struct StubUpload final : api::Upload {
      explicit StubUpload(StubService& s) : stub(s) {}
      void begin_file(std::string_view name) override { stub.files.emplace_back(name, ""); }
      void write(std::string_view piece) override { stub.files.back().second += piece; }
      StubService& stub;
    };
    announced = bytes;
    return std::make_unique<StubUpload>(*this);
  }
  api::Stored<api::VolumeInfo> store_volume(std::unique_ptr<api::Upload>, const api::VolumeParameters& given,
                                            const api::Gone&) override {
    obey();
    parameters = given;
    return {volume_info(), already_stored};
  }
  using Service::find;
  api::Thing find(api::Collection collection, const std::string& id) override {
    if (collection == api::Collection::volumes) {
      obey();
      known(id == kVolume);
      return volume_info();
    }
    if (collection == api::Collection::registrations) {
      known(id == kRegistration);
      return registration_info();
    }
    known(id == kModel || id == kImported || id == kSimplified);
    return id == kModel ? model_info() : id == kImported ? imported_info() : simplified_info();
  }
  api::Page<api::Thing> list(api::Collection collection, const api::PageRequest& wanted) override {
    page = wanted;
    if (collection == api::Collection::volumes) return {{volume_info()}, "next/1+"};
    if (collection == api::Collection::registrations) return {{registration_info()}, "next"};
    return {{model_info(), imported_info(), simplified_info()}, ""};
  }
  void remove(api::Collection collection, const std::string& id) override {
    known(id == (collection == api::Collection::volumes  ? kVolume
                 : collection == api::Collection::models ? kModel
                                                         : kRegistration));
    deleted.push_back(id);
  }
  api::Content content(const std::string& id, std::size_t index) override {
    known(id == kVolume && index < 2);
    return content("0123456789");
  }
  api::Outcome submit(const api::WorkRequest& request, Seconds wait) override {
    obey();
    waited = wait.count();
    const api::Made result = std::visit([&](const auto& wanted) { return make(wanted); }, request);
    if (finished) return result;
    api::JobInfo job = job_info();
    job.awaited = awaited;
    return job;
  }
  api::Stored<api::ModelInfo> import_model(std::unique_ptr<api::Upload>, api::SphereFormat format) override {
    obey();
    imported = format;
    return {imported_info(), already_stored};
  }
  api::SpherePage spheres(const std::string& id, std::uint32_t wanted_level, std::uint64_t offset, std::size_t limit,
                          const api::SphereListing& wanted, bool with_members) override {
    known(id == kModel);
    listing = wanted;
    level = wanted_level;
    members = with_members;
    api::SpherePage p{.total = 350, .spheres = {}, .columns = {}, .members = {}};
    for (std::uint64_t i = offset; i < 350 && p.spheres.size() < limit; ++i) {
      p.spheres.push_back({{static_cast<double>(i), 0, 0}, 1.5});
    }
    for (const api::SphereFigure figure : wanted.columns) {
      p.columns.push_back({std::string(api::name(figure)), std::vector<double>(p.spheres.size(), 0.25)});
    }
    if (with_members) p.members.emplace(p.spheres.size(), std::vector<std::uint32_t>{4, 9});
    return p;
  }
  RadiusHistogram radius_histogram(const std::string& id, std::size_t buckets, RadiusScale scale) override {
    known(id == kModel);
    return {.scale = scale, .min_mm = 0.5, .max_mm = 2.5, .counts = std::vector<std::uint64_t>(buckets, 3)};
  }
  static api::RegistrationInfo registration_info() {
    const api::RegistrationRequest request{.fixed = kModel, .moving = kImported, .options = {.k = 8}};
    Registration found;
    found.moving_to_fixed = {scaled(2, rotation(Vec3{0, 0, 1})), {1, 2, 3}};
    found.fixed_spheres = {{{1, 2, 3}, 4}, {{5, 6, 7}, 8}};
    found.moving_spheres = {{{1, 2, 3}, 4}};
    found.pairs = {{0, 1}};
    found.others = {{.moving_to_fixed = {}, .surfaces = {.agreement = 0.9}}};
    found.timings = {{"shapes", 0.25}};
    found.warnings = {"Other poses are nearly as good."};
    return api::registration_from(
        api::registration_document(kRegistration, api::Time(std::chrono::milliseconds(1'700'000'000'789)), "1", request,
                                   found),
        api::record_of(request));
  }
  api::Page<api::JobInfo> jobs(const api::PageRequest& wanted) override {
    page = wanted;
    return {{job_info()}, ""};
  }
  api::JobInfo job(const std::string& id) override {
    known(id == kJob);
    return job_info();
  }
  api::JobEvents job_events(const std::string& id, std::uint64_t after, Seconds) override {
    known(id == kJob);
    api::JobEvents later{.events = {}, .over = events.over, .stopping = events.stopping};
    for (const auto& event : events.events) {
      if (event.number > after) later.events.push_back(event);
    }
    return later;
  }
  std::optional<api::JobInfo> cancel_job(const std::string& id) override {
    obey();
    known(id == kJob);
    if (!may_cancel) return {};
    return job_info();
  }
  api::PartialUploads& partial_uploads() override { return partial_; }
  api::Replies& replies() override { return book_; }
  std::vector<api::Metric> metrics() override {
    return {{"spherule_test", "gauge", "Of the test.", {{"", {{"of", "a \"b\"\n"}}, 0.5}, {"_sum", {}, 3}}}};
  }

 private:
  struct StubPartialUploads final : api::PartialUploads {
    explicit StubPartialUploads(StubService& s) : stub(s) {}
    api::UploadInfo create(std::uint64_t length, std::string_view filename) override {
      stub.resumable = {.id = kUpload,
                        .filename = std::string(filename),
                        .length = length,
                        .offset = 0,
                        .created = {},
                        .expires = {}};
      return stub.resumable;
    }
    api::UploadInfo find(const std::string& id) const override {
      known(id == kUpload);
      return stub.resumable;
    }
    api::UploadInfo append(const std::string& id, std::uint64_t offset,
                           const std::function<void(const TakeBytes&)>& feed) override {
      known(id == kUpload);
      if (offset != stub.resumable.offset) throw Error(ErrorCode::conflict, "Go on where the upload stands.");
      feed([&](std::string_view piece) { stub.uploaded += piece; });
      stub.resumable.offset = stub.uploaded.size();
      return stub.resumable;
    }
    void read(const std::string& id, const TakeBytes& take) const override {
      known(id == kUpload);
      take(stub.uploaded);
    }
    void remove(const std::string& id) override {
      known(id == kUpload);
      stub.deleted.push_back(id);
    }
    StubService& stub;
  };

  struct StubReplies final : api::Replies {
    explicit StubReplies(StubService& s) : stub(s) {}
    std::optional<std::string> recall(const std::string& key) override {
      if (const auto found = stub.kept.find(key); found != stub.kept.end()) return found->second;
      stub.reserved.push_back(key);
      return std::nullopt;
    }
    void keep(const std::string& key, const std::string& reply) override { stub.kept[key] = reply; }
    void release(const std::string& key) override { std::erase(stub.reserved, key); }
    StubService& stub;
  };

  // What each request makes here.
  api::Made make(const api::ModelRequest& request) {
    made = request;
    return api::Stored<api::ModelInfo>{model_info(), already_stored};
  }
  api::Made make(const api::SimplificationRequest& request) {
    known(request.model == kModel);
    simplified = request;
    return api::Stored<api::ModelInfo>{simplified_info(), already_stored};
  }
  api::Made make(const api::RegistrationRequest& request) {
    known(request.fixed == kModel && request.moving == kImported);
    registered = request;
    return api::Stored<api::RegistrationInfo>{registration_info(), already_stored};
  }
  api::Made make(const api::DerivedRequest& request) {
    const std::string_view from = api::kind_of(request).source;
    known(request.source == (from == "model" ? kModel : from == "volume" ? kVolume : kRegistration));
    derived = request;
    const auto* slice = std::get_if<api::SliceRequest>(&request.what);
    if (slice != nullptr && slice->format == api::FigureFormat::json) return content(slice_document(*slice));
    if (const auto* values = std::get_if<api::ValuesRequest>(&request.what))
      return content(api::record_of(std::vector<std::uint64_t>(values->buckets, 7)));
    if (std::holds_alternative<api::MeasuresRequest>(request.what))
      return content(api::measures_document(kModel, measures()));
    if (std::holds_alternative<api::ChecksRequest>(request.what)) return content(api::checks_document(kModel, {}));
    if (std::holds_alternative<api::TreeRequest>(request.what)) {
      const TreeLevel one{{{{1, 2, 3}, 4}}, {no_parent}}, two{{{{1, 2, 3}, 4}, {{5, 6, 7}, 8}}, {0, no_parent}};
      return content(api::tree_document(kModel, kImported, std::vector<std::uint32_t>{1, 2}, std::vector{one, two},
                                        {.begin = {0, 2, 3}, .items = {0, 2, 1}}));
    }
    return content("derived bytes");
  }

  StubPartialUploads partial_{*this};
  StubReplies book_{*this};

  void obey() const {
    if (failure) throw *failure;
    if (defect) throw std::logic_error("/secret/path");
  }
  static void known(bool is) {
    if (!is) throw Error(ErrorCode::not_found, "There is no such thing.");
  }
};

/// A body in memory, handed on in small pieces.
class StubBody final : public api::Body {
 public:
  explicit StubBody(std::string bytes) : bytes_(std::move(bytes)) {}
  explicit StubBody(std::vector<std::array<std::string, 3>> parts) : parts_(std::move(parts)) {}

  bool present() const override { return !bytes_.empty() || !parts_.empty(); }
  std::uint64_t announced() const override { return bytes_.size(); }
  void read(std::uint64_t limit, const Take& take) override {
    if (bytes_.size() > limit) throw Error(ErrorCode::too_large, "The body is too large.");
    for (std::size_t at = 0; at < bytes_.size(); at += 3) take(std::string_view(bytes_).substr(at, 3));
  }
  void read_parts(std::uint64_t, const BeginPart& begin, const Take& take) override {
    for (const auto& [name, filename, bytes] : parts_) {
      begin(name, filename);
      take(bytes);
    }
  }

 private:
  std::string bytes_;
  std::vector<std::array<std::string, 3>> parts_;
};

}  // namespace spherule::test
