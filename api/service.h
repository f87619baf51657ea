// SPDX-License-Identifier: GPL-3.0-or-later
//
// What the REST interface asks of the program behind it, in the program's own words. server/pipeline.* implements it;
// tests of api/ stand a stub here. It knows no HTTP and no JSON.
//
// Every method is thread safe and throws Error and nothing else for anything that input, limits or the outside world
// can cause: not_found for an id that nothing bears, whatever the id looks like.
#pragma once

#include <algorithm>
#include <array>
#include <chrono>
#include <cstdint>
#include <functional>
#include <map>
#include <memory>
#include <optional>
#include <span>
#include <string>
#include <string_view>
#include <variant>
#include <vector>

#include "core/base/geometry.h"
#include "core/inside.h"
#include "core/measure/checks.h"
#include "core/measure/report.h"
#include "core/measure/solid.h"
#include "core/read/read.h"
#include "core/register/register.h"
#include "core/render/render.h"
#include "core/render/slice_picture.h"
#include "core/simplify/simplify.h"
#include "core/volume.h"
#include "core/write/export.h"
#include "core/write/export_file.h"

namespace spherule::api {

using Time = std::chrono::system_clock::time_point;

/// Open, immutable bytes. They stay readable while this is held, also when what they belong to is deleted.
struct Content {
  std::uint64_t bytes = 0;
  std::string sha256;  ///< lower-case hex
  /// Fills `out` from `offset` on; returns how many bytes there were: fewer than asked only at the end. Thread safe.
  std::function<std::size_t(std::uint64_t offset, std::span<char> out)> read_at;
  int file = -1;  ///< a descriptor of just these bytes, open as long as read_at lives; -1: none
};

/// A page of a list: the entries after `cursor` (opaque, from the page before; empty: from the newest).
struct PageRequest {
  std::size_t limit = 100;
  std::string cursor;
};
template <typename T>
struct Page {
  std::vector<T> items;
  std::string next;                    ///< cursor of the following page; empty on the last one
  std::vector<std::string> damaged{};  ///< ids of entries of this page whose records cannot be read
};

// ---------------------------------------------------------------------------------------------------------- volumes

/// What a user says about the bytes, beyond the bytes: part of the volume's identity.
struct VolumeParameters {
  std::optional<RawLayout> raw;
  std::optional<int> frame;
  std::string grid;
};

struct StoredFile {
  std::string name;  ///< plain; only one of several files has one. Never shown: it may name a patient
  std::string sha256;
  std::uint64_t bytes = 0;
};

struct VolumeInfo {
  std::string id;
  Time created;
  std::vector<StoredFile> files;  ///< ascending by name
  VolumeParameters parameters;
  std::string format;
  Grid grid;
  VoxelType type = VoxelType::uint8;
  double slope = 1, intercept = 0;
  ValueRange range;
  Side natural_side = Side::above;
  std::vector<std::string> warnings;

  std::uint64_t bytes() const;  ///< of all files
};

/// Files on their way in. What was begun and not stored vanishes with the object.
class Upload {
 public:
  virtual ~Upload() = default;
  /// Starts the next file. `name` may be a path of the sender: what follows its last slash is kept. Throws
  /// invalid_argument for a name that occurs twice and for too many files.
  virtual void begin_file(std::string_view name) = 0;
  /// Appends to the file begun last. Throws no_space.
  virtual void write(std::string_view piece) = 0;
};

struct StoredVolume {
  VolumeInfo volume;
  bool already_stored = false;
};

/// Whether nobody waits for an answer any more; asked now and then, from any thread. May be empty.
using Gone = std::function<bool()>;

// ----------------------------------------------------------------------------------------------------------- models

/// Which object of which volume. `rule.side` is natural_side when the user named none.
struct ModelRequest {
  std::string volume;
  ObjectRule rule;
};

/// A simpler model of a model.
struct SimplificationRequest {
  std::string model;
  SimplifyMethod method;
};

/// How a simplified model came to be, and how near it is to its object: the scan's where its chain of source models
/// begins with one, else the union of the spheres that were imported.
struct SimplificationInfo {
  SimplificationRequest request;
  std::uint32_t levels = 0;  ///< level k shows at most k spheres; the last is the model itself
  std::uint64_t nodes = 0;   ///< spheres of all levels together
  Achieved achieved;
  std::optional<double> optimality_gap;  ///< as of BestSpheres
  double seconds = 0;                    ///< that the method took
};

struct ModelInfo {
  std::string id;
  Time created;
  std::string algorithm_version;
  // Exactly one of these three is there.
  std::optional<ModelRequest> source;
  std::optional<SimplificationInfo> simplification;
  std::string imported_format;  ///< "csv" or "npy"
  std::uint64_t boundary_points = 0;
  std::uint64_t tetrahedra = 0, inside_tetrahedra = 0;  ///< all finite cells of the tetrahedralization; those inside
  std::uint64_t spheres = 0;
  double boundary_point_density_mm = 0;
  std::optional<VoxelMeasures> voxels;  ///< of the inside samples; raw models only
  Box bounds;
  std::map<std::string, double> timings_s;  ///< by stage
  std::vector<std::string> warnings;
};

enum class SphereFormat : std::uint8_t { csv, npy, ply, vtp };

/// What can be told of a sphere beside x, y, z and r.
enum class SphereFigure : std::uint8_t {
  index,  ///< in the model or in its level, from 0
  // These five need the union to be measured.
  volume_mm3,        ///< its part of the union: the ball within its power cell
  area_mm2,          ///< its part of the union's surface
  share,             ///< its part of the union's volume, 0 … 1
  rank,              ///< by volume_mm3, from 1
  cumulative_share,  ///< of the spheres up to this rank
  // Of a simplified model's spheres.
  node,        ///< its place among the spheres of all levels, from 0
  parent,      ///< the node that it refines, or -1
  level_from,  ///< the first level that shows it
  level_to,    ///< the last one
  members,     ///< how many of the source model's spheres it stands for
  // Of a source model's spheres.
  cluster,  ///< index of the simplified sphere that stands for it, or -1
};
inline constexpr std::array sphere_figures{
    SphereFigure::index,      SphereFigure::volume_mm3,       SphereFigure::area_mm2, SphereFigure::share,
    SphereFigure::rank,       SphereFigure::cumulative_share, SphereFigure::node,     SphereFigure::parent,
    SphereFigure::level_from, SphereFigure::level_to,         SphereFigure::members,  SphereFigure::cluster};
constexpr bool is_contribution(SphereFigure f) {
  return f >= SphereFigure::volume_mm3 && f <= SphereFigure::cumulative_share;
}
constexpr bool is_of_levels(SphereFigure f) { return f >= SphereFigure::node && f <= SphereFigure::members; }

enum class SphereOrder : std::uint8_t { index, contribution };

/// What the rows of a listing are. All but `spheres` are for simplified models.
enum class SphereRows : std::uint8_t {
  spheres,  ///< of the model, or of the level asked for
  nodes,    ///< of all levels
  members,  ///< of the source model
};

/// How spheres are listed: what the rows are, which figures follow x, y, z, r, and in which order.
struct SphereListing {
  std::vector<SphereFigure> columns{};
  SphereOrder order = SphereOrder::index;
  SphereRows rows = SphereRows::spheres;

  bool needs_contributions() const {
    return order == SphereOrder::contribution || std::ranges::any_of(columns, is_contribution);
  }
  /// Whether only simplified models have this.
  bool needs_levels() const { return rows != SphereRows::spheres || std::ranges::any_of(columns, is_of_levels); }
};

struct SpherePage {
  std::uint64_t total = 0;
  std::vector<Sphere> spheres;
  std::vector<SphereColumn> columns;  ///< as listed
  /// Of each sphere, when they were asked for: ascending indices of spheres of the source model.
  std::optional<std::vector<std::vector<std::uint32_t>>> members;
};

/// As what figures are asked for: their numbers, pixels, or shapes.
enum class FigureFormat : std::uint8_t { json, png, svg };

/// What is made from one finished model, or of one volume, and kept as the answer's bytes: a JSON document
/// (documents.h), a picture, a file for other programs.
struct MeasuresRequest {};
struct ChecksRequest {};
struct RenderRequest {
  RenderOptions options{};
  std::string with{};  ///< a second model in the picture; empty: none
};
struct ExportRequest {
  SphereFormat format = SphereFormat::csv;
  SphereListing listing{};
};
/// Levels of a simplified model as a tree: a JSON document.
struct TreeRequest {
  std::vector<std::uint32_t> levels;  ///< ascending
};
struct FileRequest {
  FileFormat format = FileFormat::urdf;
  FileOptions options{};
};
/// Every sphere's part of the union: not sent as it is, but needed by measures and by listings of spheres.
struct ContributionsRequest {};
struct SliceRequest {
  std::string volume;
  int axis = 2;            ///< of the grid: 0, 1, 2 for i, j, k
  std::int32_t index = 0;  ///< of the slice along it
  std::optional<ObjectRule> object{};
  FigureFormat format = FigureFormat::png;
  SliceOptions options{};  ///< of a picture
};
/// Counts of a volume's values: not sent as they are, but as a document or a plot.
struct ValuesRequest {
  std::string volume;
  std::size_t buckets = 256;
};
struct DerivedRequest {
  std::string model;  ///< empty for what is of a volume
  std::variant<MeasuresRequest, ChecksRequest, RenderRequest, ExportRequest, ContributionsRequest, SliceRequest,
               TreeRequest, FileRequest, ValuesRequest>
      what;
  std::uint32_t level = 0;  ///< of a simplified model, in place of its last; 0: that one
};

// ---------------------------------------------------------------------------------------------------- registrations

struct RegistrationRequest {
  std::string fixed, moving;  ///< ids of models
  RegistrationOptions options{};
};

struct RegistrationInfo {
  std::string id;
  RegistrationRequest request;
  AffineMap moving_to_fixed;
  std::vector<Sphere> fixed_spheres, moving_spheres;  ///< the k spheres of each
  std::string document;                               ///< what users see (registration_documents.h)
};

struct StoredRegistration {
  RegistrationInfo registration;
  bool already_stored = false;
};

/// What is made from a finished registration and kept as the answer's bytes.
struct BeforeAfterRequest {
  RenderOptions options{};
  bool few = false;  ///< of the k spheres instead of the models
};
enum class Applied : std::uint8_t { volume, model };
struct RegistrationAnswerRequest {
  std::string registration;
  std::variant<BeforeAfterRequest, Applied> what;
};

// ------------------------------------------------------------------------------------------------------------- jobs

enum class JobState : std::uint8_t { queued, running, cancelling, succeeded, failed, cancelled };
/// Whether the job can change no more.
constexpr bool is_over(JobState s) { return s >= JobState::succeeded; }

struct JobInfo {
  std::string id;
  /// "model", "simplification", "registration", "registration_answer", "measures", "checks", "render", "export",
  /// "contributions", "slice", "tree", "histogram"
  std::string kind;
  JobState state = JobState::queued;
  std::string stage;                          ///< of the work: "read", "boundary" …; empty before it runs
  double progress = 0;                        ///< 0 … 1 over all stages; never goes back
  std::optional<std::size_t> queue_position;  ///< jobs ahead of a queued one
  Time created;
  std::optional<Time> started, finished;
  std::optional<double> remaining_s;  ///< estimate while running
  std::vector<std::string> warnings;
  std::optional<Error> error;  ///< of a failed job; a failed job without one met a defect of the server
  double elapsed_s = 0;        ///< of the run, so far or until its end
  std::string result;          ///< path of the finished result; empty before
  bool awaited = false;        ///< whether the request that gives it has waited for it as long as it was to
};

/// Something that happened to a job. Numbers ascend, also over restarts, but may have gaps.
struct JobEvent {
  enum class Type : std::uint8_t { state, progress, warning, end };
  std::uint64_t number = 0;
  Type type = Type::state;
  JobState state = JobState::queued;
  std::string stage{};
  double progress = 0;
  std::string warning{};
};
struct JobEvents {
  std::vector<JobEvent> events;
  bool over = false;      ///< nothing will follow
  bool stopping = false;  ///< the server stops: more follows once it is back
};

/// A result, or the job that will make it.
template <typename T>
using Outcome = std::variant<T, JobInfo>;

struct StoredModel {
  ModelInfo model;
  bool already_stored = false;
};

// ---------------------------------------------------------------------------------------------------------- service

struct Limits {
  std::uint64_t upload_bytes = 0;        ///< of one request's body
  std::uint64_t image_pixels = 0;        ///< of one picture
  std::chrono::seconds longest_wait{0};  ///< of `Prefer: wait` and of derived answers
};

struct Readiness {
  bool ready = false;
  std::string reason;  ///< a sentence that says why not
};

struct About {
  std::string version;            ///< of the program
  std::string algorithm_version;  ///< of the models: part of their identity
};

/// An upload that is sent in pieces (tus).
struct UploadInfo {
  std::string id;
  std::string filename;                  ///< empty when none was given
  std::uint64_t length = 0, offset = 0;  ///< bytes: announced; arrived so far
  Time created, expires;
};

/// A family of figures, as Prometheus has them.
struct Metric {
  struct Sample {
    std::string suffix;  ///< "_bucket", "_sum", "_count" of a histogram, else empty
    std::vector<std::pair<std::string, std::string>> labels;
    double value = 0;
  };
  std::string name, type, help;  ///< type: "counter", "gauge" or "histogram"
  std::vector<Sample> samples;
};

class Service {
 public:
  using Seconds = std::chrono::duration<double>;

  virtual ~Service() = default;

  virtual About about() const = 0;
  virtual Limits limits() const = 0;
  virtual Readiness readiness() const = 0;

  /// Begins an upload of `announced` bytes (0: unknown). Throws no_space when they cannot fit, busy.
  virtual std::unique_ptr<Upload> start_upload(std::uint64_t announced) = 0;
  /// Reads the uploaded files as a volume and keeps them: on the disk before this returns. Throws what read_volume
  /// throws, invalid_argument without any file, cancelled when the sender is gone, and busy when the server stops.
  virtual StoredVolume store_volume(std::unique_ptr<Upload> upload, const VolumeParameters& parameters,
                                    const Gone& gone) = 0;
  virtual Page<VolumeInfo> volumes(const PageRequest& page) = 0;
  virtual VolumeInfo volume(const std::string& id) = 0;
  /// The bytes of file number `index` as they came. Throws not_found for an index past the last.
  virtual Content volume_content(const std::string& id, std::size_t index) = 0;
  /// Counts in equal intervals of the volume's range. Like derive: counted once and kept.
  virtual Outcome<std::vector<std::uint64_t>> value_histogram(const std::string& id, std::size_t buckets,
                                                              Seconds wait) = 0;
  /// Deletes the volume with all that was made from it, and ends the jobs that work on any of these.
  virtual void delete_volume(const std::string& id) = 0;

  /// The model of this request: at once when it exists, else a job is started (or the one that runs already is joined)
  /// and waited for at most `wait`. Throws the job's error when it fails in that time; not_found without the volume;
  /// busy when the queue is full.
  virtual Outcome<StoredModel> make_model(const ModelRequest& request, Seconds wait) = 0;
  /// Like make_model. Throws what check_method throws, before a job is started; not_found without the source model.
  virtual Outcome<StoredModel> simplify_model(const SimplificationRequest& request, Seconds wait) = 0;
  /// A model of spheres that the user brings, in one uploaded file.
  virtual StoredModel import_model(std::unique_ptr<Upload> upload, SphereFormat format) = 0;
  virtual Page<ModelInfo> models(const PageRequest& page) = 0;
  virtual ModelInfo model(const std::string& id) = 0;
  /// Deletes the model with all that was made from it, and ends the jobs that work on any of these.
  virtual void delete_model(const std::string& id) = 0;
  /// Rows of a listing, of a level as in DerivedRequest; `members` of each row too where wanted. Throws not_found when
  /// it needs contributions and derive() has not made them, unusable when only simplified models have what it needs.
  virtual SpherePage spheres(const std::string& id, std::uint32_t level, std::uint64_t offset, std::size_t limit,
                             const SphereListing& listing, bool members) = 0;
  virtual RadiusHistogram radius_histogram(const std::string& id, std::size_t buckets, RadiusScale scale) = 0;
  /// Like make_model, for what is derived from a model or volume: the finished answer's bytes. Throws unusable for
  /// measures, checks and files that the model's kind or size does not have, invalid_argument for a level that it does
  /// not have.
  virtual Outcome<Content> derive(const DerivedRequest& request, Seconds wait) = 0;

  /// Like make_model, for a registration. Throws not_found without either model.
  virtual Outcome<StoredRegistration> register_pair(const RegistrationRequest& request, Seconds wait) = 0;
  virtual Page<RegistrationInfo> registrations(const PageRequest& page) = 0;
  virtual RegistrationInfo registration(const std::string& id) = 0;
  /// Likewise.
  virtual void delete_registration(const std::string& id) = 0;
  /// Like derive, from a registration. Throws unusable for volumes where a model was not made from one.
  virtual Outcome<Content> derive_from(const RegistrationAnswerRequest& request, Seconds wait) = 0;

  virtual Page<JobInfo> jobs(const PageRequest& page) = 0;
  virtual JobInfo job(const std::string& id) = 0;
  /// Events after number `after`, as soon as there are any; none when `wait` passes first or the server stops.
  virtual JobEvents job_events(const std::string& id, std::uint64_t after, Seconds wait) = 0;
  /// Takes the caller's request for the job back; the last one stops the work. Who may do everything stops it for all,
  /// once it is none of the requesters. Nothing when the caller may not. Throws conflict when the job is over.
  virtual std::optional<JobInfo> cancel_job(const std::string& id) = 0;

  using TakeBytes = std::function<void(std::string_view piece)>;
  /// Begins an upload in pieces. Throws too_large, busy, no_space.
  virtual UploadInfo create_upload(std::uint64_t length, const std::string& filename) = 0;
  virtual UploadInfo upload(const std::string& id) = 0;
  /// Appends what `feed` hands on; what has arrived stays, also when `feed` throws. Throws conflict when the upload
  /// does not stand at `offset`, too_large for more bytes than were announced.
  virtual UploadInfo append_upload(const std::string& id, std::uint64_t offset,
                                   const std::function<void(const TakeBytes&)>& feed) = 0;
  /// Hands on all bytes of a finished upload. Throws conflict while some are missing.
  virtual void read_upload(const std::string& id, const TakeBytes& take) = 0;
  virtual void delete_upload(const std::string& id) = 0;

  /// The reply that was kept under a key, if any; else the key is the caller's until it keeps a reply or releases it.
  /// Throws conflict while it is another caller's.
  virtual std::optional<std::string> recall_reply(const std::string& key) = 0;
  virtual void keep_reply(const std::string& key, const std::string& reply) = 0;
  virtual void release_reply(const std::string& key) = 0;

  virtual std::vector<Metric> metrics() = 0;
};

}  // namespace spherule::api
