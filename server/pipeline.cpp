// SPDX-License-Identifier: GPL-3.0-or-later
#include "server/pipeline.h"

#include <unistd.h>

#include <algorithm>
#include <array>
#include <condition_variable>
#include <functional>
#include <mutex>
#include <stdexcept>
#include <stop_token>
#include <thread>
#include <utility>

#include "api/json/documents.h"
#include "api/json/registration_documents.h"
#include "api/routes.h"
#include "core/spheres.h"
#include "core/write/export.h"
#include "server/intake/resumable.h"
#include "server/intake/upload.h"
#include "server/metrics.h"
#include "server/records/replies.h"
#include "server/records/store.h"
#include "server/work/answer_job.h"
#include "server/work/estimates.h"
#include "server/work/memory.h"
#include "server/work/model_job.h"
#include "server/work/places.h"
#include "server/work/registration_job.h"
#include "server/work/simplification_job.h"

namespace spherule::server {

namespace {

using api::DerivedRequest;
using api::JobInfo;
using api::ModelInfo;
using api::StoredFile;
using api::VolumeInfo;
using Seconds = api::Service::Seconds;

// Requests that wait for a job hold a thread each; beyond this many they are told to poll.
constexpr std::size_t kWaiters = 64;
// How often a request's work looks whether somebody still waits for it.
constexpr std::chrono::milliseconds kLooks{50};
// How long unfinished uploads and the replies under idempotency keys are kept.
constexpr std::chrono::hours kKeepUploads{24}, kKeepReplies{24};
constexpr std::size_t kMostUploads = 1000;

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

// Empty when the record of what was asked cannot be read, such as that of a picture with options of old.
std::string path_of_result(const JobRecord& record) try {
  if (record.kind == registration_kind) return "/v1/registrations/" + record.result_id;
  if (record.kind == registration_answer_kind) return api::path_of(api::registration_answer_from(record.request));
  if (record.kind == "model" || record.kind == "simplification") return "/v1/models/" + record.result_id;
  return api::path_of(api::derived_from(record.request));
} catch (const Error& error) {
  if (error.code() != ErrorCode::corrupt) throw;
  return {};
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
  if (record.state == JobState::succeeded) job.result = path_of_result(record);
  return job;
}

std::string kind_of(const DerivedRequest& request) {
  constexpr std::array<const char*, 9> kinds = {"measures", "checks", "render", "export",   "contributions",
                                                "slice",    "tree",   "export", "histogram"};
  return kinds[request.what.index()];
}

Resource run(Store& store, const JobRecord& record, JobContext& context) {
  if (record.kind == "model") return run_model(store, record, context);
  if (record.kind == "simplification") return run_simplification(store, record, context);
  if (record.kind == registration_kind) return run_registration(store, record, context);
  if (record.kind == registration_answer_kind) return run_registration_answer(store, record, context);
  return run_answer(store, record, context);
}

// Ids of the resources that a job works on. Throws corrupt for a damaged record.
std::vector<std::string> inputs_of(const JobRecord& record) {
  if (record.kind == "model") return {api::model_request_from(record.request).volume};
  if (record.kind == "simplification") return {api::simplification_request_from(record.request).model};
  if (record.kind == registration_answer_kind) return {api::registration_answer_from(record.request).registration};
  if (record.kind == registration_kind) {
    const api::RegistrationRequest request = api::registration_request_from(record.request);
    return {request.fixed, request.moving};
  }
  const DerivedRequest request = api::derived_from(record.request);
  if (const auto* slice = std::get_if<api::SliceRequest>(&request.what)) return {slice->volume};
  if (const auto* values = std::get_if<api::ValuesRequest>(&request.what)) return {values->volume};
  std::vector<std::string> inputs{request.model};
  if (const auto* render = std::get_if<api::RenderRequest>(&request.what); render != nullptr && !render->with.empty()) {
    inputs.push_back(render->with);
  }
  return inputs;
}

// Stops the work of a request when nobody waits for it any more or the server stops.
class Attention {
 public:
  Attention(const api::Gone& gone, const std::stop_token& server)
      : server_stops_(server, [this] { work_.request_stop(); }) {
    if (gone) watch_ = std::jthread([this, &gone](const std::stop_token& over) { watch(gone, over); });
  }
  std::stop_token token() const { return work_.get_token(); }

 private:
  void watch(const api::Gone& gone, const std::stop_token& over) {
    std::mutex mutex;
    std::condition_variable_any wake;
    std::unique_lock lock(mutex);
    do {
      if (is_gone(gone)) {
        work_.request_stop();
        return;
      }
    } while (!wake.wait_for(lock, over, kLooks, [&] { return over.stop_requested(); }));
  }
  static bool is_gone(const api::Gone& gone) noexcept {
    try {
      return gone();
    } catch (...) {
      return false;  // it is not known; the next look may tell
    }
  }

  std::stop_source work_;
  std::stop_callback<std::function<void()>> server_stops_;
  std::jthread watch_;
};

// The level of a model that is meant: 0 for all of it. Throws where it has no such level, and where it has none at all
// but they are needed.
std::uint32_t level_of(const ModelInfo& model, std::uint32_t wanted, bool needed) {
  if (wanted == 0 && !needed) return 0;
  if (!model.simplification) {
    throw Error(ErrorCode::unusable, "Only simplified models have levels and members; simplify the model first.");
  }
  const std::uint32_t last = model.simplification->levels;
  if (wanted > last) {
    const std::string sentence =
        "Give a level within 1 and " + std::to_string(last) + ", which shows the most spheres.";
    throw Error(ErrorCode::invalid_argument, sentence, {{"level", sentence}});
  }
  return wanted == last ? 0 : wanted;
}

// Memory that a request holds.
struct Taken {
  JobPool::Memory memory{};
  std::uint64_t bytes = 0;
};

}  // namespace

struct Pipeline::State {
  // Jobs come after the store, which they use.
  Store store;
  ResumableUploads uploads;
  ReplyBook replies;
  MetricSource more;
  Places waiters{kWaiters};
  PipelineLogs logs;
  std::stop_source stopped;  // what requests do by themselves
  JobPool pool;
  std::mutex mutex;
  std::condition_variable_any wake;
  std::jthread sweeper;  // of what is over its time

  State(const Config& config, PipelineLogs given, MetricSource others)
      : store(config, given.aside, given.expired),
        uploads(config.data / "uploads", config.max_body_bytes, kKeepUploads, kMostUploads, store.surroundings()),
        replies(config.data / "replies", kKeepReplies, store.surroundings()),
        more(std::move(others)),
        logs(std::move(given)),
        pool(
            {.jobs_at_once = config.jobs_at_once,
             .threads_per_job = config.threads_per_job(),
             .queue_length = config.queue_length,
             .queue_per_client = config.queue_per_client,
             .memory_bytes = config.job_memory_bytes,
             .longest_run = std::chrono::seconds(config.max_job_s)},
            store.catalog, store.blobs,
            [this](const JobRecord& record, JobContext& context) { return run(store, record, context); }, logs.fault,
            logs.job_ended) {
    sweeper = std::jthread([this](const std::stop_token& stop) { sweep(stop); });
  }

  // For what a request does by itself.
  Context request_context() const {
    return {.threads = store.config.threads_per_job(), .cancel = stopped.get_token(), .progress = {}};
  }

  // Every hour, or ten times within the shortest time that anything is kept.
  void sweep(const std::stop_token& stop) {
    std::chrono::seconds period{3600};
    std::vector<Keeping> times = store.keeping();
    times.push_back({"jobs", store.config.keep_jobs});
    for (const Keeping& keep : times) {
      if (keep.unused.count() > 0) period = std::min(period, std::max(keep.unused / 10, std::chrono::seconds(1)));
    }
    std::unique_lock lock(mutex);
    while (!stop.stop_requested()) {
      try {
        sweep_once();
      } catch (const std::exception& error) {
        if (logs.fault) logs.fault("retention", error.what());
      } catch (...) {
        if (logs.fault) logs.fault("retention", "an exception of unknown type");
      }
      wake.wait_for(lock, stop, period, [] { return false; });
    }
    try {
      store.catalog.note_time();
    } catch (const Error&) {
      // What was served since the last time does not count, so that things are kept a little longer.
    }
  }

  void sweep_once() {
    const auto moved = store.catalog.note_time();
    store.catalog.reserve_room();
    if (is_jump(moved)) {
      if (logs.clock_moved) logs.clock_moved(std::chrono::round<std::chrono::seconds>(moved));
      return;
    }
    const Time served = store.catalog.served();
    expire(store.catalog, store.keeping(), served, [&](const std::string& id) {
      remove(id);
      if (logs.expired) logs.expired(id);
    });
    if (store.config.keep_jobs.count() > 0) store.catalog.forget_jobs(served - store.config.keep_jobs);
  }

  // Takes as much memory for a request's own work as it needs by now, waiting as long as a request may.
  void take(std::uint64_t bytes, Taken& taken, const Context& context) {
    if (bytes <= taken.bytes) return;
    taken = {};  // so that nobody waits for more while holding some
    taken = {pool.reserve(bytes, std::chrono::seconds(store.config.max_wait_s), context.cancel), bytes};
  }

  // What is read for a request and held until its end adds up.
  Store::Admit admit_to(Taken& taken, const Context& context) {
    return [&](std::uint64_t bytes) { take(taken.bytes + bytes, taken, context); };
  }

  // Deletes a thing with all that was made from it, and ends the jobs that work on any of these.
  void remove(const std::string& id) {
    store.remove(id);
    const auto pointless = [&](const JobRecord& job) {
      try {
        return std::ranges::any_of(inputs_of(job), [&](const auto& input) { return !store.catalog.find(input); });
      } catch (const Error&) {
        return false;  // it will fail by itself
      }
    };
    pool.abandon(pointless, {ErrorCode::conflict, "What this work is made from was deleted; there is no more to do."});
  }

  struct Awaited {
    JobStatus status;
    bool in_full = false;  // until the job was over, or as long as was asked for
    JobInfo info() const {
      JobInfo job = job_info(status);
      job.awaited = in_full;
      return job;
    }
  };

  // Waits for a client's job that makes something, and throws when it did not.
  Awaited wait_for(JobStatus status, const std::string& client, Seconds wait) {
    bool in_full = false;
    if (wait.count() > 0 && !is_over(status.record.state)) {
      if (const auto place = waiters.take(client)) {
        const auto end = std::chrono::steady_clock::now() + wait;
        status = pool.wait(status.record.id, std::chrono::ceil<std::chrono::milliseconds>(wait));
        in_full = is_over(status.record.state) || std::chrono::steady_clock::now() >= end;
      }
    }
    const JobRecord& record = status.record;
    if (record.state == JobState::cancelled || record.state == JobState::cancelling) {
      throw Error(ErrorCode::cancelled, "The job was cancelled; ask again to start another.");
    }
    if (record.state == JobState::failed) {
      if (record.error && record.error->code) throw Error(*record.error->code, record.error->sentence);
      throw std::runtime_error("a job failed");
    }
    return {std::move(status), in_full};
  }

  // The model of this id as it is, or of a job of this kind.
  api::Outcome<api::StoredModel> model_of(const char* kind, const std::string& id, const std::string& request,
                                          const std::string& client, std::uint64_t memory, Seconds wait) {
    if (const auto known = store.find_any(id)) return api::StoredModel{api::model_from(known->document), true};
    const Awaited job = wait_for(pool.submit(kind, id, request, client, memory), client, wait);
    if (job.status.record.state != JobState::succeeded) return job.info();
    return api::StoredModel{api::model_from(store.find_model(id).document), false};
  }

  // The bytes of the answer of this id: as they are kept, or of a job of this kind.
  api::Outcome<api::Content> answer_of(const std::string& kind, const std::string& id, const std::string& request,
                                       const std::string& client, std::uint64_t memory, Seconds wait) {
    if (const auto known = store.find_any(id)) {
      try {
        return content_of(store.intact(known->blobs.at(0)));
      } catch (const Error& error) {
        if (error.code() != ErrorCode::corrupt && error.code() != ErrorCode::not_found) throw;
        if (logs.damaged) logs.damaged(id);
        store.remove(id);
      }
    }
    const Awaited job = wait_for(pool.submit(kind, id, request, client, memory), client, wait);
    if (job.status.record.state != JobState::succeeded) return job.info();
    return content_of(store.intact(store.find(id, answers_collection, "answer").blobs.at(0)));
  }

  // A mapped page of a list of the catalogue.
  template <typename T, typename F>
  api::Page<T> page(const char* collection, const api::PageRequest& wanted, F&& from) const {
    Page<Resource> found = store.catalog.list(collection, wanted.cursor, wanted.limit);
    api::Page<T> result{.items = {}, .next = found.next, .damaged = std::move(found.damaged)};
    for (const Resource& resource : found.items) try {
        result.items.push_back(from(resource));
      } catch (const Error& error) {
        if (error.code() != ErrorCode::corrupt) throw;
        result.damaged.push_back(resource.id);
      }
    return result;
  }
};

Pipeline::Pipeline(const Config& config, PipelineLogs logs, MetricSource more)
    : state_(std::make_shared<State>(config, std::move(logs), std::move(more))) {}
Pipeline::~Pipeline() = default;

bool Pipeline::stop(std::chrono::milliseconds grace) {
  const bool at_rest = state_->pool.stop(grace);
  state_->stopped.request_stop();
  return at_rest;
}

api::About Pipeline::about() const {
  return {.version = std::string(api::program_version()), .algorithm_version = algorithm_version_text()};
}

api::Limits Pipeline::limits() const {
  const Config& c = state_->store.config;
  return {.upload_bytes = c.max_body_bytes,
          .image_pixels = c.max_image_pixels,
          .longest_wait = std::chrono::seconds(c.max_wait_s)};
}

api::Readiness Pipeline::readiness() const {
  if (state_->store.blobs.free_bytes() == 0) return {false, "The disk is full; make room for the server's data."};
  if (::access(state_->store.config.data.c_str(), W_OK) != 0) {
    return {false, "The data folder cannot be written; its operator must check the disk and the permissions."};
  }
  const JobPool::Load load = state_->pool.load();
  if (load.stopping) return {false, "The server is stopping; ask another one, or this one once it is back."};
  if (load.queued >= state_->store.config.queue_length) {
    return {false, "The queue of jobs is full; try again when some are done."};
  }
  return {true, {}};
}

std::unique_ptr<api::Upload> Pipeline::start_upload(std::uint64_t announced) {
  return std::make_unique<FileUpload>(state_->store.blobs, state_->store.config.max_body_bytes, announced,
                                      [&uploads = state_->uploads](std::uint64_t bytes) { uploads.check_room(bytes); });
}

api::StoredVolume Pipeline::store_volume(std::unique_ptr<api::Upload> upload, const api::VolumeParameters& parameters,
                                         const api::Gone& gone) {
  Store& s = state_->store;
  auto& arrived = dynamic_cast<FileUpload&>(*upload);
  arrived.unpack({.unpacked_bytes = s.config.max_decompressed_bytes});
  auto& files = arrived.files();
  VolumeInfo info;
  info.parameters = parameters;
  for (const auto& [name, staging] : files) {
    info.files.push_back(
        {.name = files.size() > 1 ? name : std::string(), .sha256 = staging->sha256(), .bytes = staging->size()});
  }
  if (info.bytes() == 0) throw Error(ErrorCode::malformed, "The upload is empty; send the bytes of a volume.");
  info.id = content_id("vol", api::identity_of(info.files, parameters));
  if (const auto known = s.catalog.find(info.id)) return {api::volume_from(known->document), true};
  const Attention attention(gone, state_->stopped.get_token());
  try {
    Context context = state_->request_context();
    context.cancel = attention.token();
    Taken taken;
    const Volume volume = s.read(
        info.files, [&](std::size_t file) { return files[file].staging->open(); }, parameters, context,
        [&](std::size_t bytes) { state_->take(bytes, taken, context); });
    info.format = volume.format;
    info.grid = volume.grid;
    info.type = volume.type;
    info.slope = volume.slope;
    info.intercept = volume.intercept;
    info.natural_side = volume.natural_side;
    info.warnings = volume.warnings;
    info.range = value_range(volume, context);
  } catch (const Error& error) {
    if (error.code() != ErrorCode::cancelled || !state_->stopped.stop_requested()) throw;
    throw Error(ErrorCode::busy, "The server is stopping; send the volume again once it is back.");
  }
  Resource resource;
  resource.id = info.id;
  resource.collection = volumes_collection;
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
  return state_->page<VolumeInfo>(volumes_collection, page,
                                  [](const Resource& resource) { return api::volume_from(resource.document); });
}

VolumeInfo Pipeline::volume(const std::string& id) { return api::volume_from(state_->store.find_volume(id).document); }

api::Content Pipeline::volume_content(const std::string& id, std::size_t index) {
  const Resource resource = state_->store.find_volume(id);
  if (index >= resource.blobs.size()) not_found("file");
  return content_of(state_->store.intact(resource.blobs[index]));
}

api::Outcome<std::vector<std::uint64_t>> Pipeline::value_histogram(const std::string& id, std::size_t buckets,
                                                                   Seconds wait) {
  const auto counted = derive({.model = {}, .what = api::ValuesRequest{id, buckets}}, wait);
  const auto* content = std::get_if<api::Content>(&counted);
  if (content == nullptr) return std::get<JobInfo>(counted);
  std::string record(content->bytes, '\0');
  record.resize(content->read_at(0, record));
  return api::counts_from(record);
}

void Pipeline::delete_volume(const std::string& id) {
  state_->store.require(id, volumes_collection, "volume");
  state_->remove(id);
}

api::Outcome<api::StoredModel> Pipeline::make_model(const api::ModelRequest& request, Seconds wait) {
  const std::uint64_t memory = memory_for(state_->store, request);
  const std::string id = content_id("mdl", api::identity_of(request, algorithm_version_text()));
  return state_->model_of("model", id, api::record_of(request), client_, memory, wait);
}

api::Outcome<api::StoredModel> Pipeline::simplify_model(const api::SimplificationRequest& request, Seconds wait) {
  const ModelInfo source = model(request.model);
  check_method(request.method, source.spheres);
  const std::uint64_t memory = memory_for(state_->store, request);
  const std::string id = content_id("mdl", api::identity_of(request, algorithm_version_text()));
  return state_->model_of("simplification", id, api::record_of(request), client_, memory, wait);
}

api::StoredModel Pipeline::import_model(std::unique_ptr<api::Upload> upload, api::SphereFormat format) {
  Store& s = state_->store;
  const auto& staging = *dynamic_cast<FileUpload&>(*upload).files().front().staging;
  ModelInfo info;
  info.id =
      content_id("mdl", api::identity_of(StoredFile{.name = {}, .sha256 = staging.sha256(), .bytes = staging.size()},
                                         format, algorithm_version_text()));
  if (const auto known = s.catalog.find(info.id)) return {api::model_from(known->document), true};
  info.algorithm_version = algorithm_version_text();
  info.imported_format = api::name(format);
  Stopwatch watch;
  SphereModel model;
  const Context context = state_->request_context();
  {
    const Blob blob = staging.open();
    const Mapping mapping(blob);
    const auto lines = format == api::SphereFormat::csv ? std::ranges::count(mapping.text(), '\n') : 0;
    Taken taken;
    state_->take(memory_to_import(format, blob.size(), static_cast<std::uint64_t>(lines)), taken, context);
    const ImportLimits limits{.max_spheres = s.config.max_spheres};
    model.spheres = format == api::SphereFormat::csv ? spheres_from_csv(mapping.text(), limits)
                                                     : spheres_from_npy(mapping.text(), limits);
  }
  watch.lap("read");
  info.spheres = model.spheres.size();
  info.bounds = bounds(model);
  const bool added = publish(s.catalog, s.blobs, s.keep(info, std::move(model), watch, context));
  return {this->model(info.id), !added};
}

api::Page<ModelInfo> Pipeline::models(const api::PageRequest& page) {
  return state_->page<ModelInfo>(models_collection, page,
                                 [](const Resource& resource) { return api::model_from(resource.document); });
}

ModelInfo Pipeline::model(const std::string& id) { return api::model_from(state_->store.find_model(id).document); }

void Pipeline::delete_model(const std::string& id) {
  state_->store.require(id, models_collection, "model");
  state_->remove(id);
}

api::SpherePage Pipeline::spheres(const std::string& id, std::uint32_t level, std::uint64_t offset, std::size_t limit,
                                  const api::SphereListing& listing, bool members) {
  Store& s = state_->store;
  const Resource resource = s.find_model(id);
  level = level_of(api::model_from(resource.document), level, listing.needs_levels() || members);
  const Context context = state_->request_context();
  Taken taken;
  const Store::Admit admit = state_->admit_to(taken, context);
  const auto model = s.load(resource, level, context, admit);
  const ListedParts parts = s.listed_parts(resource, listing, members, context, admit);
  std::shared_ptr<const Contributions> contributions;
  if (listing.needs_contributions()) {
    const Resource answer = s.find(Store::contributions_id(id, level), answers_collection, "measure");
    contributions = s.contributions.get_or_load(answer.id, [&] {
      admit(answer.bytes);
      const Store::Permit permit(s, context);
      const auto loaded = std::make_shared<const Contributions>(s.read_union_of(answer, *model, context));
      return Cache<Contributions>::Loaded{loaded, loaded->bytes()};
    });
  }
  return rows({*model, contributions.get(), parts.levels.get(), level, parts.source.get()}, listing, members, offset,
              limit);
}

RadiusHistogram Pipeline::radius_histogram(const std::string& id, std::size_t buckets, RadiusScale scale) {
  const Context context = state_->request_context();
  Taken taken;
  const auto model = state_->store.load(state_->store.find_model(id), context, state_->admit_to(taken, context));
  return spherule::radius_histogram(model->spheres, buckets, scale);
}

api::Outcome<api::Content> Pipeline::derive(const DerivedRequest& wanted, Seconds wait) {
  Store& s = state_->store;
  DerivedRequest request = wanted;
  if (!std::holds_alternative<api::SliceRequest>(request.what) &&
      !std::holds_alternative<api::ValuesRequest>(request.what)) {
    const ModelInfo model = this->model(request.model);
    if (!model.source && std::holds_alternative<api::ChecksRequest>(request.what)) {
      throw Error(ErrorCode::unusable,
                  "Only models made from a scan can be checked against it; ask for this one's measures.");
    }
    const auto* listed = std::get_if<api::ExportRequest>(&request.what);
    const auto* tree = std::get_if<api::TreeRequest>(&request.what);
    request.level =
        level_of(model, request.level, tree != nullptr || (listed != nullptr && listed->listing.needs_levels()));
    if (tree != nullptr && !tree->levels.empty()) static_cast<void>(level_of(model, tree->levels.back(), true));
  }
  const std::uint64_t memory = memory_for(s, request);
  const std::string id = content_id("ans", api::identity_of(request, algorithm_version_text()));
  return state_->answer_of(kind_of(request), id, api::record_of(request), client_, memory, wait);
}

api::Outcome<api::StoredRegistration> Pipeline::register_pair(const api::RegistrationRequest& request, Seconds wait) {
  Store& s = state_->store;
  const std::uint64_t memory = memory_for(s, request);
  const std::string id = content_id("reg", api::identity_of(request, algorithm_version_text()));
  if (const auto known = s.find_any(id)) return api::StoredRegistration{registration_info(*known), true};
  const State::Awaited job = state_->wait_for(
      state_->pool.submit(registration_kind, id, api::record_of(request), client_, memory), client_, wait);
  if (job.status.record.state != JobState::succeeded) return job.info();
  return api::StoredRegistration{registration(id), false};
}

api::Page<api::RegistrationInfo> Pipeline::registrations(const api::PageRequest& wanted) {
  return state_->page<api::RegistrationInfo>(registrations_collection, wanted, registration_info);
}

api::RegistrationInfo Pipeline::registration(const std::string& id) {
  return registration_info(state_->store.find(id, registrations_collection, "registration"));
}

void Pipeline::delete_registration(const std::string& id) {
  state_->store.require(id, registrations_collection, "registration");
  state_->remove(id);
}

api::Outcome<api::Content> Pipeline::derive_from(const api::RegistrationAnswerRequest& request, Seconds wait) {
  const std::uint64_t memory = memory_for(state_->store, request);
  const std::string id = content_id("ans", api::identity_of(request, algorithm_version_text()));
  return state_->answer_of(registration_answer_kind, id, api::record_of(request), client_, memory, wait);
}

api::Page<JobInfo> Pipeline::jobs(const api::PageRequest& page) {
  const Page<JobStatus> found = state_->pool.list(page.cursor, page.limit);
  api::Page<JobInfo> result{.items = {}, .next = found.next, .damaged = found.damaged};
  for (const JobStatus& status : found.items) result.items.push_back(job_info(status));
  return result;
}

JobInfo Pipeline::job(const std::string& id) { return job_info(state_->pool.status(id)); }

api::JobEvents Pipeline::job_events(const std::string& id, std::uint64_t after, Seconds wait) {
  const JobEvents found = state_->pool.events(id, after, std::chrono::ceil<std::chrono::milliseconds>(wait));
  api::JobEvents result{.events = {}, .over = found.over, .stopping = found.stopping};
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

std::optional<JobInfo> Pipeline::cancel_job(const std::string& id) {
  if (const auto job = state_->pool.cancel(id, client_)) return job_info(*job);
  if (scope_ < Scope::admin) return std::nullopt;
  return job_info(state_->pool.cancel_for_all(id));
}

api::UploadInfo Pipeline::create_upload(std::uint64_t length, const std::string& filename) {
  return state_->uploads.create(length, filename);
}

api::UploadInfo Pipeline::upload(const std::string& id) { return state_->uploads.find(id); }

api::UploadInfo Pipeline::append_upload(const std::string& id, std::uint64_t offset,
                                        const std::function<void(const TakeBytes&)>& feed) {
  return state_->uploads.append(id, offset, feed);
}

void Pipeline::read_upload(const std::string& id, const TakeBytes& take) { state_->uploads.read(id, take); }

void Pipeline::delete_upload(const std::string& id) { state_->uploads.remove(id); }

// Clients do not see each other's replies, whatever keys they choose.
std::string Pipeline::own(const std::string& key) const { return client_ + " " + key; }

std::optional<std::string> Pipeline::recall_reply(const std::string& key) { return state_->replies.recall(own(key)); }

void Pipeline::keep_reply(const std::string& key, const std::string& reply) { state_->replies.keep(own(key), reply); }

void Pipeline::release_reply(const std::string& key) { state_->replies.release(own(key)); }

std::vector<api::Metric> Pipeline::metrics() {
  Store& s = state_->store;
  const JobPool::Load load = state_->pool.load();
  std::vector<api::Metric> all = state_->more ? state_->more() : std::vector<api::Metric>();
  all.push_back({"spherule_jobs",
                 "gauge",
                 "Jobs that are not over.",
                 {{"", {{"state", "queued"}}, static_cast<double>(load.queued)},
                  {"", {{"state", "running"}}, static_cast<double>(load.running)}}});
  api::Metric ended{"spherule_jobs_ended_total", "counter", "Jobs that are over, by how they ended.", {}};
  for (const auto& [what, count] : load.ended) {
    ended.samples.push_back(
        {"", {{"kind", what.first}, {"state", std::string(to_string(what.second))}}, static_cast<double>(count)});
  }
  all.push_back(std::move(ended));
  all.push_back(
      gauge("spherule_disk_free_bytes", "What can still be stored.", static_cast<double>(s.blobs.free_bytes())));
  for (auto& metric : metrics_of("model", s.cache.stats())) all.push_back(std::move(metric));
  for (auto& metric : metrics_of("contributions", s.contributions.stats())) all.push_back(std::move(metric));
  return all;
}

}  // namespace spherule::server
