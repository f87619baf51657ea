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
#include "api/json/records.h"
#include "api/json/registration_documents.h"
#include "api/json/work.h"
#include "api/routes.h"
#include "core/spheres.h"
#include "core/write/export.h"
#include "server/intake/resumable.h"
#include "server/intake/upload.h"
#include "server/metrics.h"
#include "server/records/replies.h"
#include "server/records/store.h"
#include "server/work/estimates.h"
#include "server/work/kinds.h"
#include "server/work/memory.h"
#include "server/work/places.h"

namespace spherule::server {

namespace {

using api::DerivedRequest;
using api::JobInfo;
using api::ModelInfo;
using api::RegistrationInfo;
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

api::Thing thing_of(const Resource& resource) {
  if (resource.collection == volumes_collection) return api::volume_from(resource.document);
  if (resource.collection == models_collection) return api::model_from(resource.document);
  return api::registration_from(resource.document, resource.request);
}

const char* word_for(api::Collection collection) {
  constexpr std::array words{"volume", "model", "registration"};
  return words[static_cast<std::size_t>(collection)];
}

// The id of what a request makes.
std::string result_id(const api::WorkRequest& request) {
  const bool derived = std::holds_alternative<DerivedRequest>(request);
  const bool registration = std::holds_alternative<api::RegistrationRequest>(request);
  return content_id(derived        ? "ans"
                    : registration ? "reg"
                                   : "mdl",
                    api::identity_of(request, algorithm_version_text()));
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
            [this](const JobRecord& record, JobContext& context) { return do_work(store, record, context); },
            logs.fault, logs.job_ended) {
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
      if (!job.request) return false;  // it will fail by itself
      return std::ranges::any_of(api::inputs_of(*job.request),
                                 [&](const std::string& input) { return !store.catalog.find(input); });
    };
    pool.abandon(pointless, {ErrorCode::conflict, "What this work is made from was deleted; there is no more to do."});
  }

  // Waits for a client's job that makes something, and throws when it did not.
  JobInfo wait_for(JobRecord job, const std::string& client, Seconds wait) {
    if (wait.count() > 0 && !is_over(job.state)) {
      if (const auto place = waiters.take(client)) {
        const auto end = std::chrono::steady_clock::now() + wait;
        job = pool.wait(job.id, std::chrono::ceil<std::chrono::milliseconds>(wait));
        job.awaited = is_over(job.state) || std::chrono::steady_clock::now() >= end;
      }
    }
    if (job.state == JobState::cancelled || job.state == JobState::cancelling) {
      throw Error(ErrorCode::cancelled, "The job was cancelled; ask again to start another.");
    }
    if (job.state == JobState::failed) {
      if (job.error && job.error->code) throw Error(*job.error->code, job.error->sentence);
      throw std::runtime_error("a job failed");
    }
    return job;
  }

  // What is kept under this id; nothing when it is not there, or is an answer that is damaged, which goes.
  std::optional<api::Made> known(const std::string& id, bool already_stored) {
    const auto resource = store.find_any(id);
    if (!resource) return std::nullopt;
    if (resource->collection == models_collection)
      return api::Stored<ModelInfo>{api::model_from(resource->document), already_stored};
    if (resource->collection == registrations_collection)
      return api::Stored<RegistrationInfo>{api::registration_from(resource->document, resource->request),
                                           already_stored};
    try {
      return content_of(store.intact(resource->blobs.at(0)));
    } catch (const Error& error) {
      if (error.code() != ErrorCode::corrupt && error.code() != ErrorCode::not_found) throw;
      if (logs.damaged) logs.damaged(id);
      store.remove(id);
      return std::nullopt;
    }
  }

  api::Page<api::Thing> list(api::Collection collection, const api::PageRequest& wanted) const {
    Page<Resource> found = store.catalog.list(std::string(name(collection)), wanted.cursor, wanted.limit);
    api::Page<api::Thing> page{.items = {}, .next = found.next, .damaged = std::move(found.damaged)};
    for (const Resource& resource : found.items) try {
        page.items.push_back(thing_of(resource));
      } catch (const Error& error) {
        if (error.code() != ErrorCode::corrupt) throw;
        page.damaged.push_back(resource.id);
      }
    return page;
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

api::Stored<VolumeInfo> Pipeline::store_volume(std::unique_ptr<api::Upload> upload,
                                               const api::VolumeParameters& parameters, const api::Gone& gone) {
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
  if (publish(s.catalog, s.blobs, resource)) return {std::move(info), false};
  return {find<VolumeInfo>(info.id), true};
}

api::Content Pipeline::content(const std::string& volume, std::size_t index) {
  const Resource resource = state_->store.find_volume(volume);
  if (index >= resource.blobs.size()) not_found("file");
  return content_of(state_->store.intact(resource.blobs[index]));
}

api::Thing Pipeline::find(api::Collection collection, const std::string& id) {
  return thing_of(state_->store.find(id, name(collection).data(), word_for(collection)));
}

api::Page<api::Thing> Pipeline::list(api::Collection collection, const api::PageRequest& page) {
  return state_->list(collection, page);
}

void Pipeline::remove(api::Collection collection, const std::string& id) {
  state_->store.require(id, name(collection).data(), word_for(collection));
  state_->remove(id);
}

api::Stored<ModelInfo> Pipeline::import_model(std::unique_ptr<api::Upload> upload, api::SphereFormat format) {
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
  return {find<ModelInfo>(info.id), !added};
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

// The request as it is kept: with the level that it means. Throws for what its model does not have.
DerivedRequest Pipeline::checked(DerivedRequest request) {
  if (api::kind_of(request).source != "model") return request;
  const auto model = find<ModelInfo>(request.source);
  if (!model.source && std::holds_alternative<api::ChecksRequest>(request.what)) {
    throw Error(ErrorCode::unusable,
                "Only models made from a scan can be checked against it; ask for this one's measures.");
  }
  const auto* listed = std::get_if<api::ExportRequest>(&request.what);
  const auto* tree = std::get_if<api::TreeRequest>(&request.what);
  request.level =
      level_of(model, request.level, tree != nullptr || (listed != nullptr && listed->listing.needs_levels()));
  if (tree != nullptr && !tree->levels.empty()) static_cast<void>(level_of(model, tree->levels.back(), true));
  return request;
}

api::Outcome Pipeline::submit(const api::WorkRequest& wanted, Seconds wait) {
  api::WorkRequest request = wanted;
  if (auto* derived = std::get_if<DerivedRequest>(&request)) *derived = checked(std::move(*derived));
  if (const auto* simplification = std::get_if<api::SimplificationRequest>(&request))
    check_method(simplification->method, find<ModelInfo>(simplification->model).spheres);
  State& s = *state_;
  const std::uint64_t memory = memory_for(s.store, request);
  const std::string id = result_id(request);
  if (auto made = s.known(id, true)) return std::move(*made);
  const JobInfo job = s.wait_for(s.pool.submit(request, id, client_, memory), client_, wait);
  if (job.state != JobState::succeeded) return job;
  auto made = s.known(id, false);
  if (!made) not_found("result");
  return std::move(*made);
}

api::Page<JobInfo> Pipeline::jobs(const api::PageRequest& page) {
  Page<JobRecord> found = state_->pool.list(page.cursor, page.limit);
  return {.items = {found.items.begin(), found.items.end()},
          .next = std::move(found.next),
          .damaged = std::move(found.damaged)};
}

JobInfo Pipeline::job(const std::string& id) { return state_->pool.status(id); }

api::JobEvents Pipeline::job_events(const std::string& id, std::uint64_t after, Seconds wait) {
  return state_->pool.events(id, after, std::chrono::ceil<std::chrono::milliseconds>(wait));
}

std::optional<JobInfo> Pipeline::cancel_job(const std::string& id) {
  if (const auto job = state_->pool.cancel(id, client_)) return *job;
  if (scope_ < Scope::admin) return std::nullopt;
  return state_->pool.cancel_for_all(id);
}

api::PartialUploads& Pipeline::partial_uploads() { return state_->uploads; }

// Clients do not see each other's replies, whatever keys they choose.
std::string Pipeline::own(const std::string& key) const { return client_ + " " + key; }

std::optional<std::string> Pipeline::recall(const std::string& key) { return state_->replies.recall(own(key)); }

void Pipeline::keep(const std::string& key, const std::string& reply) { state_->replies.keep(own(key), reply); }

void Pipeline::release(const std::string& key) { state_->replies.release(own(key)); }

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
        {"", {{"kind", what.first}, {"state", std::string(api::name(what.second))}}, static_cast<double>(count)});
  }
  all.push_back(std::move(ended));
  all.push_back(
      gauge("spherule_disk_free_bytes", "What can still be stored.", static_cast<double>(s.blobs.free_bytes())));
  for (auto& metric : metrics_of("model", s.cache.stats())) all.push_back(std::move(metric));
  for (auto& metric : metrics_of("contributions", s.contributions.stats())) all.push_back(std::move(metric));
  return all;
}

}  // namespace spherule::server
