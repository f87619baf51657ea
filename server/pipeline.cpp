// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/pipeline.h"

#include <fcntl.h>
#include <sys/mman.h>
#include <unistd.h>

#include <algorithm>
#include <semaphore>
#include <stdexcept>

#include "api/documents.h"
#include "api/routes.h"
#include "core/checks.h"
#include "core/io/export.h"
#include "core/io/read.h"
#include "core/marching_cubes.h"
#include "core/measures.h"
#include "core/pipeline.h"
#include "core/ranking.h"
#include "core/render/render.h"
#include "core/spheres.h"
#include "server/blob_store.h"
#include "server/cache.h"
#include "server/catalog.h"
#include "server/model_blob.h"
#include "server/union_blob.h"

namespace spherule::server {

namespace {

using api::DerivedRequest;
using api::JobInfo;
using api::ModelInfo;
using api::StoredFile;
using api::VolumeInfo;
using Seconds = api::Service::Seconds;

constexpr const char* kVolumes = "volumes";
constexpr const char* kModels = "models";
constexpr const char* kAnswers = "answers";
constexpr std::size_t kMaxFiles = 4096;
// Requests that wait for a job hold a thread each; beyond this many they are told to poll.
constexpr std::ptrdiff_t kWaiters = 64;

api::JobState api_state(JobState state) {
  switch (state) {
    case JobState::queued: return api::JobState::queued;
    case JobState::running: return api::JobState::running;
    case JobState::cancelling: return api::JobState::cancelling;
    case JobState::succeeded: return api::JobState::succeeded;
    case JobState::failed: return api::JobState::failed;
    case JobState::cancelled: break;
  }
  return api::JobState::cancelled;
}

JobInfo job_info(const JobStatus& status) {
  const JobRecord& record = status.record;
  JobInfo job;
  job.id = record.id;
  job.kind = record.kind;
  job.state = api_state(record.state);
  job.stage = record.stage;
  job.progress = record.progress;
  job.queue_position = status.queue_position;
  job.created = record.created;
  if (record.started) job.started = *record.started;
  if (record.finished) job.finished = *record.finished;
  job.elapsed_s = status.elapsed_s;
  job.remaining_s = status.remaining_s;
  job.warnings = record.warnings;
  if (record.error && record.error->code) job.error.emplace(*record.error->code, record.error->sentence);
  if (record.state == JobState::succeeded) {
    job.result =
        record.kind == "model" ? "/v1/models/" + record.result_id : api::path_of(api::derived_from(record.request));
  }
  return job;
}

std::string kind_of(const DerivedRequest& request) {
  constexpr std::array<const char*, 5> kinds = {"measures", "checks", "render", "export", "contributions"};
  return kinds[request.what.index()];
}

api::Content content_of(Blob blob) {
  const auto shared = std::make_shared<const Blob>(std::move(blob));
  return {.bytes = shared->size(),
          .sha256 = shared->sha256(),
          .read_at = [shared](std::uint64_t offset, std::span<char> out) { return shared->read_at(offset, out); }};
}

// The text of a file without holding it in memory.
class Mapping {
 public:
  explicit Mapping(const Blob& blob) : size_(blob.size()) {
    const int file = ::open(blob.path().c_str(), O_RDONLY | O_CLOEXEC);
    if (file >= 0 && size_ > 0) data_ = ::mmap(nullptr, size_, PROT_READ, MAP_PRIVATE, file, 0);
    if (file >= 0) ::close(file);
    if (file < 0 || data_ == MAP_FAILED) {
      throw Error(ErrorCode::corrupt, "The stored upload cannot be read back; send it again.");
    }
  }
  ~Mapping() {
    if (data_ != nullptr) ::munmap(data_, size_);
  }
  Mapping(const Mapping&) = delete;
  Mapping& operator=(const Mapping&) = delete;
  std::string_view text() const { return {static_cast<const char*>(data_), size_}; }

 private:
  void* data_ = nullptr;
  std::size_t size_;
};

class FileUpload final : public api::Upload {
 public:
  struct File {
    std::string name;
    std::unique_ptr<Staging> staging;
  };

  FileUpload(BlobStore& blobs, std::uint64_t limit, std::uint64_t announced) : blobs_(blobs), limit_(limit) {
    // Looks at the free space before the first byte is taken.
    first_ = announced > 0 ? blobs.stage(limit, announced) : blobs.stage(limit);
  }

  void begin_file(std::string_view name) override {
    if (const std::size_t slash = name.find_last_of("/\\"); slash != name.npos) name.remove_prefix(slash + 1);
    if (files_.size() == kMaxFiles) {
      throw Error(ErrorCode::invalid_argument, "Send at most " + std::to_string(kMaxFiles) + " files at once.");
    }
    for (const File& file : files_) {
      if (file.name.empty() || name.empty()) {
        throw Error(ErrorCode::invalid_argument, "Give every one of several files its file name.");
      }
      if (file.name == name) throw Error(ErrorCode::invalid_argument, "Give every file a name of its own.");
    }
    files_.push_back({std::string(name), first_ ? std::move(first_) : blobs_.stage(limit_)});
  }

  void write(std::string_view piece) override { files_.back().staging->append(piece); }

  std::vector<File>& files() {
    if (files_.empty()) throw Error(ErrorCode::invalid_argument, "Send at least one file.");
    std::ranges::sort(files_, {}, &File::name);
    return files_;
  }

 private:
  BlobStore& blobs_;
  std::uint64_t limit_;
  std::unique_ptr<Staging> first_;
  std::vector<File> files_;
};

// Seconds of each stage, by name.
class Stopwatch {
 public:
  void lap(const std::string& stage) {
    const auto now = std::chrono::steady_clock::now();
    seconds_[stage] = std::chrono::duration<double>(now - last_).count();
    last_ = now;
  }
  void set(const std::string& stage, double seconds) { seconds_[stage] = seconds; }
  void restart() { last_ = std::chrono::steady_clock::now(); }
  const std::map<std::string, double>& seconds() const { return seconds_; }

 private:
  std::chrono::steady_clock::time_point last_ = std::chrono::steady_clock::now();
  std::map<std::string, double> seconds_;
};

// The part of a model's job that each stage has, as measured on heads of a million points.
struct Share {
  std::string_view stage;
  double from, to;
};
constexpr auto kShares = std::to_array<Share>({{"read", 0, 0.05},
                                               {"samples", 0.05, 0.06},
                                               {"boundary", 0.06, 0.1},
                                               {"delaunay", 0.1, 0.85},
                                               {"spheres", 0.85, 0.95},
                                               {"store", 0.95, 1}});

std::string version() { return std::to_string(algorithm_version); }

// What listings of spheres tell of each.
struct Contributions {
  explicit Contributions(UnionMeasures whole)
      : volume(whole.moments.volume), parts(std::move(whole.parts)), ranking(rank_contributions(parts)) {}

  double value(api::SphereFigure figure, std::uint32_t sphere) const {
    using enum api::SphereFigure;
    switch (figure) {
      case index: return sphere;
      case volume_mm3: return parts[sphere].volume_mm3;
      case area_mm2: return parts[sphere].area_mm2;
      case share: return volume > 0 ? parts[sphere].volume_mm3 / volume : 0;
      case rank: return ranking.rank[sphere] + 1.0;
      case cumulative_share: break;
    }
    return ranking.cumulative[ranking.rank[sphere]];
  }
  std::size_t bytes() const { return parts.size() * (sizeof(BallPart) + 16); }

  double volume;
  std::vector<BallPart> parts;
  Ranking ranking;
};

// Rows [first, first + count) of a listing. `contributions` may be null when the listing does not need them.
api::SpherePage rows(const SphereModel& model, const Contributions* contributions, const api::SphereListing& listing,
                     std::uint64_t first, std::uint64_t count) {
  api::SpherePage page{.total = model.spheres.size(), .spheres = {}, .columns = {}};
  first = std::min(first, page.total);
  count = std::min(count, page.total - first);
  const auto sphere = [&](std::uint64_t row) {
    return listing.order == api::SphereOrder::index ? static_cast<std::uint32_t>(row)
                                                    : contributions->ranking.order[row];
  };
  page.spheres.reserve(count);
  for (std::uint64_t row = first; row < first + count; ++row) page.spheres.push_back(model.spheres[sphere(row)]);
  for (const api::SphereFigure figure : listing.columns) {
    SphereColumn& column = page.columns.emplace_back(SphereColumn{std::string(api::name(figure)), {}});
    column.values.reserve(count);
    for (std::uint64_t row = first; row < first + count; ++row) {
      column.values.push_back(contributions != nullptr ? contributions->value(figure, sphere(row)) : sphere(row));
    }
  }
  return page;
}

[[noreturn]] void not_found(const char* what) {
  throw Error(ErrorCode::not_found, std::string("There is no such ") + what + "; it was deleted or never made.");
}

}  // namespace

struct Pipeline::State {
  Config config;
  // The catalogue's lock comes before anything is touched, and the jobs after all that they use.
  Catalog catalog;
  FileBlobStore blobs;
  Cache<SphereModel> cache;
  Cache<Contributions> contributions;
  std::counting_semaphore<> heavy;  // requests that read a whole volume or model beside the jobs
  std::counting_semaphore<kWaiters> waiters{kWaiters};
  JobPool pool;

  State(const Config& given, FaultLog log)
      : config(given),
        catalog((std::filesystem::create_directories(given.data), given.catalog_file())),
        blobs((given.blob_folder())),
        cache(given.model_cache_bytes),
        contributions(given.model_cache_bytes / 4),
        heavy(static_cast<std::ptrdiff_t>(given.jobs_at_once)),
        pool((remove_orphans(catalog, blobs), JobPoolOptions{.jobs_at_once = given.jobs_at_once,
                                                             .threads_per_job = given.threads_per_job(),
                                                             .queue_length = given.queue_length}),
             catalog, blobs,
             [this](const JobRecord& record, JobContext& context) {
               return record.kind == "model" ? run_model(record, context) : run_derived(record, context);
             },
             std::move(log)) {}

  struct Permit {
    explicit Permit(State& state) : state_(state) { state_.heavy.acquire(); }
    ~Permit() { state_.heavy.release(); }
    Permit(const Permit&) = delete;
    Permit& operator=(const Permit&) = delete;
    State& state_;
  };

  Context request_context() const { return {.threads = config.threads_per_job(), .cancel = {}, .progress = {}}; }

  Resource find(const std::string& id, const char* collection, const char* what) const {
    auto resource = catalog.find(id);
    if (!resource || resource->collection != collection) not_found(what);
    return std::move(*resource);
  }
  Resource find_volume(const std::string& id) const { return find(id, kVolumes, "volume"); }
  Resource find_model(const std::string& id) const { return find(id, kModels, "model"); }

  // Reads files of these names; a single one needs none.
  Volume read(const std::vector<StoredFile>& files, std::vector<Blob> open, const api::VolumeParameters& parameters,
              const Context& context) const {
    ReadOptions options{.raw = parameters.raw, .frame = parameters.frame, .grid = parameters.grid, .limits = {}};
    options.limits.max_voxels = config.max_voxels;
    options.limits.max_bytes = config.max_decompressed_bytes;
    if (open.size() == 1) return read_volume({open.front().path()}, options, context);
    ScratchFolder folder(blobs.scratch_root());
    std::vector<std::filesystem::path> paths;
    for (std::size_t i = 0; i < open.size(); ++i) paths.push_back(folder.link(open[i], files[i].name));
    return read_volume(paths, options, context);
  }

  Volume stored_volume(const Resource& resource, const Context& context) const {
    const VolumeInfo info = api::volume_from(resource.document);
    std::vector<Blob> open;
    for (const std::string& key : resource.blobs) {
      open.push_back(blobs.open(key));
      open.back().verify();
    }
    return read(info.files, std::move(open), info.parameters, context);
  }

  std::shared_ptr<const SphereModel> load(const Resource& resource, const Context& context) {
    return cache.get_or_load(resource.id, [&] {
      const Permit permit(*this);
      const Blob blob = blobs.open(resource.blobs.at(0));
      blob.verify();
      const auto model = std::make_shared<const SphereModel>(read_model(blob, context));
      return Cache<SphereModel>::Loaded{model, bytes_in_memory(*model)};
    });
  }

  // Makes the model's blob durable and describes it as a resource.
  Resource keep(ModelInfo& info, SphereModel&& model, Stopwatch& watch) {
    const auto staging = blobs.stage(std::numeric_limits<std::uint64_t>::max());
    write_model(model, [&](std::string_view piece) { staging->append(piece); });
    Resource resource;
    resource.id = info.id;
    resource.collection = kModels;
    resource.bytes = staging->size();
    resource.blobs = {staging->commit("models/" + info.id)};
    watch.lap("store");
    info.timings_s = watch.seconds();
    info.created = now();
    resource.document = api::record_of(info);
    cache.get_or_load(info.id, [&] {
      const std::size_t bytes = bytes_in_memory(model);
      return Cache<SphereModel>::Loaded{std::make_shared<const SphereModel>(std::move(model)), bytes};
    });
    return resource;
  }

  Resource run_model(const JobRecord& record, JobContext& job) {
    const api::ModelRequest request = api::model_request_from(record.request);
    Context context = job.context(0, 1);
    context.progress = [whole = context.progress](std::string_view stage, double part) {
      const auto found = std::ranges::find(kShares, stage, &Share::stage);
      whole(stage, found == kShares.end() ? 0 : found->from + part * (found->to - found->from));
    };
    Stopwatch watch;
    context.report("read", 0);
    const Volume volume = stored_volume(find_volume(request.volume), context);
    watch.lap("read");

    ModelInfo info;
    info.id = record.result_id;
    info.algorithm_version = version();
    info.source = request;
    info.voxels = measure_voxels(volume.grid, classify_samples(volume, request.rule, context).inside);
    watch.lap("voxels");

    BuiltModel built = build_model(volume, request.rule, {.max_points = config.max_boundary_points}, context);
    for (const StageTime& time : built.timings) watch.set(time.stage, time.seconds);
    info.warnings = std::move(built.warnings);
    for (const std::string& warning : info.warnings) job.warn(warning);
    const Solid& solid = *built.model.solid;
    info.boundary_points = solid.boundary.points.size();
    info.tetrahedra = solid.cells.size();
    info.inside_tetrahedra = solid.inside_count;
    info.spheres = built.model.spheres.size();
    info.boundary_point_density_mm = built.boundary_point_density_mm;
    info.bounds = bounds(built.model);

    context.report("store", 0);
    context.throw_if_cancelled();
    watch.restart();
    Resource resource = keep(info, std::move(built.model), watch);
    resource.request = record.request;
    resource.inputs = {request.volume};
    return resource;
  }

  static std::string contributions_id(const std::string& model) {
    return content_id("ans", api::identity_of({.model = model, .what = api::ContributionsRequest{}}, version()));
  }

  UnionMeasures read_union_of(const Resource& answer, const SphereModel& model) const {
    const Blob blob = blobs.open(answer.blobs.at(0));
    blob.verify();
    UnionMeasures whole = read_union(blob);
    if (whole.parts.size() != model.spheres.size()) {
      throw Error(ErrorCode::corrupt, "The stored measures are of another model; delete the model and make it again.");
    }
    return whole;
  }

  // Makes the measures of a model's union durable.
  Resource keep(const std::string& model, const UnionMeasures& whole) {
    const auto staging = blobs.stage(std::numeric_limits<std::uint64_t>::max());
    write_union(whole, [&](std::string_view piece) { staging->append(piece); });
    Resource answer;
    answer.id = contributions_id(model);
    answer.collection = kAnswers;
    answer.request = api::record_of({.model = model, .what = api::ContributionsRequest{}});
    answer.inputs = {model};
    answer.bytes = staging->size();
    answer.blobs = {staging->commit("answers/" + answer.id)};
    return answer;
  }

  // As kept, or measured and kept: several answers need it, and it takes longest.
  UnionMeasures union_of(const Resource& resource, const SphereModel& model, const Context& context) {
    if (const auto known = catalog.find(contributions_id(resource.id))) return read_union_of(*known, model);
    UnionMeasures whole = measure_union(model, context);
    publish(catalog, blobs, keep(resource.id, whole));
    return whole;
  }

  std::string measures(const Resource& resource, const SphereModel& model, JobContext& job) {
    std::optional<Volume> volume;
    const std::optional<api::ModelRequest> source = api::model_from(resource.document).source;
    if (source) volume.emplace(stored_volume(find_volume(source->volume), job.context(0.1, 0.15)));
    const UnionMeasures whole = union_of(resource, model, job.context(0.15, 0.5));
    std::optional<MeasuredObject> object;
    if (source) object.emplace(MeasuredObject{*volume, source->rule});
    return api::measures_document(resource.id, measure_model(model, whole, object, job.context(0.5, 0.95)));
  }

  std::string exported(const Resource& resource, const SphereModel& model, const api::ExportRequest& wanted,
                       const Context& context) {
    std::optional<Contributions> known;
    if (wanted.listing.needs_contributions()) known.emplace(union_of(resource, model, context));
    api::SpherePage listed;
    std::span<const Sphere> spheres = model.spheres;
    if (wanted.listing.order != api::SphereOrder::index || !wanted.listing.columns.empty()) {
      listed = rows(model, known ? &*known : nullptr, wanted.listing, 0, model.spheres.size());
      spheres = listed.spheres;
    }
    switch (wanted.format) {
      case api::SphereFormat::csv: return spheres_to_csv(spheres, listed.columns);
      case api::SphereFormat::npy: return spheres_to_npy(spheres, listed.columns);
      case api::SphereFormat::ply: return spheres_to_ply(spheres, listed.columns);
      case api::SphereFormat::vtp: break;
    }
    return spheres_to_vtp(spheres, listed.columns);
  }

  std::string checks(const Resource& resource, const SphereModel& model, JobContext& job) {
    const api::ModelRequest source = *api::model_from(resource.document).source;
    const Volume volume = stored_volume(find_volume(source.volume), job.context(0.1, 0.2));
    const InsideSamples samples = classify_samples(volume, source.rule, job.context(0.2, 0.25));
    return api::checks_document(resource.id,
                                check_model(model, samples.inside, source.rule.border, job.context(0.25, 0.95)));
  }

  // The marching-cubes surface of the object that a model was made of.
  Mesh surface_of(const Resource& resource, const SphereModel& model, const Context& context) const {
    const std::optional<api::ModelRequest> source = api::model_from(resource.document).source;
    if (!source || !model.solid) {
      throw Error(ErrorCode::unusable,
                  "This model was not made from a volume, so it has no surface; draw the spheres, or the model that "
                  "it was made from.");
    }
    const Volume volume = stored_volume(find_volume(source->volume), context);
    const InsideSamples samples = classify_samples(volume, source->rule, context);
    return marching_cubes(volume, source->rule, samples, model.solid->boundary, context);
  }

  std::string pictures(const Resource& resource, const std::shared_ptr<const SphereModel>& model,
                       const api::RenderRequest& wanted, JobContext& job) {
    std::vector<Resource> resources{resource};
    std::vector<std::shared_ptr<const SphereModel>> models{model};
    if (!wanted.with.empty()) {
      resources.push_back(find_model(wanted.with));
      models.push_back(load(resources.back(), job.context(0.1, 0.15)));
    }
    std::vector<Mesh> surfaces(models.size());
    std::vector<std::vector<double>> volumes(models.size());
    std::vector<Subject> subjects;
    for (std::size_t i = 0; i < models.size(); ++i) {
      if (wanted.options.style == Style::surface) {
        surfaces[i] = surface_of(resources[i], *models[i], job.context(0.15, 0.3));
      }
      if (wanted.options.colour_by == ColourBy::contribution) {
        for (const BallPart& part : union_of(resources[i], *models[i], job.context(0.15, 0.3)).parts) {
          volumes[i].push_back(part.volume_mm3);
        }
      }
      subjects.push_back({.model = models[i].get(), .surface = &surfaces[i], .contributions_mm3 = volumes[i]});
    }
    const std::vector<Image> frames = render(subjects, wanted.options, job.context(0.3, 0.95));
    constexpr int kFramesPerSecond = 15;
    return wanted.options.turntable > 0 ? encode_gif(frames, kFramesPerSecond) : encode_png(frames.front());
  }

  Resource run_derived(const JobRecord& record, JobContext& job) {
    const DerivedRequest request = api::derived_from(record.request);
    const Resource resource = find_model(request.model);
    Context context = job.context(0, 0.1);
    context.report("load", 0);
    const std::shared_ptr<const SphereModel> model = load(resource, context);
    context = job.context(0.1, 0.95);
    context.report(record.kind, 0);
    if (std::holds_alternative<api::ContributionsRequest>(request.what)) {
      return keep(request.model, measure_union(*model, context));
    }
    std::string bytes;
    if (std::holds_alternative<api::MeasuresRequest>(request.what)) bytes = measures(resource, *model, job);
    if (std::holds_alternative<api::ChecksRequest>(request.what)) bytes = checks(resource, *model, job);
    if (const auto* render = std::get_if<api::RenderRequest>(&request.what)) {
      bytes = pictures(resource, model, *render, job);
    }
    if (const auto* wanted = std::get_if<api::ExportRequest>(&request.what)) {
      bytes = exported(resource, *model, *wanted, context);
    }
    context.throw_if_cancelled();
    job.context(0.95, 1).report("store", 0);
    Resource answer;
    answer.id = record.result_id;
    answer.collection = kAnswers;
    answer.request = record.request;
    answer.inputs = {request.model};
    if (const auto* render = std::get_if<api::RenderRequest>(&request.what);
        render != nullptr && !render->with.empty()) {
      answer.inputs.push_back(render->with);
    }
    answer.bytes = bytes.size();
    answer.blobs = {blobs.put("answers/" + record.result_id, bytes)};
    return answer;
  }

  // Waits for a job that makes something, and throws when it did not.
  JobStatus wait_for(JobStatus status, Seconds wait) {
    if (wait.count() > 0 && !is_over(status.record.state) && waiters.try_acquire()) {
      try {
        status = pool.wait(status.record.id, std::chrono::ceil<std::chrono::milliseconds>(wait));
      } catch (...) {
        waiters.release();
        throw;
      }
      waiters.release();
    }
    const JobRecord& record = status.record;
    if (record.state == JobState::cancelled || record.state == JobState::cancelling) {
      throw Error(ErrorCode::cancelled, "The job was cancelled; ask again to start another.");
    }
    if (record.state == JobState::failed) {
      if (record.error && record.error->code) throw Error(*record.error->code, record.error->sentence);
      throw std::runtime_error("a job failed");
    }
    return status;
  }

  // A mapped page of a list of the catalogue.
  template <typename T, typename F>
  api::Page<T> page(const char* collection, const api::PageRequest& wanted, F&& from) const {
    const Page<Resource> found = catalog.list(collection, wanted.cursor, wanted.limit);
    api::Page<T> result{.items = {}, .next = found.next};
    for (const Resource& resource : found.items) result.items.push_back(from(resource.document));
    return result;
  }
};

Pipeline::Pipeline(const Config& config, FaultLog log) : state_(std::make_unique<State>(config, std::move(log))) {}
Pipeline::~Pipeline() = default;

void Pipeline::stop(std::chrono::milliseconds grace) { state_->pool.stop(grace); }

api::About Pipeline::about() const {
  return {.version = std::string(api::program_version()), .algorithm_version = version()};
}

api::Limits Pipeline::limits() const {
  const Config& c = state_->config;
  return {.upload_bytes = c.max_body_bytes,
          .image_pixels = c.max_image_pixels,
          .longest_wait = std::chrono::seconds(c.max_wait_s)};
}

api::Readiness Pipeline::readiness() const {
  if (state_->blobs.free_bytes() == 0) return {false, "The disk is full; make room for the server's data."};
  if (state_->pool.load().queued >= state_->config.queue_length) {
    return {false, "The queue of jobs is full; try again when some are done."};
  }
  return {true, {}};
}

std::unique_ptr<api::Upload> Pipeline::start_upload(std::uint64_t announced) {
  return std::make_unique<FileUpload>(state_->blobs, state_->config.max_body_bytes, announced);
}

api::StoredVolume Pipeline::store_volume(std::unique_ptr<api::Upload> upload, const api::VolumeParameters& parameters) {
  State& s = *state_;
  auto& files = dynamic_cast<FileUpload&>(*upload).files();
  VolumeInfo info;
  info.parameters = parameters;
  for (const auto& [name, staging] : files) {
    info.files.push_back(
        {.name = files.size() > 1 ? name : std::string(), .sha256 = staging->sha256(), .bytes = staging->size()});
  }
  if (info.bytes() == 0) throw Error(ErrorCode::malformed, "The upload is empty; send the bytes of a volume.");
  info.id = content_id("vol", api::identity_of(info.files, parameters));
  if (const auto known = s.catalog.find(info.id)) return {api::volume_from(known->document), true};
  {
    const State::Permit permit(s);
    const Context context = s.request_context();
    std::vector<Blob> open;
    for (const auto& file : files) open.push_back(file.staging->open());
    const Volume volume = s.read(info.files, std::move(open), parameters, context);
    info.format = volume.format;
    info.grid = volume.grid;
    info.type = volume.type;
    info.slope = volume.slope;
    info.intercept = volume.intercept;
    info.natural_side = volume.natural_side;
    info.warnings = volume.warnings;
    info.range = value_range(volume, context);
  }
  Resource resource;
  resource.id = info.id;
  resource.collection = kVolumes;
  info.created = now();
  resource.document = api::record_of(info);
  resource.bytes = info.bytes();
  try {
    for (std::size_t i = 0; i < files.size(); ++i) {
      resource.blobs.push_back(files[i].staging->commit("volumes/" + info.id + "-" + std::to_string(i)));
    }
  } catch (...) {
    for (const std::string& key : resource.blobs) s.blobs.remove(key);
    throw;
  }
  const bool added = publish(s.catalog, s.blobs, resource);
  return {api::volume_from(s.find_volume(info.id).document), !added};
}

api::Page<VolumeInfo> Pipeline::volumes(const api::PageRequest& page) {
  return state_->page<VolumeInfo>(kVolumes, page, api::volume_from);
}

VolumeInfo Pipeline::volume(const std::string& id) { return api::volume_from(state_->find_volume(id).document); }

api::Content Pipeline::volume_content(const std::string& id, std::size_t index) {
  const Resource resource = state_->find_volume(id);
  if (index >= resource.blobs.size()) not_found("file");
  return content_of(state_->blobs.open(resource.blobs[index]));
}

std::vector<std::uint64_t> Pipeline::value_histogram(const std::string& id, std::size_t buckets) {
  const Resource resource = state_->find_volume(id);
  const State::Permit permit(*state_);
  const Context context = state_->request_context();
  return spherule::value_histogram(state_->stored_volume(resource, context), api::volume_from(resource.document).range,
                                   buckets, context);
}

void Pipeline::delete_volume(const std::string& id) {
  static_cast<void>(state_->find_volume(id));
  withdraw(state_->catalog, state_->blobs, id);
}

api::Outcome<api::StoredModel> Pipeline::make_model(const api::ModelRequest& request, Seconds wait) {
  State& s = *state_;
  static_cast<void>(s.find_volume(request.volume));
  const std::string id = content_id("mdl", api::identity_of(request, version()));
  if (const auto known = s.catalog.find(id)) return api::StoredModel{api::model_from(known->document), true};
  const JobStatus status = s.wait_for(s.pool.submit("model", id, api::record_of(request)), wait);
  if (status.record.state != JobState::succeeded) return job_info(status);
  return api::StoredModel{model(id), false};
}

api::StoredModel Pipeline::import_model(std::unique_ptr<api::Upload> upload, api::SphereFormat format) {
  State& s = *state_;
  const auto& staging = *dynamic_cast<FileUpload&>(*upload).files().front().staging;
  ModelInfo info;
  info.id = content_id(
      "mdl",
      api::identity_of(StoredFile{.name = {}, .sha256 = staging.sha256(), .bytes = staging.size()}, format, version()));
  if (const auto known = s.catalog.find(info.id)) return {api::model_from(known->document), true};
  info.algorithm_version = version();
  info.imported_format = api::name(format);
  Stopwatch watch;
  SphereModel model;
  {
    // Not while the cache is asked: who loads a model for it waits for a permit.
    const State::Permit permit(s);
    const Blob blob = staging.open();
    const Mapping mapping(blob);
    const ImportLimits limits{.max_spheres = s.config.max_spheres};
    model.spheres = format == api::SphereFormat::csv ? spheres_from_csv(mapping.text(), limits)
                                                     : spheres_from_npy(mapping.text(), limits);
  }
  watch.lap("read");
  info.spheres = model.spheres.size();
  info.bounds = bounds(model);
  const bool added = publish(s.catalog, s.blobs, s.keep(info, std::move(model), watch));
  return {this->model(info.id), !added};
}

api::Page<ModelInfo> Pipeline::models(const api::PageRequest& page) {
  return state_->page<ModelInfo>(kModels, page, api::model_from);
}

ModelInfo Pipeline::model(const std::string& id) { return api::model_from(state_->find_model(id).document); }

void Pipeline::delete_model(const std::string& id) {
  static_cast<void>(state_->find_model(id));
  withdraw(state_->catalog, state_->blobs, id);
  state_->cache.erase(id);
  state_->contributions.erase(State::contributions_id(id));
}

api::SpherePage Pipeline::spheres(const std::string& id, std::uint64_t offset, std::size_t limit,
                                  const api::SphereListing& listing) {
  State& s = *state_;
  const auto model = s.load(s.find_model(id), s.request_context());
  std::shared_ptr<const Contributions> contributions;
  if (listing.needs_contributions()) {
    const Resource answer = s.find(State::contributions_id(id), kAnswers, "measure");
    contributions = s.contributions.get_or_load(answer.id, [&] {
      const State::Permit permit(s);
      const auto loaded = std::make_shared<const Contributions>(s.read_union_of(answer, *model));
      return Cache<Contributions>::Loaded{loaded, loaded->bytes()};
    });
  }
  return rows(*model, contributions.get(), listing, offset, limit);
}

RadiusHistogram Pipeline::radius_histogram(const std::string& id, std::size_t buckets, RadiusScale scale) {
  const auto model = state_->load(state_->find_model(id), state_->request_context());
  return spherule::radius_histogram(model->spheres, buckets, scale);
}

api::Outcome<api::Content> Pipeline::derive(const DerivedRequest& request, Seconds wait) {
  State& s = *state_;
  const Resource model = s.find_model(request.model);
  if (std::holds_alternative<api::ChecksRequest>(request.what) && model.inputs.empty()) {
    throw Error(ErrorCode::unusable, "Imported spheres have no scan to be checked against; ask for their measures.");
  }
  if (const auto* render = std::get_if<api::RenderRequest>(&request.what); render != nullptr && !render->with.empty()) {
    static_cast<void>(s.find_model(render->with));
  }
  const std::string id = content_id("ans", api::identity_of(request, version()));
  if (const auto known = s.catalog.find(id)) return content_of(s.blobs.open(known->blobs.at(0)));
  const JobStatus status = s.wait_for(s.pool.submit(kind_of(request), id, api::record_of(request)), wait);
  if (status.record.state != JobState::succeeded) return job_info(status);
  return content_of(s.blobs.open(s.find(id, kAnswers, "model").blobs.at(0)));
}

api::Page<JobInfo> Pipeline::jobs(const api::PageRequest& page) {
  const Page<JobStatus> found = state_->pool.list(page.cursor, page.limit);
  api::Page<JobInfo> result{.items = {}, .next = found.next};
  for (const JobStatus& status : found.items) result.items.push_back(job_info(status));
  return result;
}

JobInfo Pipeline::job(const std::string& id) { return job_info(state_->pool.status(id)); }

api::JobEvents Pipeline::job_events(const std::string& id, std::uint64_t after, Seconds wait) {
  const JobEvents found = state_->pool.events(id, after, std::chrono::ceil<std::chrono::milliseconds>(wait));
  api::JobEvents result{.events = {}, .over = found.over};
  for (const JobEvent& event : found.events) {
    result.events.push_back({.number = event.number,
                             .type = static_cast<api::JobEvent::Type>(event.type),
                             .state = api_state(event.state),
                             .stage = event.stage,
                             .progress = event.progress,
                             .warning = event.warning});
  }
  return result;
}

JobInfo Pipeline::cancel_job(const std::string& id) { return job_info(state_->pool.cancel(id)); }

}  // namespace spherule::server
